// What a person does: the panel, the pointer on the picture, and keys. Every change goes through `page.change`.

import { UNCHANGED, canShine } from "lobelia/regions";
import { SHOWS } from "lobelia/renderer";

const by = (id) => document.getElementById(id);
/** Degrees of a turn per pixel of dragging. */
const TURN = 0.4;
/** A press that moves less than this, in pixels, is a click. */
const STILL = 6;

const linear = (byte) => {
    const x = byte / 255;
    return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
};
const bytes = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
/** Linear color of a color input's text. */
export const linearOf = (hex) => bytes(hex).map(linear);
/** The color as it is shown, 0 to 1. */
export const shownOf = (hex) => bytes(hex).map((byte) => byte / 255);

/** Tells something in the line below the title. */
export function say(text) {
    by("status").textContent = text;
}

/** The inputs: what they are called in the settings, how their numbers are shown. */
const INPUTS = {
    turn: { said: (x) => `${x}°` },
    roughness: { said: (x, page) => page.roughnessText(2 ** x) },
    level: { said: (x) => `× ${x.toFixed(2)}` },
    color: {},
    mix: { said: (x) => `${Math.round(100 * x)} %` },
    metal: { said: (x) => `${Math.round(100 * x)} %` },
    tint: {},
    bright: { said: (x) => `× ${x.toFixed(2)}` },
    exposure: { said: (x) => `${x > 0 ? "+" : ""}${x.toFixed(1)} stops` },
    backdrop: {},
    radius: { said: (x, page) => `${Math.round((100 * x) / page.scene.radius)} % of the object` },
    soft: { said: (x) => `${Math.round(100 * x)} %` },
};
/** Inputs of a place alone. */
const OF_PLACES = ["radius", "soft"];
/** Switches. */
const SWITCHES = ["compare", "ball"];

/** Puts the settings into the panel. */
export function showSettings(page) {
    const { settings, edited } = page;
    for (const [name, { said }] of Object.entries(INPUTS)) {
        const value = edited[name] ?? settings[name] ?? 0;
        by(name).value = value;
        if (said) {
            by(`${name}-value`).textContent = said(value, page);
            by(name).setAttribute("aria-valuetext", said(value, page));
        }
    }
    showPlaces(page);
    for (const name of SWITCHES) by(name === "ball" ? "ball-on" : name).checked = settings[name];
    by("ball").hidden = !settings.ball;
    by("ball").setAttribute("aria-label", `The light as a ball: ${page.renderer.lights[settings.light].lobes.length} lobes`);
    by("sides").hidden = !settings.compare;
    by("legend").hidden = !settings.compare || ![settings.left, settings.right].includes("error");
    for (const side of ["left", "right"]) by(side).value = settings[side];
    by("undo").disabled = page.history.past.length === 0;
    by("redo").disabled = page.history.future.length === 0;
    by("light").value = settings.light;
    by("view").value = settings.view;
    for (const input of document.querySelectorAll("[name=show]")) input.checked = input.value === settings.show;
    const [r, g, b] = shownOf(settings.backdrop);
    document.querySelector("header").classList.toggle("on-dark", 0.3 * r + 0.6 * g + 0.1 * b < 0.5);
}

/** The places that can be edited, and what of the panel is for them alone. */
function showPlaces(page) {
    const { regions, region, placing } = page.settings;
    const names = ["whole object", ...regions.map((_, i) => `place ${i + 1}`)];
    if (by("region").length !== names.length) by("region").replaceChildren(...names.map((name, i) => new Option(name, i - 1)));
    by("region").value = region;
    by("unplace").hidden = by("placed").hidden = region < 0;
    by("new-place").setAttribute("aria-pressed", String(placing === "click"));
    by("brush").setAttribute("aria-pressed", String(placing === "brush"));
    page.canvas.classList.toggle("placing", placing !== "");
    const dull = region >= 0 && !canShine(page.scene.materials.length);
    for (const name of ["roughness", "level", "color", "mix", "metal"]) by(name).disabled = dull;
}

/** One more light to choose. */
export function addLightChoice(name, index) {
    by("light").append(new Option(name, index));
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
    scene.lights.forEach(({ name, own }, i) => addLightChoice(own ? "as found" : name, i));
    by("view").append(new Option("free view", -1));
    scene.cameras.forEach(({ name, test }, i) => by("view").append(new Option(test ? `${name} (test)` : name, i)));
    by("cameras").hidden = scene.cameras.length === 0;
    by("comparison").hidden = page.compare.places.length === 0;
    by("radius").max = 1.2 * scene.radius;
    by("radius").min = by("radius").step = 0.01 * scene.radius;
    for (const [name, { said }] of Object.entries(INPUTS)) {
        const change = (values) => (name in UNCHANGED || OF_PLACES.includes(name) ? page.edit(values) : page.change(values));
        by(name).addEventListener("input", () => change({ [name]: said ? Number(by(name).value) : by(name).value }));
    }
    listenToButtons(page);
}

function listenToButtons(page) {
    by("light").addEventListener("change", () => page.change({ light: Number(by("light").value) }));
    by("view").addEventListener("change", () => {
        const view = Number(by("view").value);
        page.change(view < 0 ? { view, compare: false } : { view });
    });
    by("before").addEventListener("click", () => page.stepView(-1));
    by("after").addEventListener("click", () => page.stepView(1));
    by("region").addEventListener("change", () => page.change({ region: Number(by("region").value), placing: "" }));
    by("new-place").addEventListener("click", () => page.startPlacing("click"));
    by("brush").addEventListener("click", () => page.startPlacing("brush"));
    by("unplace").addEventListener("click", () => page.removePlace());
    by("ball-on").addEventListener("change", () => page.change({ ball: by("ball-on").checked }));
    for (const way of ["undo", "redo"]) by(way).addEventListener("click", () => page.goBack(way));
    by("copy").addEventListener("click", () => copy(page));
    by("reset").addEventListener("click", () => page.reset());
    by("help").addEventListener("click", () => by("keys").showModal());
    by("panel").addEventListener("submit", (event) => event.preventDefault());
    by("fold").addEventListener("click", () => {
        const folded = by("panel").classList.toggle("folded");
        by("fold").setAttribute("aria-expanded", String(!folded));
    });
}

/** Lights from files: dropped on the page, or chosen. */
export function listenToFiles(page) {
    const chosen = by("light-file");
    by("open").addEventListener("click", () => chosen.click());
    chosen.addEventListener("change", async () => {
        for (const file of chosen.files) await page.openLight(file);
        chosen.value = "";
    });
    const brings = (event) => event.dataTransfer?.types.includes("Files");
    document.addEventListener("dragover", (event) => {
        if (!brings(event)) return;
        event.preventDefault();
        document.body.classList.add("dropping");
    });
    document.addEventListener("dragleave", (event) => event.relatedTarget ?? document.body.classList.remove("dropping"));
    document.addEventListener("drop", async (event) => {
        document.body.classList.remove("dropping");
        if (!brings(event)) return;
        event.preventDefault();
        for (const file of [...event.dataTransfer.files]) await page.openLight(file);
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
    let pressed = null;
    const turnsLight = (event) =>
        event.shiftKey || event.buttons === 2 || document.querySelector("[name=drag]:checked").value === "light";
    const within = (event) => {
        const { left, top } = canvas.getBoundingClientRect();
        return [event.clientX - left, event.clientY - top];
    };
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
        canvas.setPointerCapture(event.pointerId);
        canvas.focus({ preventScroll: true });
        held.set(event.pointerId, [event.clientX, event.clientY]);
        pressed = held.size === 1 && event.button === 0 ? [event.clientX, event.clientY] : null;
        // A second finger moves the view: the first one was not to paint.
        if (held.size > 1) page.endStroke(false);
        else if (page.settings.placing === "brush" && pressed && !event.shiftKey) page.beginStroke(...within(event));
    });
    canvas.addEventListener("pointerup", (event) => {
        const moved = pressed ? Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) : Infinity;
        if (!page.stroke && page.settings.placing && moved < STILL) page.place(...within(event));
    });
    for (const end of ["pointerup", "pointercancel"]) {
        canvas.addEventListener(end, (event) => {
            held.delete(event.pointerId);
            if (page.stroke) page.endStroke();
        });
    }
    canvas.addEventListener("pointermove", (event) => {
        const before = held.get(event.pointerId);
        if (!before) return;
        const now = [event.clientX, event.clientY];
        const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
        held.set(event.pointerId, now);
        if (page.stroke) {
            const passed = event.getCoalescedEvents?.() ?? [];
            for (const each of passed.length > 0 ? passed : [event]) page.stroke.to(...within(each));
        } else if (held.size === 2) {
            const [other] = [...held].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
            const apart = (at) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
            page.move((orbit) => {
                orbit.zoom(apart(before) / apart(now));
                orbit.pan(-dx / 2 / canvas.clientHeight, dy / 2 / canvas.clientHeight);
            });
        } else if (event.buttons === 4) {
            page.move((orbit) => orbit.pan(-dx / canvas.clientHeight, dy / canvas.clientHeight));
        } else if (page.settings.placing && Math.hypot(now[0] - pressed?.[0], now[1] - pressed?.[1]) < STILL) {
            // Perhaps a click.
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
    listenToBall(page);
}

/** The light's ball is turned like the light. */
function listenToBall(page) {
    const ball = by("ball");
    ball.addEventListener("pointerdown", (event) => ball.setPointerCapture(event.pointerId));
    ball.addEventListener("pointermove", (event) => {
        if (ball.hasPointerCapture(event.pointerId)) page.turnLight(2 * TURN * event.movementX);
    });
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
        p: () => page.compareViews(!page.settings.compare),
        s: () => page.change({ ball: !page.settings.ball }),
        e: () => page.startPlacing("click"),
        b: () => page.startPlacing("brush"),
        o: () => by("light-file").click(),
        c: () => copy(page),
        r: () => page.reset(),
        "?": () => by("keys").showModal(),
    };
    document.addEventListener("keydown", (event) => {
        if (page.stroke) return event.key === "Escape" ? page.endStroke(false) : undefined;
        const busy = event.target.closest?.("input, select, textarea, dialog");
        if ((event.ctrlKey || event.metaKey) && !event.altKey && !event.target.closest?.("textarea, dialog")) {
            const key = event.key.toLowerCase();
            const way = key === "y" || (key === "z" && event.shiftKey) ? "redo" : key === "z" ? "undo" : null;
            if (way) {
                page.goBack(way);
                event.preventDefault();
            }
        }
        if (busy || event.ctrlKey || event.metaKey || event.altKey) return;
        const show = SHOWS[Number(event.key) - 1];
        const other = others[event.key] ?? others[event.key.toLowerCase()];
        const [width, height] = [page.canvas.clientWidth, page.canvas.clientHeight];
        const { placing } = page.settings;
        if (placing && event.key === "Escape") return page.startPlacing(placing);
        if (placing && event.key === "Enter" && !event.target.closest?.("button")) return page.place(width / 2, height / 2);
        if (steps[event.key]) page.move((orbit) => steps[event.key](orbit, event.shiftKey));
        else if (show) page.change({ show: show.name });
        else if (other) other();
        else return;
        event.preventDefault();
    });
}
