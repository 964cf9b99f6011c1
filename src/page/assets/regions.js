// Places on the object that have edits of their own: all that is near a line through points, as `Stroke` regions of a scene file
// have it; around one point that is a ball, their `Sphere`.

import { add, clamp, dot, length, scale, sub } from "lobelia/linear";

/** What the sliders of the material say when nothing is changed. */
export const UNCHANGED = { roughness: 0, level: 1, color: "#e6c065", mix: 0, metal: 0, tint: "#ffffff", bright: 1 };
/** Most places of a page: the shader's arrays. */
const MOST = 3;
/** Most points of a place, again the shader's; a scene file may have more. */
export const MOST_POINTS = 48;
/** Most base materials of an object (`MAX_SPECULAR_LOBES`): where places overlap, each of them doubles their number. */
const MOST_MATERIALS = 8;

/** How many places an object with so many base materials can have, so that Lobelia can render them. */
export function mostRegions(materials) {
    return clamp(Math.floor(Math.log2(MOST_MATERIALS / materials)), 1, MOST);
}

/** Whether a place's roughness and reflection can differ from the rest: they need base materials of their own. */
export const canShine = (materials) => 2 * materials <= MOST_MATERIALS;

/** Length over which the diffuse edit of a region sets in, and the radius within which its material is another: that has a hard edge. */
export const falloffOf = ({ radius, soft }) => radius * soft;
export const hardRadius = (region) => region.radius - falloffOf(region) / 2;

/** As `weight_at` of `pass::edit`. */
function weightAt(depth, falloff) {
    if (depth < 0) return 0;
    const t = depth < falloff ? depth / falloff : 1;
    return t * t * (3 - 2 * t);
}

/** As `distance_to_segment` of `pass::edit`. */
function distanceToSegment(point, start, end) {
    const [offset, along] = [sub(point, start), sub(end, start)];
    const squared = dot(along, along);
    const t = squared > 0 ? clamp(dot(offset, along) / squared, 0, 1) : 0;
    return length(sub(offset, scale(along, t)));
}

/** Distance of a point from the line through others. */
function distanceToLine(point, points) {
    const each = points.map((to, i) => distanceToSegment(point, points[Math.max(i - 1, 0)], to));
    return Math.min(...each);
}

/** The points of a line without which it goes elsewhere by more than a distance. */
export function thinned(points, most) {
    if (points.length < 3) return points;
    const [first, last] = [points[0], points.at(-1)];
    const away = points.map((point) => distanceToSegment(point, first, last));
    const farthest = away.indexOf(Math.max(...away));
    if (away[farthest] <= most) return [first, last];
    return [...thinned(points.slice(0, farthest + 1), most), ...thinned(points.slice(farthest), most).slice(1)];
}

/** Specular albedo and roughness of a base material after an edit: the steps of `ron.js`, in the same order. */
export function editedMaterial(lobe, { color, mix, level, roughness }) {
    const albedo = lobe.albedo.map((old, c) => {
        const blended = mix > 0 ? clamp(old + mix * (color[c] - old), 0, 1) : old;
        return clamp(blended * level, 0, 1);
    });
    return { ...lobe, albedo, roughness: clamp(lobe.roughness * roughness, 0.03, 1) };
}

/** The greatest roughness that a base material has anywhere: places may overlap. */
export function greatestRoughness(roughness, regions) {
    return regions.reduce((most, region) => Math.max(most, clamp(most * region.roughness, 0.03, 1)), roughness);
}

/** Diffuse and specular albedo at a point after the edits of regions, for light that goes from surface to surface. */
export function reflectedAt(place, diffuse, specular, regions) {
    for (const region of regions) {
        const away = distanceToLine(place, region.points);
        const weight = weightAt(region.radius - away, falloffOf(region));
        diffuse = diffuse.map((old, c) => old + weight * (Math.min(old * region.tint[c], 1) - old));
        if (away <= hardRadius(region)) specular = editedMaterial({ albedo: specular, roughness: 1 }, region).albedo;
    }
    return [diffuse, specular];
}

/** Regions as the surface's shader reads them, and the one that is outlined. */
export function regionUniforms(regions, mark) {
    return {
        regionCount: regions.length,
        regionPoint: padded(regions, 3 * MOST_POINTS, ({ points }) => points.flat()),
        regionLength: padded(regions, 1, ({ points }) => [points.length]),
        regionSize: padded(regions, 3, (region) => [region.radius, falloffOf(region), hardRadius(region)]),
        regionTint: padded(regions, 3, ({ tint }) => tint),
        regionColor: padded(regions, 4, ({ color, mix }) => [...color, mix]),
        regionGloss: padded(regions, 2, ({ level, roughness }) => [level, roughness]),
        mark: regions[mark] ? mark : -1,
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
    let nearest = Infinity;
    for (let t = 0; t < triangles.length; t += 3) {
        const along = hit(corners, 3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2], camera.eye, way);
        if (along < nearest) nearest = along;
    }
    return nearest < Infinity ? add(camera.eye, scale(way, nearest)) : null;
}

/** How far along a way from an eye a triangle lies, or infinity. Numbers, not vectors: a brush asks this of all triangles often. */
function hit(corners, a, b, c, eye, way) {
    const ax = corners[a], ay = corners[a + 1], az = corners[a + 2];
    const bx = corners[b] - ax, by = corners[b + 1] - ay, bz = corners[b + 2] - az;
    const cx = corners[c] - ax, cy = corners[c + 1] - ay, cz = corners[c + 2] - az;
    const wx = way[0], wy = way[1], wz = way[2];
    const px = wy * cz - wz * cy, py = wz * cx - wx * cz, pz = wx * cy - wy * cx;
    const volume = bx * px + by * py + bz * pz;
    if (volume === 0) return Infinity;
    const fx = eye[0] - ax, fy = eye[1] - ay, fz = eye[2] - az;
    const u = (fx * px + fy * py + fz * pz) / volume;
    if (u < 0 || u > 1) return Infinity;
    const qx = fy * bz - fz * by, qy = fz * bx - fx * bz, qz = fx * by - fy * bx;
    const v = (wx * qx + wy * qy + wz * qz) / volume;
    const along = (cx * qx + cy * qy + cz * qz) / volume;
    return v >= 0 && u + v <= 1 && along > 0 ? along : Infinity;
}
