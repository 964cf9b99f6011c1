// What a person does: the panel, the pointer on the picture, and keys. Every change goes through `page.change`.

import { SHOWS } from "lobelia/renderer";

const by = (id) => document.getElementById(id);
/** Degrees of a turn per pixel of dragging. */
const TURN = 0.4;

const linear = (byte) => {
    const x = byte / 255;
    return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
};
const bytes = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
/** Linear color of a color input's text. */
export const linearOf = (hex) => bytes(hex).map(linear);
/** The color as it is shown, 0 to 1. */
export const shownOf = (hex) => bytes(hex).map((byte) => byte / 255);

/** The inputs: what they are called in the settings, how their numbers are shown. */
const INPUTS = {
    turn: { said: (x) => `${x}°` },
    roughness: { said: (x, page) => page.roughnessText(2 ** x) },
    level: { said: (x) => `× ${x.toFixed(2)}` },
    color: {},
    mix: { said: (x) => `${Math.round(100 * x)} %` },
    tint: {},
    bright: { said: (x) => `× ${x.toFixed(2)}` },
    exposure: { said: (x) => `${x > 0 ? "+" : ""}${x.toFixed(1)} stops` },
    backdrop: {},
};

/** Puts the settings into the panel. */
export function showSettings(page) {
    const { settings } = page;
    for (const [name, { said }] of Object.entries(INPUTS)) {
        by(name).value = settings[name];
        if (said) {
            by(`${name}-value`).textContent = said(settings[name], page);
            by(name).setAttribute("aria-valuetext", said(settings[name], page));
        }
    }
    by("light").value = settings.light;
    by("view").value = settings.view;
    for (const input of document.querySelectorAll("[name=show]")) input.checked = input.value === settings.show;
    const [r, g, b] = shownOf(settings.backdrop);
    document.querySelector("header").classList.toggle("on-dark", 0.3 * r + 0.6 * g + 0.1 * b < 0.5);
}

function option(value, label) {
    const made = document.createElement("option");
    Object.assign(made, { value, textContent: label });
    return made;
}

export function fillPanel(page) {
    const { scene } = page;
    by("title").textContent = scene.title;
    for (const { name, label } of SHOWS) {
        const made = document.createElement("label");
        const input = Object.assign(document.createElement("input"), { type: "radio", name: "show", value: name });
        made.append(input, Object.assign(document.createElement("span"), { textContent: label }));
        by("shows").append(made);
        input.addEventListener("change", () => page.change({ show: name }));
    }
    scene.lights.forEach(({ name, own }, i) => by("light").append(option(i, own ? "as found" : name)));
    by("view").append(option(-1, "free view"));
    scene.cameras.forEach(({ name, test }, i) => by("view").append(option(i, test ? `${name} (test)` : name)));
    by("cameras").hidden = scene.cameras.length === 0;
    for (const [name, { said }] of Object.entries(INPUTS)) {
        by(name).addEventListener("input", () => page.change({ [name]: said ? Number(by(name).value) : by(name).value }));
    }
    by("light").addEventListener("change", () => page.change({ light: Number(by("light").value) }));
    by("view").addEventListener("change", () => page.change({ view: Number(by("view").value) }));
    by("before").addEventListener("click", () => page.stepView(-1));
    by("after").addEventListener("click", () => page.stepView(1));
    by("copy").addEventListener("click", () => copy(page));
    by("reset").addEventListener("click", () => page.reset());
    by("help").addEventListener("click", () => by("keys").showModal());
    by("panel").addEventListener("submit", (event) => event.preventDefault());
    by("fold").addEventListener("click", () => {
        const folded = by("panel").classList.toggle("folded");
        by("fold").setAttribute("aria-expanded", String(!folded));
    });
}

/** Copies the passes, and shows them. */
async function copy(page) {
    const text = page.ron();
    by("ron").value = text;
    by("copied").textContent = "Copy this into the passes of a scene file, such as saved/scene.ron.";
    by("text").showModal();
    by("ron").select();
    try {
        await navigator.clipboard.writeText(text);
        by("copied").textContent = "Copied. Put this into the passes of a scene file, such as saved/scene.ron.";
    } catch {
        // Not allowed here: the text is selected, to be copied by hand.
    }
}

/** Pointers on the picture: one turns, two zoom and move. */
export function listenToPointers(page, canvas) {
    const held = new Map();
    const turnsLight = (event) =>
        event.shiftKey || event.buttons === 2 || document.querySelector("[name=drag]:checked").value === "light";
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
        canvas.setPointerCapture(event.pointerId);
        canvas.focus({ preventScroll: true });
        held.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
        const before = held.get(event.pointerId);
        if (!before) return;
        const now = [event.clientX, event.clientY];
        const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
        held.set(event.pointerId, now);
        if (held.size === 2) {
            const [other] = [...held].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
            const apart = (at) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
            page.move((orbit) => {
                orbit.zoom(apart(before) / apart(now));
                orbit.pan(-dx / 2 / canvas.clientHeight, dy / 2 / canvas.clientHeight);
            });
        } else if (event.buttons === 4) {
            page.move((orbit) => orbit.pan(-dx / canvas.clientHeight, dy / canvas.clientHeight));
        } else if (turnsLight(event)) {
            page.turnLight(TURN * dx);
        } else {
            page.move((orbit) => orbit.turn(-TURN * dx, TURN * dy));
        }
    });
    canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        const lines = event.deltaMode === 1 ? 16 : 1;
        page.move((orbit) => orbit.zoom(Math.exp(0.0012 * lines * event.deltaY)));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => page.resetView());
}

/** Keys; those of a control that has the focus are its own. */
export function listenToKeys(page) {
    const steps = {
        ArrowLeft: (orbit, shift) => (shift ? orbit.pan(0.04, 0) : orbit.turn(-5, 0)),
        ArrowRight: (orbit, shift) => (shift ? orbit.pan(-0.04, 0) : orbit.turn(5, 0)),
        ArrowUp: (orbit, shift) => (shift ? orbit.pan(0, -0.04) : orbit.turn(0, 5)),
        ArrowDown: (orbit, shift) => (shift ? orbit.pan(0, 0.04) : orbit.turn(0, -5)),
        "+": (orbit) => orbit.zoom(0.9),
        "=": (orbit) => orbit.zoom(0.9),
        "-": (orbit) => orbit.zoom(1 / 0.9),
    };
    const others = {
        "[": () => page.turnLight(-5),
        "]": () => page.turnLight(5),
        l: () => page.change({ light: (page.settings.light + 1) % page.scene.lights.length }),
        ",": () => page.stepView(-1),
        ".": () => page.stepView(1),
        c: () => copy(page),
        r: () => page.reset(),
        "?": () => by("keys").showModal(),
    };
    document.addEventListener("keydown", (event) => {
        const busy = event.target.closest?.("input, select, textarea, dialog");
        if (busy || event.ctrlKey || event.metaKey || event.altKey) return;
        const show = SHOWS[Number(event.key) - 1];
        const other = others[event.key] ?? others[event.key.toLowerCase()];
        if (steps[event.key]) page.move((orbit) => steps[event.key](orbit, event.shiftKey));
        else if (show) page.change({ show: show.name });
        else if (other) other();
        else return;
        event.preventDefault();
    });
}
