// Places on the object that have edits of their own: balls in the world, as `Sphere` regions of a scene file have them.

import { add, clamp, cross, dot, length, scale, sub } from "lobelia/linear";

/** What the sliders of the material say when nothing is changed. */
export const UNCHANGED = { roughness: 0, level: 1, color: "#e6c065", mix: 0, metal: 0, tint: "#ffffff", bright: 1 };
/** Most places of a page: the shader's arrays. */
const MOST = 3;
/** Most base materials of an object (`MAX_SPECULAR_LOBES`): where places overlap, each of them doubles their number. */
const MOST_MATERIALS = 8;

/** How many places an object with so many base materials can have, so that Lobelia can render them. */
export function mostRegions(materials) {
    return clamp(Math.floor(Math.log2(MOST_MATERIALS / materials)), 1, MOST);
}

/** Whether a place's roughness and reflection can differ from the rest: they need base materials of their own. */
export const canShine = (materials) => 2 * materials <= MOST_MATERIALS;

/** Length over which the diffuse edit of a region sets in, and the ball in which its material is another: that has a hard edge. */
export const falloffOf = ({ radius, soft }) => radius * soft;
export const hardRadius = (region) => region.radius - falloffOf(region) / 2;

/** As `weight_at` of `pass::edit`. */
function weightAt(depth, falloff) {
    if (depth < 0) return 0;
    const t = depth < falloff ? depth / falloff : 1;
    return t * t * (3 - 2 * t);
}

/** Specular albedo and roughness of a base material after an edit: the steps of `ron.js`, in the same order. */
export function editedMaterial(lobe, { color, mix, level, roughness }) {
    const albedo = lobe.albedo.map((old, c) => {
        const blended = mix > 0 ? clamp(old + mix * (color[c] - old), 0, 1) : old;
        return clamp(blended * level, 0, 1);
    });
    return { ...lobe, albedo, roughness: clamp(lobe.roughness * roughness, 0.03, 1) };
}

/** Diffuse and specular albedo at a point after the edits of regions, for light that goes from surface to surface. */
export function reflectedAt(place, diffuse, specular, regions) {
    for (const region of regions) {
        const away = length(sub(place, region.center));
        const weight = weightAt(region.radius - away, falloffOf(region));
        diffuse = diffuse.map((old, c) => old + weight * (Math.min(old * region.tint[c], 1) - old));
        if (away <= hardRadius(region)) specular = editedMaterial({ albedo: specular, roughness: 1 }, region).albedo;
    }
    return [diffuse, specular];
}

/** Regions as the surface's shader reads them, and the one that is outlined. */
export function regionUniforms(regions, mark) {
    const outlined = regions[mark];
    return {
        regionCount: regions.length,
        regionBall: padded(regions, 4, ({ center, radius }) => [...center, radius]),
        regionSoft: padded(regions, 2, (region) => [falloffOf(region), hardRadius(region)]),
        regionTint: padded(regions, 3, ({ tint }) => tint),
        regionColor: padded(regions, 4, ({ color, mix }) => [...color, mix]),
        regionGloss: padded(regions, 2, ({ level, roughness }) => [level, roughness]),
        mark: outlined ? [...outlined.center, outlined.radius] : [0, 0, 0, -1],
    };
}

function padded(regions, width, numbers) {
    const all = new Float32Array(MOST * width);
    regions.forEach((region, i) => all.set(numbers(region), i * width));
    return all;
}

/** Corners of the mesh in the world, three numbers each. */
export function cornersOf({ mesh, data }) {
    return Float32Array.from(data.positions, (fraction, i) => mesh.low[i % 3] + (mesh.size[i % 3] * fraction) / 65535);
}

/** The mean place of each patch of the surface, or null where no corner of the mesh is in it. */
export function placesOfPatches(scene, count) {
    const { mesh, data, texture: [width, height] } = scene;
    const corners = cornersOf(scene);
    const sums = Array.from({ length: count }, () => [0, 0, 0, 0]);
    for (let i = 0; i < corners.length / 3; i++) {
        const [u, v] = [0, 1].map((c) => mesh.uvLow[c] + (mesh.uvSize[c] * data.uvs[2 * i + c]) / 65535);
        const [x, y] = [clamp(Math.floor(u * width), 0, width - 1), clamp(Math.floor(v * height), 0, height - 1)];
        const sum = sums[data.patchOfTexel[y * width + x]];
        if (sum) [corners[3 * i], corners[3 * i + 1], corners[3 * i + 2], 1].forEach((x, k) => (sum[k] += x));
    }
    return sums.map(([x, y, z, n]) => (n > 0 ? [x / n, y / n, z / n] : null));
}

/** The ray through a point of a canvas of this size, in which the camera's picture is as large as fits. */
function rayThrough(camera, [px, py], [width, height]) {
    const fit = Math.min(width / camera.width, height / camera.height);
    const y = ((py - height / 2) / fit + camera.height / 2 - camera.center[1]) / camera.focal[1];
    const x = ((px - width / 2) / fit + camera.width / 2 - camera.center[0] - camera.skew * y) / camera.focal[0];
    return add(add(scale(camera.axes[0], x), scale(camera.axes[1], y)), camera.axes[2]);
}

/** Where a point of the canvas shows the object; null beside it. */
export function pick(corners, triangles, camera, point, size) {
    const way = rayThrough(camera, point, size);
    const corner = (i) => [corners[3 * i], corners[3 * i + 1], corners[3 * i + 2]];
    let nearest = Infinity;
    for (let t = 0; t < triangles.length; t += 3) {
        const a = corner(triangles[t]);
        const [ab, ac] = [sub(corner(triangles[t + 1]), a), sub(corner(triangles[t + 2]), a)];
        const across = cross(way, ac);
        const size = dot(ab, across);
        if (size === 0) continue;
        const from = sub(camera.eye, a);
        const u = dot(from, across) / size;
        if (u < 0 || u > 1) continue;
        const turned = cross(from, ab);
        const v = dot(way, turned) / size;
        const along = dot(ac, turned) / size;
        if (v >= 0 && u + v <= 1 && along > 0 && along < nearest) nearest = along;
    }
    return nearest < Infinity ? add(camera.eye, scale(way, nearest)) : null;
}
