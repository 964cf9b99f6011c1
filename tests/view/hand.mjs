// What a person does with the page of check.mjs beside turning it: undo, the light as a ball, places, lights from files, photographs.

import { writeFileSync } from "node:fs";
import { join } from "node:path";

const CONTROL = 2;
const SHIFT = 8;
/** Least PSNR of the page against path-traced photographs of the same object, in dB: closed forms against exact light, and noise. */
const LEAST = 30;

/** Lets an input have a value as if by hand. */
const input = (id, value) =>
    `(() => { const e = document.getElementById("${id}"); e.value = "${value}"; e.dispatchEvent(new Event("input")); })()`;

/** Drops a file with these bytes on the page. */
export const dropped = (name, bytes) => `(() => {
    const data = new DataTransfer();
    data.items.add(new File([new Uint8Array(${JSON.stringify([...bytes])})], "${name}"));
    document.dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
})()`;

/** A light of one lobe as an `.npy` file. */
function npy(numbers) {
    const header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1, 7), }".padEnd(117) + "\n";
    const head = Buffer.from([0x93, ...Buffer.from("NUMPY"), 1, 0, header.length, 0]);
    return Buffer.concat([head, Buffer.from(header), Buffer.from(Float32Array.from(numbers).buffer)]);
}

export async function byHand(browser, address, fail, folder) {
    await browser.open(address, 800, 420);
    await browser.evaluate("lobelia.patience(0)");
    await browser.until("lobelia.still()");
    const settings = (name) => browser.evaluate(`lobelia.settings().${name}`);
    const hidden = (id) => browser.evaluate(`document.getElementById("${id}").offsetParent === null`);
    if (!(await hidden("comparison"))) fail("cameras without photographs can be compared");

    await undoing(browser, settings, fail);
    await browser.key("s");
    await ball(browser, fail);
    await places(browser, settings, fail, folder);
    await brush(browser, settings, fail, folder);
    await lights(browser, settings, fail);
    writeFileSync(join(folder, "hand.png"), await browser.screenshot());
}

async function undoing(browser, settings, fail) {
    await browser.key("]");
    await browser.key("l");
    await browser.evaluate(input("roughness", "-1"));
    const all = async () => JSON.stringify([await settings("turn"), await settings("light"), await settings("roughness")]);
    const expect = async (what, wanted) => (await all()) === wanted || fail(`${what}: ${await all()}, not ${wanted}`);
    await expect("three changes", "[5,1,-1]");
    await browser.key("z", CONTROL);
    await expect("undo", "[5,1,0]");
    await browser.key("z", CONTROL);
    await browser.key("z", CONTROL);
    await expect("undo of all", "[0,0,0]");
    await browser.key("Z", CONTROL + SHIFT);
    await browser.evaluate("document.getElementById('redo').click()");
    await expect("redo", "[5,1,0]");
    await browser.key("r");
    await browser.key("z", CONTROL);
    await expect("undo of reset", "[5,1,0]");
    await browser.key("r");
}

/** The strongest lobe of the second light is where it stands on the ball, and goes with the light. */
async function ball(browser, fail) {
    const lobe = [-0.6, 0.5, 0.6].map((x) => x / Math.hypot(0.6, 0.5, 0.6));
    const colors = [];
    for (const turn of [0, 180]) {
        await browser.evaluate(`lobelia.set({ light: 1, turn: ${turn}, view: 0 })`);
        await browser.until("lobelia.still()");
        colors.push(await browser.evaluate(`(() => {
            const ball = document.getElementById("ball");
            const [x, y, z] = lobelia.camera().axes.map((a) => a.reduce((sum, v, i) => sum + v * ${JSON.stringify(lobe)}[i], 0));
            if (z > 0) return null;
            const at = [x, y].map((v) => Math.round(ball.width / 2 + 0.85 * v * ball.width / 2));
            const copy = Object.assign(document.createElement("canvas"), { width: 1, height: 1 }).getContext("2d", { willReadFrequently: true });
            copy.drawImage(ball, ...at, 1, 1, 0, 0, 1, 1);
            return Array.from(copy.getImageData(0, 0, 1, 1).data);
        })()`));
    }
    const [lit, turned] = colors;
    if (!lit || !(lit[0] > 220 && lit[3] === 255)) fail(`the ball is ${lit} where its light is`);
    if (!turned || turned[0] > 120) fail(`the ball is ${turned} where its light was`);
    await browser.key("r");
}

function isOnObject([x, y, z]) {
    const [ballGap, ringGap] = [Math.hypot(x, y - 0.12, z) - 0.33, Math.hypot(Math.hypot(x, z) - 0.62, y) - 0.2];
    return Math.min(Math.abs(ballGap), Math.abs(ringGap)) < 0.01;
}

async function places(browser, settings, fail, folder) {
    await browser.key("s");
    await browser.key("e");
    await browser.key("Enter");
    if ((await settings("regions.length")) !== 1) return fail("Enter makes no place in the middle of the picture");
    await browser.evaluate(input("tint", "#20a040"));
    await browser.evaluate(input("roughness", "-1"));
    const ron = await browser.evaluate("lobelia.ron()");
    const parts = [/Diffuse\(action: Scale\([^)]*\), region: Sphere\(center: \([^)]*\), radius: [\d.]+, falloff: /, /Roughness\(action: Scale\(0.5\), region: Sphere\(/];
    for (const part of parts) if (!part.test(ron)) fail(`copied without ${part}:\n${ron}`);
    const point = await settings("regions[0].points[0]");
    if (!isOnObject(point)) fail(`the place (${point}) is not on the object`);
    if ((await settings("tint")) !== "#ffffff") fail("an edit of a place changes the whole object");
    await browser.until("lobelia.still()");
    writeFileSync(join(folder, "place.png"), await browser.screenshot());
    await browser.key("e");
    await browser.drag([230, 210], [230, 210]);
    if ((await settings("regions.length")) !== 2) fail("a click makes no second place");
    await browser.evaluate("document.getElementById('unplace').click()");
    if ((await settings("regions.length")) !== 1) fail("a place cannot be removed");
    for (let i = 0; i < 5; i++) await browser.key("z", CONTROL);
    if ((await settings("regions.length")) !== 0) fail("places cannot be undone");
    return browser.key("r");
}

/** A stroke of the brush is one place and one step, and is copied as a `Stroke`. */
async function brush(browser, settings, fail, folder) {
    const camera = () => browser.evaluate("JSON.stringify(lobelia.camera())");
    await browser.key("b");
    if (!(await browser.evaluate("document.getElementById('brush').matches('[aria-pressed=true]')"))) fail("B does not take the brush");
    const before = await camera();
    await browser.drag([180, 240], [380, 230]);
    if ((await camera()) !== before) fail("painting turns the view");
    const points = (await settings("regions"))[0]?.points ?? [];
    if (points.length < 4) return fail(`a stroke over the object has the points ${JSON.stringify(points)}`);
    for (const point of points) if (!isOnObject(point)) fail(`the stroke's point (${point}) is not on the object`);
    await browser.evaluate(input("tint", "#20a040"));
    const ron = await browser.evaluate("lobelia.ron()");
    const list = points.map((point) => `(${point.join(", ")})`).join(", ");
    if (!ron.includes(`region: Stroke(points: [${list}], radius: `)) fail(`a stroke is copied as\n${ron}`);
    await browser.until("lobelia.still()");
    writeFileSync(join(folder, "stroke.png"), await browser.screenshot());
    await browser.key("z", CONTROL);
    await browser.key("z", CONTROL);
    if ((await settings("regions.length")) !== 0) fail("a stroke is not undone in one step");
    await browser.key("b");
    await browser.drag([20, 20], [60, 40]);
    if ((await settings("regions.length")) !== 0 || (await camera()) === before) fail("a drag beside the object paints");
    await browser.key("Escape");
    if ((await settings("placing")) !== "") fail("Escape does not leave the brush");
    return browser.key("r");
}

async function lights(browser, settings, fail) {
    const count = await browser.evaluate("lobelia.scene.lights.length");
    const ron = "// Lit\nLobes(lobes: [(axis: (0, 2, 0), sharpness: 9, amplitude: (1, 1, 2)),], rotation_degrees: (90, 0, 0), scale: 2.0)";
    await browser.evaluate(dropped("moon.ron", Buffer.from(ron)));
    await browser.until(`lobelia.settings().light === ${count}`);
    const copied = await browser.evaluate("lobelia.ron()");
    if (!copied.includes("sharpness: 9, amplitude: (2, 2, 4)") || !/axis: \(-?[\de.-]+, -?[\de.-]+, 1\)/.test(copied)) fail(`the dropped light is copied as\n${copied}`);
    await browser.evaluate(dropped("lamp.npy", npy([1, 0, 0, 30, 5, 4, 3])));
    await browser.until(`lobelia.settings().light === ${count + 1}`);
    if (!(await browser.evaluate("lobelia.ron()")).includes("(axis: (1, 0, 0), sharpness: 30, amplitude: (5, 4, 3))")) fail("an .npy light is not taken");
    const names = await browser.evaluate("[...document.getElementById('light').options].map((o) => o.textContent).join()");
    if (!names.endsWith("moon,lamp")) fail(`the lights are ${names}`);
    const bad = { "sky.png": "lobelia env fit", "sky.hdr": "truncated|Radiance HDR", "sky.exr": "truncated|OpenEXR", "a.ron": "is not expected", "b.ron": "Lobes(lobes", "c.npy": "NUMPY|begin" };
    for (const [name, said] of Object.entries(bad)) {
        const bytes = Buffer.from({ "a.ron": "Lobes(lobes: [(axis: ]", "b.ron": "Map(path: x)" }[name] ?? "nothing like it");
        await browser.evaluate(dropped(name, bytes));
        await browser.until(`document.getElementById("status").textContent.startsWith("${name}")`);
        const told = await browser.evaluate("document.getElementById('status').textContent");
        if (!new RegExp(said.replace("(", "\\(")).test(told)) fail(`of ${name} the page says: ${told}`);
    }
    if ((await settings("light")) !== count + 1) fail("a bad file changes the light");
}

/** The page beside photographs of the object that it shows. Returns the error in dB of the first. */
export async function besidePhotographs(browser, address, fail, folder) {
    await browser.open(address, 800, 420);
    await browser.evaluate("lobelia.patience(0), lobelia.set({ backdrop: '#8090a0' })");
    const settings = (name) => browser.evaluate(`lobelia.settings().${name}`);
    await browser.key("p");
    if (!(await settings("compare")) || (await settings("view")) !== 0) fail("P does not begin with the first photograph");
    await browser.until("lobelia.still()");
    writeFileSync(join(folder, "wipe.png"), await browser.screenshot());
    await browser.drag([256, 200], [128, 240]);
    const wipe = await settings("wipe");
    if (!(wipe > 20 && wipe < 30)) fail(`the line is at ${wipe} % after dragging`);
    if ((await settings("view")) !== 0) fail("dragging the line turns the view");
    await browser.key("ArrowRight");
    if ((await settings("wipe")) !== wipe + 2) fail("the arrow keys do not move the line");
    await browser.key("End");
    if ((await settings("wipe")) !== 100) fail("End does not move the line to the end");
    await browser.evaluate("lobelia.set({ left: 'error', wipe: 60 })");
    const errors = [];
    for (let i = 0; i < 4; i++) {
        await browser.until("lobelia.psnr() !== null");
        errors.push(await browser.evaluate("lobelia.psnr()"));
        if (!(errors[i] > LEAST)) fail(`the photograph of view ${await settings("view")} is ${errors[i].toFixed(1)} dB off`);
        if (i === 0) writeFileSync(join(folder, "error.png"), await browser.screenshot());
        await browser.key(".");
        await browser.until("lobelia.still()");
    }
    if ((await settings("view")) !== 0) fail("four photographs are not gone through in four steps");
    await browser.evaluate("lobelia.set({ turn: 90 })");
    await browser.until(`lobelia.psnr() !== null && lobelia.psnr() < ${errors[0] - 3}`);
    await browser.drag([60, 60], [90, 60]);
    if ((await settings("compare")) || !(await browser.evaluate("document.getElementById('wipe').hidden"))) fail("turning the view does not end the comparison");
    return errors[0];
}
