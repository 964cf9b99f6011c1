// The page: its settings, what follows from them, and when to draw.

import { Stroke, saidFirst } from "lobelia/brush";
import { Orbit, viewCamera } from "lobelia/camera";
import { Compare, listenToWipe } from "lobelia/compare";
import { addLightChoice, fillPanel, linearOf, listenToFiles, listenToKeys, listenToPointers, say, shownOf, showSettings } from "lobelia/controls";
import { readScene, readShaders } from "lobelia/data";
import { History } from "lobelia/history";
import { LightBall } from "lobelia/lightball";
import { lightOfFile } from "lobelia/lightfile";
import { UNCHANGED, cornersOf, mostRegions, pick } from "lobelia/regions";
import { Pace } from "lobelia/pace";
import { Renderer, edited } from "lobelia/renderer";
import { passes } from "lobelia/ron";
import { clamp } from "lobelia/linear";

/** Samples of a pixel that stands still: a 4 × 4 grid in an order that is even from the start. */
const GRID = [0, 10, 2, 8, 5, 15, 7, 13, 1, 11, 3, 9, 4, 14, 6, 12].map((i) => [
    ((i % 4) + 0.5) / 4 - 0.5, (Math.floor(i / 4) + 0.5) / 4 - 0.5,
]);
/** After this time without a change, in milliseconds, the picture gets its full resolution; later, up to a limit, where frames are slow. */
const STILL = 180;
const LONGEST_STILL = 1000;
/** Time for all samples of a picture that stands still, in milliseconds; a slow machine takes fewer samples. */
const PATIENCE = 3000;

const SETTINGS = {
    light: 0, turn: 0, show: "full", exposure: 0, backdrop: "#ffffff", view: -1, ...UNCHANGED,
    // Places with edits of their own, the one that the sliders change (-1: the whole object), and whether a "click" or the "brush"
    // makes another.
    regions: [], region: -1, placing: "",
    // Whether photographs are compared, what is left and right of the line, and where it is, in percent; the light's ball.
    compare: false, left: "photograph", right: "render", wipe: 50, ball: false,
};

/** Settings of edits as the renderer reads them. */
function look({ roughness, level, color, mix, metal, tint, bright }) {
    // A metal reflects its color and has no diffuse light; between the two both are mixed, as glTF has it.
    const dielectric = 1 - metal;
    return {
        level,
        mix: 1 - (1 - mix) * dielectric,
        roughness: 2 ** roughness,
        color: linearOf(color),
        tint: linearOf(tint).map((c) => c * bright * dielectric),
    };
}

class Page {
    constructor(scene, canvas, shaders) {
        Object.assign(this, { scene, canvas, settings: { ...SETTINGS }, pace: new Pace(), cost: 0, patience: PATIENCE });
        this.orbit = new Orbit(scene);
        this.renderer = new Renderer(canvas, scene, shaders);
        this.history = new History();
        this.compare = new Compare(this);
        this.ball = new LightBall(document.getElementById("ball"));
        this.drawn = 0;
        this.changed = 0;
        this.waiting = false;
        // The place that is being made.
        this.stroke = null;
    }

    /** The settings as the renderer reads them. */
    get state() {
        const { light, turn, show, exposure, backdrop, regions } = this.settings;
        return {
            light, turn, show, exposure, backdrop: shownOf(backdrop), ...look(this.settings),
            regions: regions.map((region) => ({ ...region, ...look(region) })),
        };
    }

    /** What the sliders of the material change: a place, or the whole object. */
    get edited() {
        return this.settings.regions[this.settings.region] ?? this.settings;
    }

    edit(values) {
        const { regions, region } = this.settings;
        if (this.edited === this.settings) this.change(values);
        else this.change({ regions: regions.map((old, i) => (i === region ? { ...old, ...values } : old)) });
    }

    /** Where a point of the canvas shows the object; null beside it. */
    pick(x, y) {
        const { canvas, scene } = this;
        const size = [canvas.clientWidth, canvas.clientHeight];
        this.corners ??= cornersOf(scene);
        return pick(this.corners, scene.data.triangles, this.camera(size[0] / size[1]), [x, y], size);
    }

    /** Makes a ball where a point of the canvas shows the object. */
    place(x, y) {
        if (this.beginStroke(x, y)) this.endStroke();
        else say("There is nothing of the object here.");
    }

    /** Begins a place where a point of the canvas shows the object. Returns whether it does. */
    beginStroke(x, y) {
        const stroke = new Stroke(this);
        if (stroke.to(x, y)) this.stroke = stroke;
        return this.stroke !== null;
    }

    /** Ends the place that is being made, or takes it back. */
    endStroke(keep = true) {
        const { stroke } = this;
        this.stroke = null;
        if (keep) say(stroke.end());
        else stroke?.drop();
    }

    /** Begins or leaves the making of a place in a way, if there may be another. */
    startPlacing(way) {
        const { placing, regions } = this.settings;
        const most = mostRegions(this.scene.materials.length);
        if (placing !== way && regions.length >= most) return say(`At most ${most} ${most === 1 ? "place" : "places"} can be edited.`);
        this.canvas.focus({ preventScroll: true });
        this.change({ placing: placing === way ? "" : way });
        return say(saidFirst(this.settings.placing));
    }

    removePlace() {
        const { regions, region } = this.settings;
        this.change({ regions: regions.filter((_, i) => i !== region), region: -1 });
    }

    /** The view whose camera is looked through. */
    get view() {
        return this.scene.cameras[this.settings.view];
    }

    camera(aspect) {
        return this.view ? viewCamera(this.view) : this.orbit.camera(aspect);
    }

    change(settings) {
        this.note(this.settings, settings);
    }

    /** Changes settings that are part of a change which is not yet done. */
    show(settings) {
        this.settings = { ...this.settings, ...settings };
        this.refresh();
    }

    /** Changes settings, and notes what has changed since they were those of `before`. */
    note(before, settings) {
        const old = { ...this.settings, ...before };
        this.settings = { ...this.settings, ...settings };
        this.history.note(old, this.settings, performance.now());
        this.refresh();
    }

    /** Shows the settings, and draws. */
    refresh() {
        showSettings(this);
        this.compare.show();
        this.redraw();
    }

    /** Goes back to earlier settings, or on to later ones. */
    goBack(way) {
        const found = this.history[way](this.settings);
        if (!found) return say(way === "undo" ? "There is nothing to undo." : "There is nothing to do again.");
        this.settings = { ...this.settings, ...found, placing: "" };
        if (this.settings.region >= this.settings.regions.length) this.settings.region = -1;
        return this.refresh();
    }

    /** Moves the camera; from a view's camera it goes on freely. */
    move(how) {
        if (this.view) this.orbit.follow(this.view);
        if (this.settings.compare) this.lastView = this.settings.view;
        how(this.orbit);
        this.change({ view: -1, compare: false });
    }

    turnLight(degrees) {
        const turn = Math.round(this.settings.turn + degrees);
        this.change({ turn: ((((turn + 180) % 360) + 360) % 360) - 180 });
    }

    /** Goes to the next camera; while photographs are compared, to the next one that has a photograph. */
    stepView(step) {
        const places = this.settings.compare ? this.compare.places : this.scene.cameras.map((_, i) => i);
        const { length } = places;
        const at = places.indexOf(this.settings.view);
        if (length > 0) this.change({ view: places[(((Math.max(at, step > 0 ? -1 : 0) + step) % length) + length) % length] });
    }

    /** Begins or ends the comparison with photographs; it begins with the last one. */
    compareViews(compare) {
        const { places } = this.compare;
        if (places.length === 0) return;
        const { view } = this.settings;
        const last = [view, this.lastView].find((at) => places.includes(at)) ?? places[0];
        this.lastView = last;
        this.change(compare ? { compare, view: last } : { compare });
    }

    resetView() {
        this.orbit.reset();
        this.change({ view: -1, compare: false });
    }

    reset() {
        this.orbit.reset();
        this.change(SETTINGS);
    }

    /** Offers and shows the light of a file. */
    async openLight(file) {
        try {
            const light = await lightOfFile(file, this.renderer.lights[0].lobes.length);
            this.renderer.lights.push(light);
            this.scene.lights.push({ name: light.name, own: false, frame: light.frame });
            addLightChoice(light.name, this.scene.lights.length - 1);
            this.change({ light: this.scene.lights.length - 1, turn: 0 });
            say(`${file.name}: ${light.lobes.length} light lobes`);
        } catch (error) {
            say(`${file.name}: ${error.message}.`);
        }
    }

    /** Roughness of the base materials after the page's factor. */
    roughnessText(factor) {
        const { state } = this;
        const whole = this.edited === this.settings ? { ...state, roughness: factor } : state;
        const apart = whole === state ? factor : 1;
        const materials = edited(this.scene, whole).materials.map(({ roughness }) => ({ roughness: clamp(roughness * apart, 0.03, 1) }));
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
        const moving = performance.now() - this.changed < clamp(2 * Math.max(...this.pace.frames.slice(-4)), STILL, LONGEST_STILL);
        // The time since the last tick is that of what it drew.
        if (this.last !== null) this.drew?.(time - this.last);
        Object.assign(this, { last: time, drew: null });
        const scale = moving ? this.pace.scale : 1;
        const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) =>
            clamp(Math.round(side * Math.min(window.devicePixelRatio, 2) * scale), 1, 4096));
        // An error map is of a picture that the renderer draws on the way.
        if (!moving && this.compare.refresh()) this.drawn = 0;
        const resized = this.renderer.target?.width !== width || this.renderer.target?.height !== height;
        if (this.drawn === 0 || resized) {
            this.renderer.begin(width, height);
            this.drawn = 0;
        }
        const most = clamp(Math.floor(this.patience / Math.max(this.cost, 1)), 2, GRID.length);
        if (this.drawn < most) {
            const jitter = this.drawn === 0 && moving ? [0, 0] : GRID[this.drawn];
            const camera = this.camera(width / height);
            this.renderer.sample({ ...this.state, mark: this.settings.region }, camera, jitter);
            this.renderer.present(this.state);
            this.drawn += 1;
            // The first sample of a picture that stands still may have waited for one of another size.
            if (this.drawn === 1) this.drew = moving ? (elapsed) => this.pace.moved(elapsed) : null;
            else if (!moving) this.drew = (elapsed) => this.rested(elapsed);
            this.drawBall(camera);
        }
        if (moving || this.drawn < most) {
            this.waiting = true;
            requestAnimationFrame((next) => this.tick(next));
        }
    }

    drawBall({ axes }) {
        const { light, turn, exposure, ball } = this.settings;
        if (ball) this.ball.draw(this.renderer.lights[light], { up: this.scene.up, turn, exposure, axes });
    }

    /** Takes the time of a sample of a picture that stands still. */
    rested(elapsed) {
        this.cost = elapsed;
        this.pace.rested(elapsed);
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
        frames: () => [...page.pace.frames],
        /** The error of the photograph that is compared, as PSNR in dB; null until it is known. */
        psnr: () => page.compare.psnr,
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
    const canvas = document.getElementById("picture");
    try {
        const scene = await readScene();
        const page = new Page(scene, canvas, readShaders());
        fillPanel(page);
        listenToPointers(page, canvas);
        listenToKeys(page);
        listenToWipe(page);
        listenToFiles(page);
        page.change({});
        new ResizeObserver(() => page.refresh()).observe(canvas);
        canvas.addEventListener("webglcontextlost", () => say("The graphics card was taken away. Reload the page."));
        const lobes = page.renderer.lights[0].lobes.length;
        say(`${scene.data.triangles.length / 3} triangles, ${lobes} light lobes`);
        Object.assign(globalThis.lobelia, offer(page));
    } catch (error) {
        say(`This object cannot be shown: ${error.message}.`);
        throw error;
    }
}

globalThis.lobelia = {};
globalThis.lobelia.ready = start();
