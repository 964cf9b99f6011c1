// The page: its settings, what follows from them, and when to draw.

import { Orbit, viewCamera } from "lobelia/camera";
import { fillPanel, linearOf, listenToKeys, listenToPointers, shownOf, showSettings } from "lobelia/controls";
import { readScene, readShaders } from "lobelia/data";
import { Renderer, edited } from "lobelia/renderer";
import { passes } from "lobelia/ron";
import { clamp } from "lobelia/linear";

/** Samples of a pixel that stands still: a 4 × 4 grid in an order that is even from the start. */
const GRID = [0, 10, 2, 8, 5, 15, 7, 13, 1, 11, 3, 9, 4, 14, 6, 12].map((i) => [
    ((i % 4) + 0.5) / 4 - 0.5, (Math.floor(i / 4) + 0.5) / 4 - 0.5,
]);
/** After this time without a change, in milliseconds, the picture gets its full resolution. */
const STILL = 180;
/** Frame times, in milliseconds, above and below which a moving picture gets fewer or more pixels. */
const SLOW = 45;
const FAST = 22;
/** Time for all samples of a picture that stands still, in milliseconds; a slow machine takes fewer samples. */
const PATIENCE = 3000;

const SETTINGS = {
    light: 0, turn: 0, show: "full", exposure: 0, backdrop: "#ffffff", view: -1,
    roughness: 0, level: 1, color: "#e6c065", mix: 0, tint: "#ffffff", bright: 1,
};

class Page {
    constructor(scene, canvas, shaders) {
        Object.assign(this, { scene, canvas, settings: { ...SETTINGS }, scale: 0.7, frames: [], cost: 0, patience: PATIENCE });
        this.orbit = new Orbit(scene);
        this.renderer = new Renderer(canvas, scene, shaders);
        this.drawn = 0;
        this.changed = 0;
        this.waiting = false;
    }

    /** The settings as the renderer reads them. */
    get state() {
        const { light, turn, show, exposure, backdrop, roughness, level, color, mix, tint, bright } = this.settings;
        return {
            light, turn, show, exposure, level, mix, roughness: 2 ** roughness,
            backdrop: shownOf(backdrop), color: linearOf(color), tint: linearOf(tint).map((c) => c * bright),
        };
    }

    /** The view whose camera is looked through. */
    get view() {
        return this.scene.cameras[this.settings.view];
    }

    camera(aspect) {
        return this.view ? viewCamera(this.view) : this.orbit.camera(aspect);
    }

    change(settings) {
        Object.assign(this.settings, settings);
        showSettings(this);
        this.redraw();
    }

    /** Moves the camera; from a view's camera it goes on freely. */
    move(how) {
        if (this.view) this.orbit.follow(this.view);
        how(this.orbit);
        this.change({ view: -1 });
    }

    turnLight(degrees) {
        const turn = Math.round(this.settings.turn + degrees);
        this.change({ turn: ((((turn + 180) % 360) + 360) % 360) - 180 });
    }

    stepView(step) {
        const count = this.scene.cameras.length;
        if (count > 0) this.change({ view: (((this.settings.view + step) % count) + count) % count });
    }

    resetView() {
        this.orbit.reset();
        this.change({ view: -1 });
    }

    reset() {
        this.orbit.reset();
        this.change(SETTINGS);
    }

    /** Roughness of the base materials after the page's factor. */
    roughnessText(factor) {
        const { materials } = edited(this.scene, { ...this.state, roughness: factor });
        const [low, high] = [Math.min, Math.max].map((of) => of(...materials.map(({ roughness }) => roughness)).toFixed(2));
        return low === high ? low : `${low} to ${high}`;
    }

    /** The passes that reproduce what is shown. */
    ron() {
        const size = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) => Math.max(side, 1));
        const camera = this.camera(size[0] / size[1]);
        const light = this.renderer.lights[this.settings.light];
        const lobes = this.renderer.lobes(this.state, camera);
        return passes(this.scene, this.state, { light, lobes, view: this.view, camera, size });
    }

    redraw() {
        this.drawn = 0;
        this.changed = performance.now();
        if (!this.waiting) {
            this.waiting = true;
            this.last = null;
            requestAnimationFrame((time) => this.tick(time));
        }
    }

    tick(time) {
        this.waiting = false;
        const moving = performance.now() - this.changed < STILL;
        if (this.last !== null) {
            if (moving) this.pace(time - this.last);
            else if (this.drawn > 1) this.cost = time - this.last;
        }
        this.last = time;
        const scale = moving ? this.scale : 1;
        const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) =>
            clamp(Math.round(side * Math.min(window.devicePixelRatio, 2) * scale), 1, 4096));
        const resized = this.renderer.target?.width !== width || this.renderer.target?.height !== height;
        if (this.drawn === 0 || resized) {
            this.renderer.begin(width, height);
            this.drawn = 0;
        }
        const most = clamp(Math.floor(this.patience / Math.max(this.cost, 1)), 2, GRID.length);
        if (this.drawn < most) {
            const jitter = this.drawn === 0 && moving ? [0, 0] : GRID[this.drawn];
            this.renderer.sample(this.state, this.camera(width / height), jitter);
            this.renderer.present(this.state);
            this.drawn += 1;
        }
        if (moving || this.drawn < most) {
            this.waiting = true;
            requestAnimationFrame((next) => this.tick(next));
        }
    }

    /** Fewer pixels while frames are slow. */
    pace(elapsed) {
        this.frames.push(elapsed);
        if (this.frames.length > 60) this.frames.shift();
        if (elapsed > SLOW) this.scale = Math.max(this.scale * 0.85, 0.2);
        else if (elapsed < FAST) this.scale = Math.min(this.scale * 1.04, 1);
    }
}

/** What scripts may do with the page: `await lobelia.ready`, then `set`, `ron` and `picture`. */
function offer(page) {
    return {
        scene: page.scene,
        defaults: SETTINGS,
        settings: () => ({ ...page.settings }),
        camera: () => page.camera(1),
        /** Sets the time, in milliseconds, that a picture that stands still may take for its samples. */
        patience(time) {
            page.patience = time;
            page.redraw();
        },
        /** Whether the picture has all its samples. */
        still: () => !page.waiting,
        set: (settings) => page.change(settings),
        ron: () => page.ron(),
        frames: () => [...page.frames],
        /** A view's picture with side × side samples a pixel: RGBA bytes with straight alpha. */
        picture(view, side) {
            const camera = viewCamera(page.scene.cameras[view]);
            const rows = page.renderer.picture(page.state, camera, camera.width, camera.height, side);
            page.redraw();
            return rows;
        },
    };
}

async function start() {
    const status = document.getElementById("status");
    const canvas = document.getElementById("picture");
    try {
        const scene = await readScene();
        const page = new Page(scene, canvas, readShaders());
        fillPanel(page);
        listenToPointers(page, canvas);
        listenToKeys(page);
        page.change({});
        new ResizeObserver(() => page.redraw()).observe(canvas);
        canvas.addEventListener("webglcontextlost", () => (status.textContent = "The graphics card was taken away. Reload the page."));
        const lobes = page.renderer.lights[0].lobes.length;
        status.textContent = `${scene.data.triangles.length / 3} triangles, ${lobes} light lobes`;
        Object.assign(globalThis.lobelia, offer(page));
    } catch (error) {
        status.textContent = `This object cannot be shown: ${error.message}.`;
        throw error;
    }
}

globalThis.lobelia = {};
globalThis.lobelia.ready = start();
