// Photographs beside the page's own picture: two of photograph, render and error lie over the canvas, with a line between them.

import { clamp } from "lobelia/linear";

/** What can be on either side of the line. */
export const SIDES = [
    { name: "photograph", label: "Photograph" },
    { name: "render", label: "Render" },
    { name: "error", label: "Error" },
];
/** The error at the end of the color scale, and the scale's colors, as in Lobelia's reports (`report::heat`). */
const LARGEST = 0.25;
const INFERNO = [
    [0, 0, 4], [31, 12, 72], [85, 15, 109], [136, 34, 106], [186, 54, 85], [227, 89, 51], [249, 140, 10], [249, 201, 50], [252, 255, 164],
];
/** Samples along each side of a pixel of the render that the error is of. */
const FINE = 2;

const by = (id) => document.getElementById(id);
const LINEAR = Float32Array.from({ length: 256 }, (_, byte) => {
    const x = byte / 255;
    return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
});
const STEPS = 4095;
const SHOWN = Uint8ClampedArray.from({ length: STEPS + 1 }, (_, i) => {
    const x = i / STEPS;
    return 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
});
const shownByte = (linear) => SHOWN[(clamp(linear, 0, 1) * STEPS + 0.5) | 0];

/** Color of an error. */
export function heat(error) {
    const at = Math.sqrt(clamp(error / LARGEST, 0, 1)) * (INFERNO.length - 1);
    const low = Math.min(Math.floor(at), INFERNO.length - 2);
    return INFERNO[low].map((a, c) => a + (INFERNO[low + 1][c] - a) * (at - low));
}

/** The camera of the part of a view that its photograph shows, at the photograph's size. */
export function photographCamera({ eye, axes, focal, center, skew, photograph }) {
    const [x, y, width, height] = photograph.window;
    const [sx, sy] = [photograph.size[0] / width, photograph.size[1] / height];
    return {
        eye, axes, width: photograph.size[0], height: photograph.size[1], skew: skew * sx,
        focal: [focal[0] * sx, focal[1] * sy], center: [(center[0] - x) * sx, (center[1] - y) * sy],
    };
}

/** A photograph in linear light, coverage-weighted on black, and its coverage. */
async function decoded({ photograph }, coverage) {
    const image = new Image();
    image.src = photograph.address;
    await image.decode();
    const [width, height] = photograph.size;
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(image, 0, 0, width, height);
    const { data } = context.getImageData(0, 0, width, height);
    const mat = photograph.mat.map((byte) => LINEAR[byte]);
    const light = new Float32Array(3 * width * height);
    for (let i = 0; i < width * height; i++) {
        const behind = coverage ? 1 - coverage[i] / 255 : 0;
        for (let c = 0; c < 3; c++) light[3 * i + c] = Math.max(LINEAR[data[4 * i + c]] - behind * mat[c], 0);
    }
    return { width, height, light, coverage };
}

/** A photograph as it is shown: with the page's exposure and backdrop. */
function developed({ width, height, light, coverage }, { exposure, backdrop }) {
    const picture = new ImageData(width, height);
    const behind = backdrop.map((shown) => LINEAR[Math.round(255 * shown)]);
    const factor = 2 ** exposure;
    for (let i = 0; i < width * height; i++) {
        const alpha = coverage ? coverage[i] / 255 : 1;
        for (let c = 0; c < 3; c++) {
            const straight = alpha > 0 ? Math.min((light[3 * i + c] / alpha) * factor, 1) : 0;
            picture.data[4 * i + c] = shownByte(alpha * straight + (1 - alpha) * behind[c]);
        }
        picture.data[4 * i + 3] = 255;
    }
    return picture;
}

/** The error map of a render (8-bit, straight alpha), and its PSNR in dB over the object: linear values clipped to [0, 1]. */
export function errorMap({ width, height, light, coverage }, render) {
    const picture = new ImageData(width, height);
    let [sum, count] = [0, 0];
    for (let i = 0; i < width * height; i++) {
        const alpha = render[4 * i + 3] / 255;
        const covered = coverage ? coverage[i] / 255 : alpha;
        if (covered <= 0) continue;
        let error = 0;
        for (let c = 0; c < 3; c++) {
            const gap = alpha * LINEAR[render[4 * i + c]] - Math.min(light[3 * i + c], 1);
            error += Math.abs(gap) / 3;
            if (covered > 0.99) sum += gap * gap;
        }
        if (covered > 0.99) count += 3;
        picture.data.set([...heat(error), 255], 4 * i);
    }
    return { picture, psnr: count > 0 ? -10 * Math.log10(Math.max(sum / count, 1e-10)) : null };
}

export class Compare {
    constructor(page) {
        this.page = page;
        this.known = new Map();
        this.places = page.scene.cameras.flatMap(({ photograph }, i) => (photograph ? [i] : []));
        this.sides = ["left", "right"].map((side) => ({
            side, layer: by(`${side}-side`), canvas: by(`${side}-side`).querySelector("canvas"), tag: by(`${side}-tag`), drawn: "",
        }));
        Object.assign(this, { compared: "", psnr: null });
    }

    /** The photograph of the view that is looked through, if it is compared. */
    get photograph() {
        return this.page.settings.compare ? this.page.view?.photograph ?? null : null;
    }

    /** Puts line, sides and words where the settings have them. */
    show() {
        const { photograph, page } = this;
        by("wipe").hidden = !photograph;
        if (!photograph) return;
        const { wipe, backdrop, left, right } = page.settings;
        by("line").style.left = `${wipe}%`;
        by("line").setAttribute("aria-valuenow", wipe);
        by("line").setAttribute("aria-valuetext", `${Math.round(wipe)} % ${left}, ${Math.round(100 - wipe)} % ${right}`);
        by("wiped").textContent = page.view.test ? `${page.view.name} (test)` : page.view.name;
        for (const { side, layer, canvas, tag } of this.sides) {
            const choice = page.settings[side];
            const score = choice === "error" && this.psnr !== null ? ` · ${this.psnr.toFixed(1)} dB` : "";
            tag.textContent = SIDES.find(({ name }) => name === choice).label + score;
            layer.hidden = choice === "render";
            layer.style.background = backdrop;
            layer.style.clipPath = side === "left" ? `inset(0 ${100 - wipe}% 0 0)` : `inset(0 0 0 ${wipe}%)`;
            Object.assign(canvas.style, this.place(photograph));
        }
        this.sides[0].tag.style.right = `calc(${100 - wipe}% + 10px)`;
        this.sides[1].tag.style.left = `calc(${wipe}% + 10px)`;
        this.paint();
    }

    /** Where the photograph lies over the canvas. */
    place({ window }) {
        const { clientWidth, clientHeight } = this.page.canvas;
        const { width, height } = this.page.view;
        const fit = Math.min(clientWidth / width, clientHeight / height);
        const [left, top] = [(clientWidth - fit * width) / 2 + fit * window[0], (clientHeight - fit * height) / 2 + fit * window[1]];
        const px = (length) => `${length}px`;
        return { left: px(left), top: px(top), width: px(fit * window[2]), height: px(fit * window[3]) };
    }

    /** The decoded photograph of a view. */
    decoded(view) {
        if (!this.known.has(view)) {
            if (this.known.size > 5) this.known.delete(this.known.keys().next().value);
            this.known.set(view, decoded(this.page.scene.cameras[view], this.page.scene.data[`coverage${view}`]));
        }
        return this.known.get(view);
    }

    /** Draws photographs into the sides that show them. */
    async paint() {
        const { view, exposure, backdrop } = this.page.settings;
        const wanted = JSON.stringify([view, exposure, backdrop]);
        for (const side of this.sides) {
            if (this.page.settings[side.side] !== "photograph" || side.drawn === wanted) continue;
            side.drawn = wanted;
            const photograph = await this.decoded(view);
            if (side.drawn === wanted) this.put(side, developed(photograph, this.page.state));
        }
    }

    put({ canvas }, picture) {
        Object.assign(canvas, { width: picture.width, height: picture.height });
        canvas.getContext("2d").putImageData(picture, 0, 0);
    }

    /** Renders and compares again if an error map is shown that is not of what is shown; returns whether the renderer was used. */
    refresh() {
        const { page } = this;
        const sides = this.sides.filter(({ side }) => page.settings[side] === "error");
        if (!this.photograph || sides.length === 0) return false;
        const state = { ...page.state, show: "full", exposure: 0, mark: null };
        const { view } = page.settings;
        const wanted = JSON.stringify([view, state, sides.map(({ side }) => side)]);
        if (wanted === this.compared && sides.every(({ drawn }) => drawn === "error")) return false;
        Object.assign(this, { compared: wanted, psnr: null });
        sides.forEach((side) => (side.drawn = "error"));
        const camera = photographCamera(page.view);
        const render = page.renderer.picture(state, camera, camera.width, camera.height, FINE);
        this.decoded(view).then((photograph) => {
            if (wanted !== this.compared) return;
            const { picture, psnr } = errorMap(photograph, render);
            this.psnr = psnr;
            sides.filter(({ drawn }) => drawn === "error").forEach((side) => this.put(side, picture));
            this.show();
        });
        return true;
    }
}

/** The line that is dragged, or moved with the arrow keys; and what is chosen in the panel. */
export function listenToWipe(page) {
    const line = by("line");
    const move = (percent) => page.change({ wipe: clamp(percent, 0, 100) });
    line.addEventListener("pointerdown", (event) => {
        line.setPointerCapture(event.pointerId);
        line.focus({ preventScroll: true });
        event.preventDefault();
    });
    line.addEventListener("pointermove", (event) => {
        if (!line.hasPointerCapture(event.pointerId)) return;
        const { left, width } = page.canvas.getBoundingClientRect();
        move((100 * (event.clientX - left)) / width);
    });
    line.addEventListener("keydown", (event) => {
        const step = event.shiftKey ? 10 : 2;
        const to = { ArrowLeft: -step, ArrowDown: -step, ArrowRight: step, ArrowUp: step, Home: -100, End: 100 }[event.key];
        if (to === undefined) return;
        event.preventDefault();
        event.stopPropagation();
        move(page.settings.wipe + to);
    });
    for (const side of ["left", "right"]) {
        for (const { name, label } of SIDES) by(side).append(new Option(label, name));
        by(side).addEventListener("change", () => page.change({ [side]: by(side).value }));
    }
    by("compare").addEventListener("change", () => page.compareViews(by("compare").checked));
    by("earlier").addEventListener("click", () => page.stepView(-1));
    by("later").addEventListener("click", () => page.stepView(1));
    const stops = INFERNO.map((color, i) => `rgb(${color.join(" ")}) ${12.5 * i}%`);
    by("scale").style.background = `linear-gradient(90deg, ${stops.join(", ")})`;
}
