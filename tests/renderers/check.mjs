// Exported objects in other renderers against Lobelia's own: `node tests/renderers/check.mjs PROGRAM [FOLDER]`.
//
// Spheres of several materials under one light are exported, and rendered from the same camera by Lobelia's closed forms and path
// tracer, by three.js in a headless Chromium, and by Cycles. The mean radiance of each over the object is compared with Lobelia's.
// FOLDER keeps the files. A renderer that is not installed is left out with a word:
// - three.js: THREE names the folder of the npm package, or it lies in node_modules here; CHROMIUM names the browser.
// - Cycles: PYTHON names a Python that can import `bpy` (PyPI), python3 if it does not say.

import { spawnSync } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { dirname, extname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { Browser, findChromium } from "../view/browser.mjs";
import { readExr } from "../view/pictures.mjs";

/** Specular albedo, roughness and distribution of normals. */
const MATERIALS = [
    { specular: 0.04, roughness: 0.4, ndf: "Sg" },
    { specular: 0.1, roughness: 0.25, ndf: "Sg" },
    { specular: 0.2, roughness: 0.5, ndf: "Ggx" },
    { specular: 0.05, roughness: 0.8, ndf: "Sg" },
];

/**
 * Lights, and how far each renderer may be from Lobelia in mean radiance. Light from all sides alike shows the material alone. Lamps show
 * that the map is turned right, and how the renderer blurs it: three.js takes its roughest reflection for the cosine of diffuse light.
 * Blender has no reflectance along the surface, and so a brighter rim.
 */
const LIGHTS = [
    { name: "even", most: { "three.js": 0.03, Cycles: 0.06 }, lobes: "(axis: (0, 1, 0), sharpness: 0, amplitude: (0.7, 0.7, 0.7))" },
    {
        name: "lamps",
        most: { "three.js": 0.08, Cycles: 0.04 },
        lobes: `(axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.5, 0.5, 0.5)),
        (axis: (0.5, 0.6, 0.62), sharpness: 15, amplitude: (3, 2.8, 2.5)),
        (axis: (-0.8, 0.1, 0.3), sharpness: 40, amplitude: (2, 3, 5))`,
    },
];

const CAMERA = { eye: [1.9, 1.4, 2.6], fov: 38, size: 192 };
/** Least coverage of a pixel that counts: the rim is drawn differently everywhere. */
const COVERED = 0.999;

const HERE = dirname(fileURLToPath(import.meta.url));
const [program, folder = mkdtempSync(join(tmpdir(), "lobelia-renderers-"))] = process.argv.slice(2);
if (!program) throw new Error("usage: node tests/renderers/check.mjs PROGRAM [FOLDER]");

function scene({ specular, roughness, ndf }, { lobes }) {
    const { eye, fov, size } = CAMERA;
    return `Scene(
    version: 1,
    surface: Sphere(texture_size: 32),
    views: Cameras([(name: "a", eye: (${eye.join(", ")}), fov_degrees: ${fov}, width: ${size}, height: ${size})]),
    light: Fixed(Lobes(lobes: [${lobes}])),
    material: (
        albedo: Fixed(Constant(0.45, 0.3, 0.2)),
        specular: (albedo: Fixed(${specular}, ${specular}, ${specular}), roughness: Fixed(${roughness}), ndf: ${ndf}),
    ),
    passes: [
        Render(name: "closed"),
        Render(name: "paths", render: (shading: PathTraced(spp: 256))),
        Export(name: "export"),
    ],
)`;
}

/** Mean radiance of the channels over the pixels that the object covers. */
function mean(planes) {
    const inside = [...planes.A.keys()].filter((i) => planes.A[i] > COVERED);
    if (inside.length < 1000) throw new Error(`the object covers ${inside.length} pixels only`);
    const channel = (name) => inside.reduce((sum, i) => sum + planes[name][i], 0) / inside.length;
    return ["R", "G", "B"].map(channel);
}

function lobelia(home, material, light) {
    const file = join(home, "scene.ron");
    writeFileSync(file, scene(material, light));
    const { status, stderr } = spawnSync(resolve(program), ["run", file, "--quiet", "--force", "--out", join(home, "out")], { encoding: "utf8" });
    if (status !== 0) throw new Error(stderr);
    const read = (pass) => mean(readExr(readFileSync(join(home, "out", pass, "a.exr"))).planes);
    return { closed: read("closed"), paths: read("paths") };
}

/** Serves this folder, three.js and the results; modules and files cannot be loaded from the disk. */
async function serve(three) {
    const roots = { "/three/": three, "/here/": HERE, "/out/": resolve(folder) };
    const types = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript" };
    const server = createServer((request, response) => {
        const path = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
        const root = Object.keys(roots).find((root) => path.startsWith(root));
        const file = root && join(roots[root], path.slice(root.length));
        if (!file || !existsSync(file)) return response.writeHead(404).end();
        response.writeHead(200, { "Content-Type": types[extname(file)] ?? "application/octet-stream" }).end(readFileSync(file));
    });
    await new Promise((done) => server.listen(0, "127.0.0.1", done));
    return server;
}

/** A function from an export to what three.js shows, or null with a word. */
async function threeJs() {
    const chromium = findChromium();
    const three = [process.env.THREE, "node_modules/three"].filter(Boolean).map((path) => resolve(path)).find((path) => existsSync(join(path, "build/three.module.js")));
    if (!chromium || !three) {
        console.log(`three.js is left out: there is no ${chromium ? "three.js; say where with THREE=…" : "Chromium; say where with CHROMIUM=…"}`);
        return null;
    }
    const [server, browser] = [await serve(three), new Browser(chromium)];
    const address = `http://127.0.0.1:${server.address().port}`;
    const render = async (name) => {
        const query = new URLSearchParams({ base: `/out/${name}/out/export/`, camera: JSON.stringify(CAMERA) });
        await browser.open(`${address}/here/three.html?${query}`, 300, 300);
        const flat = await browser.evaluate("lobelia.pixels()");
        const plane = (c) => flat.filter((_, i) => i % 4 === c);
        return mean({ R: plane(0), G: plane(1), B: plane(2), A: plane(3) });
    };
    const close = async () => (await browser.close(), server.close());
    return { render, close };
}

/** The same with Cycles. */
function cycles() {
    const python = process.env.PYTHON ?? "python3";
    if (spawnSync(python, ["-c", "import bpy"]).status !== 0) {
        console.log("Cycles is left out: there is no bpy; say which Python has it with PYTHON=…");
        return null;
    }
    const render = async (name) => {
        const job = JSON.stringify({ folder: resolve(folder, name, "out/export"), camera: CAMERA, covered: COVERED });
        const { status, stdout, stderr } = spawnSync(python, [join(HERE, "blender.py"), job], { encoding: "utf8" });
        const found = stdout.split("\n").find((line) => line.startsWith("MEAN "));
        if (status !== 0 || !found) throw new Error(`Cycles: ${stderr || stdout}`);
        return JSON.parse(found.slice(5));
    };
    return { render, close: async () => {} };
}

const renderers = { "three.js": await threeJs(), Cycles: cycles() };
const sum = (color) => color[0] + color[1] + color[2];
let failed = 0;
const say = (words, ratio, most) => {
    const bad = !(Math.abs(ratio - 1) <= most);
    failed += bad;
    console.log(`${words}: ${ratio.toFixed(3)}${bad ? `   FAILED: not within ${most}` : ""}`);
};
try {
    for (const [i, material] of MATERIALS.entries()) {
        for (const light of LIGHTS) {
            const name = `${light.name}_${i}`;
            mkdirSync(join(folder, name), { recursive: true });
            const own = lobelia(join(folder, name), material, light);
            const words = `${light.name}, specular ${material.specular}, roughness ${material.roughness}, ${material.ndf}`;
            say(`${words}: path tracer over closed forms`, sum(own.paths) / sum(own.closed), 0.02);
            for (const [renderer, at] of Object.entries(renderers).filter(([, at]) => at)) {
                say(`${words}: ${renderer} over the path tracer`, sum(await at.render(name)) / sum(own.paths), light.most[renderer]);
            }
        }
    }
} finally {
    for (const at of Object.values(renderers)) await at?.close();
}
process.exit(failed > 0 ? 1 : 0);
