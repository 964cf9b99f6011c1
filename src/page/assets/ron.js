// What was done in the page, as passes of a scene file.

import { add, scale } from "lobelia/linear";
import { falloffOf, hardRadius } from "lobelia/regions";

/** A number as RON has it: short, and as exact as single precision. */
const number = (x) => String(Number(x.toPrecision(7)));
const triple = (v) => `(${v.map(number).join(", ")})`;
/** Three values of a variant, which have no parentheses of their own. */
const values = (v) => v.map(number).join(", ");
const same = (v, value) => v.every((x) => x === value);

/** The edits of the whole object, or of a place, in the order in which `editedMaterial` of regions.js applies them. */
function changes({ tint, color, mix, level, roughness }, soft = "", hard = "") {
    const made = [];
    if (!same(tint, 1)) made.push(`Diffuse(action: Scale(${values(tint)})${soft})`);
    if (mix > 0) made.push(`Specular(action: Blend(color: ${triple(color)}, weight: ${number(mix)})${hard})`);
    if (level !== 1) made.push(`Specular(action: Scale(${values([level, level, level])})${hard})`);
    if (roughness !== 1) made.push(`Roughness(action: Scale(${number(roughness)})${hard})`);
    return made;
}

/** Those of a place: its material has a hard edge in the middle of the border over which its albedo changes. */
function changesOf(region) {
    const [first, ...others] = region.points.map(triple);
    const line = others.length > 0 ? `Stroke(points: [${[first, ...others].join(", ")}]` : `Sphere(center: ${first}`;
    const within = `, region: ${line}, radius: `;
    const soft = `${within}${number(region.radius)}, falloff: ${number(falloffOf(region))})`;
    return changes(region, soft, `${within}${number(hardRadius(region))})`);
}

/** All edits: the scene's, then the page's. */
function edits(scene, state) {
    return [...scene.edits, ...changes(state), ...state.regions.flatMap(changesOf)];
}

function lightLines(lobes) {
    const line = ({ axis, sharpness, amplitude }) =>
        `        (axis: ${triple(axis)}, sharpness: ${number(sharpness)}, amplitude: ${triple(amplitude)}),\n`;
    return `    light: Lobes(lobes: [\n${lobes.map(line).join("")}    ]),\n`;
}

/** A moved camera as an entry of `views: Cameras([…])`, in a comment: passes have no cameras of their own. */
function cameraComment(camera, up, [width, height]) {
    const target = add(camera.eye, scale(camera.axes[2], 1));
    const fov = (2 * Math.atan(camera.height / (2 * camera.focal[1])) * 180) / Math.PI;
    const words = `eye: ${triple(camera.eye)}, target: ${triple(target)}, up: ${triple(up)}, fov_degrees: ${number(fov)}`;
    return `// Seen from (an entry of \`views: Cameras([…])\`):\n// (name: "viewed", ${words}, width: ${width}, height: ${height})\n`;
}

/** The pass that reproduces a state: `lobes` are those of its light, as they stand in the world. */
export function passes(scene, state, { light, lobes, view, camera, size }) {
    const made = edits(scene, state);
    const relit = !light.own || state.turn !== 0;
    const render = [];
    if (view) render.push(`views: Named(["${view.name}"])`);
    if (state.exposure !== 0) render.push(`exposure: ${number(state.exposure)}`);
    const comments = [];
    if (!view) comments.push(cameraComment(camera, scene.up, size));
    if (state.show !== "full") comments.push(`// Shown: ${state.show}; the pass writes it as a layer of its EXR files.\n`);
    if (relit && light.frame !== "world") comments.push("// The light as it stood for this camera: it goes around with the camera.\n");
    const kind = made.length > 0 ? "Edit" : relit ? "Relight" : "Render";
    let text = `${comments.join("")}${kind}(\n    name: "viewed",\n`;
    if (kind === "Edit") text += `    edits: [\n${made.map((edit) => `        ${edit},\n`).join("")}    ],\n`;
    if (relit) text += lightLines(lobes);
    if (render.length > 0) text += `    render: (${render.join(", ")}),\n`;
    return `${text}),\n`;
}
