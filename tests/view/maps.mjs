// Maps of a light that are dropped on the page: what is read of the files, and the picture under the lobes of one.

import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { Cells, cellsOfExr, cellsOfHdr } from "../../src/page/assets/mapfile.js";
import { direction, lobesOfCells } from "../../src/page/assets/mapfit.js";
import { psnr, writeExr } from "./pictures.mjs";

/** A light with a wide, a narrow and a colored lobe, as RON; written as a map and dropped. */
export const SKY = "Lobes(lobes: [(axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6)), (axis: (0.6, 0.5, 0.6), sharpness: 20, amplitude: (3, 2.6, 2)), (axis: (-0.7, 0.2, -0.5), sharpness: 8, amplitude: (0.8, 1, 1.4))])";

/** Least PSNR of the picture under the lobes of the dropped map against that under the light itself, in dB. */
const LEAST = 40;
/** Longest time of a fit, in milliseconds, on a machine that does other things as well. */
const LONGEST = 3000;
const [WIDTH, HEIGHT] = [150, 75];

/** Radiance that 16-bit floats and RGBE hold: quarters, with even rows and a peak. */
const picture = () => {
    const value = (i, c) => (i % WIDTH > 40 && i % WIDTH < 60 ? 8 : ((i * (c + 1)) % 23) / 4);
    return Object.fromEntries(["R", "G", "B"].map((name, c) => [name, Array.from({ length: WIDTH * HEIGHT }, (_, i) => value(i, c))]));
};

function cellsOf({ R, G, B }) {
    const cells = new Cells(WIDTH, HEIGHT);
    for (let i = 0; i < R.length; i++) cells.add(i % WIDTH, Math.floor(i / WIDTH), R[i], G[i], B[i]);
    return cells.done();
}

/** A Radiance HDR file with flat rows, old runs or new ones. */
function hdr({ R, G, B }, kind) {
    const parts = [Buffer.from(`#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y ${HEIGHT} +X ${WIDTH}\n`)];
    const texel = (i) => {
        const most = Math.max(R[i], G[i], B[i]);
        const exponent = most > 0 ? Math.floor(Math.log2(most)) + 1 : 0;
        return most > 0 ? [R[i], G[i], B[i]].map((v) => v * 2 ** (8 - exponent)).concat(exponent + 128) : [0, 0, 0, 0];
    };
    for (let y = 0; y < HEIGHT; y++) {
        const row = Array.from({ length: WIDTH }, (_, x) => texel(y * WIDTH + x));
        if (kind === "new") {
            parts.push(Buffer.from([2, 2, WIDTH >> 8, WIDTH & 255]));
            for (let plane = 0; plane < 4; plane++) for (let x = 0; x < WIDTH; ) {
                let length = 1;
                while (length < 100 && x + length < WIDTH && row[x + length][plane] === row[x][plane]) length++;
                parts.push(Buffer.from(length > 1 ? [128 + length, row[x][plane]] : [1, row[x][plane]]));
                x += length;
            }
        } else {
            for (let x = 0; x < WIDTH; ) {
                let length = 0;
                while (kind === "old" && x + 1 + length < WIDTH && String(row[x + 1 + length]) === String(row[x])) length++;
                parts.push(Buffer.from(row[x]), ...(length > 0 ? [Buffer.from([1, 1, 1, length])] : []));
                x += 1 + length;
            }
        }
    }
    return Buffer.concat(parts);
}

const arrayBuffer = (bytes) => bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);

/** Every form of the files gives the same cells; what is cut or unknown is an error with words. */
export async function readForms(fail) {
    const channels = picture();
    const expected = cellsOf(channels);
    const forms = [];
    for (const compression of [0, 1, 2, 3]) for (const is16 of [false, true]) {
        forms.push([`EXR ${compression} ${is16}`, cellsOfExr, writeExr(WIDTH, HEIGHT, { ...channels, A: channels.R, Z: channels.G }, { compression, is16 })]);
    }
    for (const kind of ["flat", "old", "new"]) forms.push([`HDR ${kind}`, async (buffer) => cellsOfHdr(buffer), hdr(channels, kind)]);
    for (const [name, read, bytes] of forms) {
        const found = await read(arrayBuffer(bytes)).catch((error) => (fail(`${name}: ${error.message}`), expected));
        const off = found.radiance.reduce((most, value, i) => Math.max(most, Math.abs(value - expected.radiance[i])), 0);
        if (!(off < 1e-6)) fail(`${name}: ${off} off`);
        for (const part of [0.001, 0.3, 0.9, 0.999]) {
            const cut = arrayBuffer(bytes.subarray(0, Math.floor(part * bytes.length)));
            const said = await read(cut).then(() => "nothing", (error) => error.message);
            if (said === "nothing") fail(`${name} is read although ${part} of it is there`);
        }
    }
    const refused = { "compression": writeExr(WIDTH, HEIGHT, channels, { compression: 4 }), "channels R, G and B": writeExr(WIDTH, HEIGHT, { Y: channels.R }) };
    for (const [words, bytes] of Object.entries(refused)) {
        const said = await cellsOfExr(arrayBuffer(bytes)).then(() => "nothing", (error) => error.message);
        if (!said.includes(words) || !said.includes("lobelia env fit")) fail(`of a map with other ${words} the page says: ${said}`);
    }
    for (const [width, height, words] of [[4, 2, "too small"], [62, 31, "too small"], [128, 128, "twice as wide"], [1024, 1, "twice as wide"]]) {
        let said = "nothing";
        try { new Cells(width, height); } catch (error) { said = error.message; }
        if (!said.includes(words)) fail(`of a map of ${width} × ${height} the page says: ${said}`);
    }
    return expected;
}

/** Light is kept, and lies where the map has it. */
export function fitted(cells, fail) {
    const began = performance.now();
    const lobes = lobesOfCells(cells, 128);
    const time = performance.now() - began;
    if (!(time < LONGEST)) fail(`128 lobes take ${time.toFixed(0)} ms`);
    const [power, given] = [[0, 0, 0], [0, 0, 0]];
    cells.solidAngle.forEach((angle, cell) => {
        const [x, y, z] = direction(((cell % cells.width) + 0.5) / cells.width, (Math.floor(cell / cells.width) + 0.5) / cells.height);
        for (let c = 0; c < 3; c++) {
            given[c] += angle * cells.radiance[3 * cell + c];
            for (const { axis, sharpness, amplitude } of lobes) power[c] += angle * amplitude[c] * Math.exp(sharpness * (axis[0] * x + axis[1] * y + axis[2] * z - 1));
        }
    });
    if (power.some((value, c) => Math.abs(value / given[c] - 1) > 0.03)) fail(`of ${given} the lobes give ${power}`);
    return time;
}

/** Drops the map on the page and compares pictures; returns the PSNR. `reference` renders passes. */
export async function droppedMap(browser, { lobelia, address, folder, dropped, reference, side }, fail) {
    const [ron, exr] = ["sky.ron", "sky.exr"].map((name) => join(folder, name));
    writeFileSync(ron, SKY);
    lobelia("env", "render", ron, exr, "--size", "256x128");
    await browser.open(address, 900, 600);
    const count = await browser.evaluate("lobelia.scene.lights.length");
    await browser.evaluate(dropped("sky.exr", readFileSync(exr)));
    await browser.until(`lobelia.settings().light === ${count}`);
    await browser.evaluate("lobelia.set({ view: 0 })");
    const copied = await browser.evaluate("lobelia.ron()");
    const shown = await browser.evaluate(`Array.from(lobelia.picture(0, ${side}))`);
    const start = copied.indexOf("Lobes(lobes: [");
    if (start < 0) fail(`the map is copied as\n${copied.slice(0, 300)}`);
    const passes = `${copied.slice(0, start)}${SKY}${copied.slice(copied.indexOf("])", start) + 2)}`;
    const name = await browser.evaluate("lobelia.scene.cameras[0].name");
    const found = psnr(shown, reference(passes, name)).psnr;
    if (!(found >= LEAST)) fail(`under the lobes of the dropped map: ${found.toFixed(1)} dB`);
    writeFileSync(join(folder, "map.png"), await browser.screenshot());
    return found;
}
