// Exported objects in other renderers against Lobelia's own:
// `node tests/renderers/check.mjs PROGRAM [FOLDER] [--object SAVED]… [--set PATH=VALUE]…`.
//
// Spheres of several materials under two lights are exported, and rendered from the same camera by Lobelia's closed forms and path
// tracer, by three.js in a headless Chromium, and by Cycles. The mean radiance of each over the object is compared with Lobelia's. With
// `--object`, these are objects that a run has saved instead (SAVED is the folder of its `Save` pass), each from four sides. three.js
// lets an object throw no shadows on itself, so it is also compared with Lobelia's closed forms without them. `--set` changes the scenes
// as in `lobelia run`, to look at one part alone: `--set 'material.albedo=Fixed(Constant(0, 0, 0))'`; then no difference is too large.
// FOLDER keeps the files, with the pictures side by side in `NAME/VIEW.exr`. A renderer that is not installed is left out with a word:
// - three.js: THREE names the folder of the npm package, or it lies in node_modules here; CHROMIUM names the browser.
// - Cycles: PYTHON names a Python that can import `bpy` (PyPI), python3 if it does not say.

import { spawnSync } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { basename, dirname, extname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";
import { Browser, findChromium } from "../view/browser.mjs";
import { readExr, writeExr } from "../view/pictures.mjs";

/** Specular albedo, roughness and distribution of normals. */
const MATERIALS = [
    { specular: 0.04, roughness: 0.4, ndf: "Sg" },
    { specular: 0.1, roughness: 0.25, ndf: "Sg" },
    { specular: 0.2, roughness: 0.5, ndf: "Ggx" },
    { specular: 0.05, roughness: 0.8, ndf: "Sg" },
];

/**
 * Lights, and how far each renderer may be from Lobelia in mean radiance. Light from all sides alike shows the material alone. Lamps show
 * that the map is turned right, and how the renderer blurs it: three.js r170 takes its roughest reflection for the cosine of diffuse light.
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

/** How far each may be from Lobelia for saved objects: three.js from closed forms without shadows, Cycles from the path tracer. */
const OBJECT_MOST = { "three.js": 0.02, Cycles: 0.02 };

const [FOV, SIZE] = [38, 192];
/** Least coverage of a pixel that counts: the rim is drawn differently everywhere. */
const COVERED = 0.999;

const HERE = dirname(fileURLToPath(import.meta.url));
const many = { type: "string", multiple: true, default: [] };
const { values: options, positionals } = parseArgs({ allowPositionals: true, options: { object: many, set: many } });
const [program, folder = mkdtempSync(join(tmpdir(), "lobelia-renderers-"))] = positionals;
if (!program) throw new Error("usage: node tests/renderers/check.mjs PROGRAM [FOLDER] [--object SAVED]… [--set PATH=VALUE]…");

/** A sphere of each material under each light: the file of its scene, its cameras, and how far renderers may be off. */
function spheres() {
    return MATERIALS.flatMap(({ specular, roughness, ndf }, i) =>
        LIGHTS.map(({ name, most, lobes }) => {
            const home = join(folder, `${name}_${i}`);
            mkdirSync(home, { recursive: true });
            const text = `Scene(
    version: 1,
    surface: Sphere(texture_size: 32),
    light: Fixed(Lobes(lobes: [${lobes}])),
    material: (
        albedo: Fixed(Constant(0.45, 0.3, 0.2)),
        specular: (albedo: Fixed(${specular}, ${specular}, ${specular}), roughness: Fixed(${roughness}), ndf: ${ndf}),
    ),
)`;
            writeFileSync(join(home, "scene.ron"), text);
            const words = `${name}, specular ${specular}, roughness ${roughness}, ${ndf}`;
            const cameras = [{ name: "a", eye: [1.9, 1.4, 2.6], target: [0, 0, 0] }];
            return { home, scene: join(home, "scene.ron"), words, cameras, most };
        }),
    );
}

/** A saved object, seen whole from four sides. */
function saved(object, i) {
    const glb = readFileSync(join(object, "mesh.glb"));
    const { accessors, meshes } = JSON.parse(glb.toString("utf8", 20, 20 + glb.readUInt32LE(12)));
    const { min, max } = accessors[meshes[0].primitives[0].attributes.POSITION];
    const target = min.map((low, k) => (low + max[k]) / 2);
    const distance = (0.4 * Math.hypot(...min.map((low, k) => max[k] - low))) / Math.sin(((FOV / 2) * Math.PI) / 180);
    const sides = [[1, 0.5, 1], [1, -0.2, -1], [-1, 0.5, -1], [-1, -0.2, 1]];
    const cameras = sides.map((side, view) => {
        const eye = side.map((x, k) => target[k] + (distance * x) / Math.hypot(...side));
        return { name: "abcd"[view], eye, target };
    });
    const words = basename(dirname(resolve(object)));
    return { home: join(folder, `${words}_${i}`), scene: join(object, "scene.ron"), words, cameras, most: OBJECT_MOST, shadows: true };
}

/** Mean radiance over the pixels of all views that the object covers in both pictures, as the ratio of the first to the second. */
function ratio(pictures, others) {
    let [sum, other, count] = [0, 0, 0];
    pictures.forEach((picture, view) => {
        for (let i = 0; i < SIZE * SIZE; i++) {
            if (!(picture.A[i] > COVERED && others[view].A[i] > COVERED)) continue;
            for (const c of ["R", "G", "B"]) [sum, other] = [sum + picture[c][i], other + others[view][c][i]];
            count++;
        }
    });
    if (count < 1000) throw new Error(`the object covers ${count} pixels only`);
    return sum / other;
}

/** Lobelia's pictures of all views by closed forms and path tracer, and by closed forms without shadows; exports the object. */
function lobelia({ home, scene, cameras, shadows }) {
    const size = `fov_degrees: ${FOV}, width: ${SIZE}, height: ${SIZE}`;
    const specs = cameras.map(({ name, eye, target }) => `(name: "${name}", eye: (${eye.join()}), target: (${target.join()}), ${size})`);
    const run = (out, passes, ...more) => {
        const set = [...options.set, ...more, `views=Cameras([${specs.join()}])`, `passes=[${passes.join()}]`].flatMap((value) => ["--set", value]);
        const { status, stderr } = spawnSync(resolve(program), ["run", scene, "--quiet", "--force", "--out", join(home, out), ...set], { encoding: "utf8" });
        if (status !== 0) throw new Error(stderr);
    };
    const read = (pass) => cameras.map(({ name }) => readExr(readFileSync(join(home, pass, `${name}.exr`))).planes);
    const closed = 'Render(name: "closed")';
    run("out", [closed, 'Render(name: "paths", render: (shading: PathTraced(spp: 256)))', 'Export(name: "export")']);
    if (shadows) run("unshadowed", [closed], "visibility=None");
    return { closed: read("out/closed"), paths: read("out/paths"), unshadowed: shadows ? read("unshadowed/closed") : null };
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
    const render = async (home, camera) => {
        const query = new URLSearchParams({ base: `/out/${basename(home)}/out/export/`, camera: JSON.stringify({ ...camera, fov: FOV, size: SIZE }) });
        await browser.open(`${address}/here/three.html?${query}`, 300, 300);
        const flat = await browser.evaluate("lobelia.pixels()");
        // Its rows begin at the bottom.
        const at = (i) => (SIZE - 1 - Math.floor(i / SIZE)) * SIZE + (i % SIZE);
        const plane = (c) => Float32Array.from({ length: SIZE * SIZE }, (_, i) => flat[4 * at(i) + c]);
        return { R: plane(0), G: plane(1), B: plane(2), A: plane(3) };
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
    const render = async (home, camera) => {
        const picture = resolve(home, "out", `cycles_${camera.name}.exr`);
        const job = JSON.stringify({ folder: resolve(home, "out/export"), camera: { ...camera, fov: FOV, size: SIZE }, picture });
        const { status, stdout, stderr } = spawnSync(python, [join(HERE, "blender.py"), job], { encoding: "utf8" });
        if (status !== 0 || !existsSync(picture)) throw new Error(`Cycles: ${stderr || stdout}`);
        return readExr(readFileSync(picture)).planes;
    };
    return { render, close: async () => {} };
}

/** The pictures of a view side by side. */
function strip(pictures) {
    const wide = (c) => Float32Array.from({ length: SIZE * SIZE * pictures.length }, (_, i) => {
        const [x, y] = [i % (SIZE * pictures.length), Math.floor(i / (SIZE * pictures.length))];
        return pictures[Math.floor(x / SIZE)][c][y * SIZE + (x % SIZE)];
    });
    return writeExr(SIZE * pictures.length, SIZE, { R: wide("R"), G: wide("G"), B: wide("B"), A: wide("A") }, { compression: 3 });
}

const renderers = Object.entries({ "three.js": await threeJs(), Cycles: cycles() }).filter(([, at]) => at);
let failed = 0;
const say = (words, found, most) => {
    const bad = !(Math.abs(found - 1) <= most) && options.set.length === 0;
    failed += bad;
    console.log(`${words}: ${found.toFixed(3)}${bad ? `   FAILED: not within ${most}` : ""}`);
};
try {
    for (const shown of options.object.length > 0 ? options.object.map(saved) : spheres()) {
        const { home, words, cameras, most } = shown;
        const { closed, paths, unshadowed } = lobelia(shown);
        say(`${words}: path tracer over closed forms`, ratio(paths, closed), 0.02);
        const rows = [paths];
        for (const [renderer, at] of renderers) {
            const pictures = [];
            for (const camera of cameras) pictures.push(await at.render(home, camera));
            rows.push(pictures);
            const without = unshadowed && renderer === "three.js";
            say(`${words}: ${renderer} over the path tracer`, ratio(pictures, paths), without ? Infinity : most[renderer]);
            if (without) say(`${words}: ${renderer} over closed forms without shadows`, ratio(pictures, unshadowed), most[renderer]);
        }
        if (unshadowed) rows.push(unshadowed);
        cameras.forEach(({ name }, view) => writeFileSync(join(home, `${name}.exr`), strip(rows.map((row) => row[view]))));
    }
} finally {
    for (const [, at] of renderers) await at.close();
}
process.exit(failed > 0 ? 1 : 0);
