// The page against Lobelia's own closed-form renders: `node tests/view/check.mjs PROGRAM [FOLDER]`.
//
// For an object with shadows, with either distribution of normals, the page's pictures of several states are compared with what the
// passes that "copy as RON" gives for these states render. FOLDER keeps what was compared, and screenshots. Skipped, with
// exit code 0 and a word, where there is no Chromium.

import { spawnSync } from "node:child_process";
import { mkdirSync, mkdtempSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";
import { Browser, findChromium } from "./browser.mjs";
import { besidePhotographs, byHand, dropped } from "./hand.mjs";
import { droppedMap, fitted, readForms } from "./maps.mjs";
import { gltf, photographed, scene, tilt } from "./object.mjs";
import { paced } from "./pace.mjs";
import { layerPicture, psnr, readExr, readPng, writeExr } from "./pictures.mjs";

/** Least PSNR of a state, in dB over the object's pixels. */
const LEAST = 40;

/** The same where much is seen of what the object mirrors of itself: Lobelia finds that by rays, the page by the directions of each texel. */
const MIRRORED = 37;

/** Samples along each side of a pixel: software GL places corners to 1/16 of a pixel only. */
const SIDE = 4;

/** States: the page, the view, the settings of the page, and the layer that is compared if it is not the
 * whole; `once` with one distribution of normals alone. */
const STATES = [
    { name: "as found", page: "plain", view: 0, settings: {} },
    { name: "as found, from below", once: true, page: "plain", view: 1, settings: {} },
    { name: "relit", page: "plain", view: 0, settings: { light: 1 } },
    { name: "relit and turned", once: true, page: "plain", view: 1, settings: { light: 1, turn: 75, exposure: 0.6 } },
    { name: "own light turned", once: true, page: "plain", view: 0, settings: { turn: -130 } },
    { name: "smoother", least: MIRRORED, page: "plain", view: 0, settings: { roughness: -1 } },
    { name: "golden", once: true, page: "plain", view: 1, settings: { roughness: 0.4, color: "#e6a530", mix: 0.8, level: 1.3, tint: "#6070a0", bright: 1.4 } },
    { name: "half a metal", once: true, page: "plain", view: 0, settings: { metal: 0.6, color: "#d08060", mix: 0.3 } },
    { name: "diffuse alone", once: true, page: "plain", view: 0, settings: { show: "diffuse" }, layer: "diffuse" },
    { name: "specular alone", least: MIRRORED, page: "plain", view: 0, settings: { show: "specular" }, layer: "specular" },
    { name: "albedo", once: true, page: "painted_page", view: 0, settings: { show: "albedo" }, layer: "albedo" },
    { name: "painted", page: "painted_page", view: 0, settings: {} },
    { name: "painted, relit, rougher", page: "painted_page", view: 1, settings: { light: 1, roughness: 0.8, turn: 20 } },
];

/** Two places with edits of their own, which overlap. Their hard edges run along texels in a pass, and through them in the page. */
const PLACES = [
    { points: [[0.6, 0.15, 0.1]], radius: 0.42, soft: 0.4, roughness: -1, level: 3, color: "#e6a530", mix: 0, metal: 0, tint: "#40c060", bright: 1 },
    { points: [[0.1, 0.4, 0.1]], radius: 0.5, soft: 0, roughness: 0, level: 1, color: "#e6a530", mix: 0, metal: 0.8, tint: "#ffffff", bright: 0.5 },
];
/** Two strokes of the brush, one along the ring and one over the ball. */
const STROKES = [
    {
        points: [0.1, 0.4, 0.7, 1, 1.3, 1.6].map((a) => [0.62 * Math.cos(a), 0.2, 0.62 * Math.sin(a)]),
        radius: 0.13, soft: 0.5, roughness: -1, level: 3, color: "#e6a530", mix: 0, metal: 0, tint: "#40c060", bright: 1,
    },
    {
        points: [[-0.1, 0.4, 0.2], [0.15, 0.4, 0.15], [0.3, 0.2, 0.1]],
        radius: 0.1, soft: 0, roughness: 0, level: 1, color: "#e6a530", mix: 0, metal: 0.8, tint: "#ffffff", bright: 0.5,
    },
];
STATES.splice(7, 0, { name: "brushed", once: true, least: 36, page: "plain", view: 0, settings: { regions: STROKES } });
STATES.splice(7, 0, { name: "places", once: true, least: 36, page: "plain", view: 0, settings: { regions: PLACES } });

const [program, folder = mkdtempSync(join(tmpdir(), "lobelia-view-check-"))] = process.argv.slice(2);
if (!program) throw new Error("usage: node tests/view/check.mjs PROGRAM [FOLDER]");
const chromium = findChromium();
if (!chromium) {
    console.log("skipped: there is no Chromium; say where it is with CHROMIUM=…");
    process.exit(0);
}

function lobelia(...args) {
    const { status, stderr, error } = spawnSync(resolve(program), args, { encoding: "utf8" });
    if (status !== 0) throw new Error(`lobelia ${args.join(" ")}:\n${error ?? stderr}`);
}

/** The passes with as many samples a pixel as the page's pictures have. */
const finer = (ron) => ron.replace("render: (", `render: (samples_per_pixel: ${SIDE * SIDE}, `);

/** What the page's passes render. */
function reference(file, out, ron, view, layer) {
    lobelia("run", file, "--quiet", "--force", "--out", out, "--set", `passes=[${ron}]`);
    const rendered = join(out, "viewed", view);
    if (!layer) return readPng(readFileSync(`${rendered}.png`)).rgba;
    return layerPicture(readExr(readFileSync(`${rendered}.exr`)), layer).rgba;
}

const browser = new Browser(chromium);
let failed = 0;
const fail = (text) => (failed++, console.log(`FAILED: ${text}`));
try {
    for (const ndf of ["Sg", "Ggx"]) {
        const home = resolve(folder, ndf);
        mkdirSync(home, { recursive: true });
        writeFileSync(join(home, "object.gltf"), gltf());
        writeFileSync(join(home, "tilt.exr"), writeExr(128, 128, tilt(128)));
        const file = join(home, "scene.ron");
        writeFileSync(file, scene(ndf));
        lobelia("run", file, "--quiet", "--force", "--out", join(home, "out"));
        let open = "";
        for (const [i, { name, page, view, settings, layer, once, least = LEAST }] of STATES.entries()) {
            if (once && ndf !== "Sg") continue;
            if (open !== page) {
                open = page;
                await browser.open(pathToFileURL(join(home, "out", page, "view.html")).href, 900, 600);
            }
            const words = JSON.stringify({ ...settings, view });
            await browser.evaluate(`lobelia.set({ ...lobelia.defaults, ...${words} })`);
            const ron = finer(await browser.evaluate("lobelia.ron()"));
            const shown = await browser.evaluate(`Array.from(lobelia.picture(${view}, ${SIDE}))`);
            const viewName = await browser.evaluate(`lobelia.scene.cameras[${view}].name`);
            const truth = reference(file, join(home, `state${i}`), ron, viewName, layer);
            const found = psnr(shown, truth);
            console.log(`${ndf.padEnd(4)} ${name.padEnd(26)} ${found.psnr.toFixed(1)} dB, at most ${found.most} of 255`);
            if (!(found.psnr >= least)) fail(`${ndf}, ${name}: below ${least} dB`);
            writeFileSync(join(home, `state${i}.ron`), ron);
            writeFileSync(join(home, `state${i}.png`), await browser.screenshot());
        }
    }
    await live(join(resolve(folder), "Sg"));
    const pictures = join(resolve(folder), "Sg");
    await byHand(browser, pathToFileURL(join(pictures, "out", "plain", "view.html")).href, fail, pictures);
    writeFileSync(join(pictures, "photographed.ron"), photographed());
    lobelia("run", join(pictures, "photographed.ron"), "--quiet", "--force", "--out", join(pictures, "photographed"));
    const page = pathToFileURL(join(pictures, "photographed", "view", "view.html")).href;
    console.log(`error of photographs of the same object: ${(await besidePhotographs(browser, page, fail, pictures)).toFixed(1)} dB`);
    paced(fail);
    console.log(`128 lobes of a map: ${fitted(await readForms(fail), fail).toFixed(0)} ms`);
    const address = pathToFileURL(join(pictures, "out", "plain", "view.html")).href;
    const under = (ron, view) => reference(join(pictures, "scene.ron"), join(pictures, "under"), finer(ron), view);
    const map = { lobelia, address, folder: pictures, dropped, reference: under, side: SIDE };
    console.log(`under the lobes of a dropped map: ${(await droppedMap(browser, map, fail)).toFixed(1)} dB`);
    const kinds = browser.requests.filter((url) => !/^(file|data|blob):/.test(url) && url !== "about:blank");
    if (kinds.length > 0) fail(`the page asked for ${kinds.join(", ")}`);
    if (browser.messages.length > 0) fail(`the console says: ${browser.messages.join("; ")}`);
} finally {
    await browser.close();
}
console.log(failed === 0 ? `all as it should be; pictures are in ${folder}` : `${failed} failed`);
process.exit(failed === 0 ? 0 : 1);

/** The canvas itself, keys and dragging, and the page that `lobelia view` writes. */
async function live(home) {
    lobelia("view", join(home, "out"));
    const path = join(home, "out", "view.html");
    console.log(`page of lobelia view: ${(statSync(path).size / 2 ** 20).toFixed(2)} MiB`);
    await browser.open(pathToFileURL(path).href, 160, 120, true);
    await browser.evaluate(`document.getElementById("panel").classList.add("folded"),
        document.querySelectorAll("header, #fold").forEach((e) => (e.style.display = "none")), lobelia.set({ view: 0 }), lobelia.patience(1e6)`);
    await browser.until("lobelia.still()");
    const canvas = readPng(await browser.screenshot());
    const ron = finer(await browser.evaluate("lobelia.ron()"));
    const truth = reference(join(home, "scene.ron"), join(home, "live"), ron, "above");
    for (let i = 0; i < truth.length; i += 4) {
        for (let c = 0; c < 3; c++) truth[i + c] = (truth[i + c] * truth[i + 3] + 255 * (255 - truth[i + 3])) / 255;
        truth[i + 3] = 255;
    }
    const found = psnr(canvas.rgba, truth);
    console.log(`the canvas as it is seen: ${found.psnr.toFixed(1)} dB over the whole picture`);
    if (!(found.psnr >= LEAST)) fail("the canvas is not the render");

    await browser.resize(390, 780, true);
    await browser.open(pathToFileURL(path).href, 390, 780, true);
    await browser.until("lobelia.still()");
    writeFileSync(join(home, "phone.png"), await browser.screenshot());
    await browser.open(pathToFileURL(path).href, 1200, 760);
    await browser.until("lobelia.still()");
    writeFileSync(join(home, "desk.png"), await browser.screenshot());
    const before = await browser.evaluate("JSON.stringify(lobelia.camera())");
    await browser.drag([300, 300], [420, 340]);
    if (before === (await browser.evaluate("JSON.stringify(lobelia.camera())"))) fail("dragging does not turn the view");
    await browser.drag([300, 300], [400, 300], 8);
    if ((await browser.evaluate("lobelia.settings().turn")) !== 40) fail("shift-dragging does not turn the light by 40°");
    await browser.key("5");
    if ((await browser.evaluate("lobelia.settings().show")) !== "normals") fail("key 5 does not show normals");
    await browser.key(".");
    if ((await browser.evaluate("lobelia.settings().view")) !== 0) fail("the full stop does not step to a camera");
    await browser.key("r");
    if ((await browser.evaluate("lobelia.settings().turn")) !== 0) fail("R does not reset");
    await browser.key("c");
    if (!(await browser.evaluate("document.getElementById('text').open"))) fail("C does not show the passes");
    writeFileSync(join(home, "copied.png"), await browser.screenshot());
}
