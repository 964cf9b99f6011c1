// The object of check.mjs as a glTF file: a ring around a ball, which shade each other.

function surface(u, v, position, [left, right]) {
    const mesh = { positions: [], normals: [], uvs: [], triangles: [] };
    for (let j = 0; j <= v; j++) for (let i = 0; i <= u; i++) {
        const [place, normal] = position((2 * Math.PI * i) / u, j / v);
        mesh.positions.push(...place);
        mesh.normals.push(...normal);
        mesh.uvs.push(left + ((right - left) * i) / u, 0.02 + (0.96 * j) / v);
    }
    for (let j = 0; j < v; j++) for (let i = 0; i < u; i++) {
        const at = j * (u + 1) + i;
        const corners = [at, at + 1, at + u + 2, at + u + 1];
        for (const triangle of [[0, 2, 1], [0, 3, 2]]) {
            const [a, b, c] = triangle.map((k) => mesh.positions.slice(3 * corners[k], 3 * corners[k] + 3));
            const area = Math.hypot(...cross(minus(b, a), minus(c, a)));
            if (area > 1e-6) mesh.triangles.push(...triangle.map((k) => corners[k]));
        }
    }
    return mesh;
}

const minus = (a, b) => a.map((x, i) => x - b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** The text of the file. */
export function gltf() {
    const ring = surface(64, 28, (a, t) => {
        const b = -2 * Math.PI * t;
        const normal = [Math.cos(a) * Math.cos(b), Math.sin(b), Math.sin(a) * Math.cos(b)];
        return [[(0.62 + 0.2 * Math.cos(b)) * Math.cos(a), 0.2 * Math.sin(b), (0.62 + 0.2 * Math.cos(b)) * Math.sin(a)], normal];
    }, [0.02, 0.62]);
    const ball = surface(40, 20, (a, t) => {
        const b = Math.PI * t;
        const normal = [Math.sin(b) * Math.cos(a), Math.cos(b), Math.sin(b) * Math.sin(a)];
        return [normal.map((x, i) => 0.33 * x + (i === 1 ? 0.12 : 0)), normal];
    }, [0.66, 0.98]);
    const shift = ring.positions.length / 3;
    const joined = (key) => [...ring[key], ...ball[key]];
    const triangles = [...ring.triangles, ...ball.triangles.map((v) => v + shift)];
    const arrays = [joined("positions"), joined("normals"), joined("uvs")].map((values) => Float32Array.from(values));
    const parts = [...arrays, Uint32Array.from(triangles)].map((array) => Buffer.from(array.buffer));
    let from = 0;
    const bufferViews = parts.map(({ byteLength }) => ({ buffer: 0, byteOffset: (from += byteLength) - byteLength, byteLength }));
    const count = arrays[0].length / 3;
    const low = [0, 1, 2].map((c) => Math.min(...arrays[0].filter((_, i) => i % 3 === c)));
    const high = [0, 1, 2].map((c) => Math.max(...arrays[0].filter((_, i) => i % 3 === c)));
    const accessor = (bufferView, type) => ({ bufferView, componentType: 5126, count, type });
    return JSON.stringify({
        asset: { version: "2.0" },
        scene: 0,
        scenes: [{ nodes: [0] }],
        nodes: [{ mesh: 0 }],
        meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 1, TEXCOORD_0: 2 }, indices: 3 }] }],
        accessors: [
            { ...accessor(0, "VEC3"), min: low, max: high }, accessor(1, "VEC3"), accessor(2, "VEC2"),
            { bufferView: 3, componentType: 5125, count: triangles.length, type: "SCALAR" },
        ],
        bufferViews,
        buffers: [{ byteLength: from, uri: `data:application/octet-stream;base64,${Buffer.concat(parts).toString("base64")}` }],
    });
}

/** Its light, as RON. */
const LIGHT = `Lobes(lobes: [
        (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6)),
        (axis: (0.5, 0.6, 0.62), sharpness: 40, amplitude: (5.5, 4.8, 3.9)),
        (axis: (-0.8, 0.3, 0.3), sharpness: 15, amplitude: (0.9, 1.1, 1.6)),
        (axis: (0.2, 0.2, -0.96), sharpness: 300, amplitude: (6, 6, 6)),
        (axis: (0, -1, 0), sharpness: 1, amplitude: (0.25, 0.18, 0.12)),
    ])`;

/** How its albedo depends on the side of view: width × width vectors, as channels. */
export function tilt(width) {
    const at = (wave) => Array.from({ length: width * width }, (_, i) => wave((i % width) / width, Math.floor(i / width) / width));
    return {
        X: at((x) => 0.5 * Math.sin(9 * x)),
        Y: at((_, y) => 0.5 * Math.cos(7 * y)),
        Z: at((x, y) => 0.5 * Math.sin(5 * (x + y))),
    };
}

/** A scene in which everything is known, of photographs that Lobelia's path tracer takes of it. */
export const photographed = () => `Scene(
    version: 1,
    surface: Mesh(path: "object.gltf", texture_size: 128),
    views: Photographed(
        cameras: (count: 3, test: 2, size: 128),
        spp: 64,
        truth: (light: ${LIGHT}, albedo: Constant(0.55, 0.35, 0.2), specular: (albedo: (0.25, 0.25, 0.25), roughness: 0.3)),
    ),
    light: Fixed(${LIGHT}),
    material: (
        albedo: Fixed(Constant(0.55, 0.35, 0.2)),
        specular: (albedo: Fixed(0.25, 0.25, 0.25), roughness: Fixed(0.3)),
    ),
    passes: [View(photographs: 4)],
)
`;

/** A scene of it: `ndf` is `Sg` or `Ggx`. */
export const scene = (ndf) => `Scene(
    version: 1,
    surface: Mesh(path: "object.gltf", texture_size: 128),
    views: Cameras([
        (name: "above", eye: (1.3, 1.5, 1.6), width: 160, height: 120),
        (name: "low", eye: (-2.1, 0.5, 0.9), width: 160, height: 120),
        (name: "tiny", eye: (-2.1, 0.5, 0.9), width: 16, height: 12),
    ]),
    light: Fixed(${LIGHT}),
    material: (
        albedo: Fixed(Constant(0.55, 0.35, 0.2)),
        tilt: Fixed("tilt.exr"),
        specular: (albedo: Fixed(0.25, 0.25, 0.25), roughness: Fixed(0.3), ndf: ${ndf}),
    ),
    passes: [
        Edit(name: "painted", edits: [
            Diffuse(action: Set(0.1, 0.3, 0.6), region: Sphere(center: (0, 0.12, 0), radius: 0.36)),
            Roughness(action: Set(0.12), region: Box(min: (0, -1, -1), max: (1, 1, 1), falloff: 0.2)),
        ], render: (views: Named(["tiny"]))),
        Relight(name: "evening", light: Lobes(lobes: [
            (axis: (-0.6, 0.5, 0.6), sharpness: 30, amplitude: (6, 5, 3.5)),
            (axis: (0, -1, 0), sharpness: 0.5, amplitude: (0.3, 0.3, 0.45)),
        ]), render: (views: Named(["tiny"]))),
        Save(),
        View(name: "plain"),
        View(name: "painted_page", of: "painted"),
    ],
)
`;
