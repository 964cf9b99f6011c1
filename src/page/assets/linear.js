// Vectors as arrays of three numbers, matrices as arrays of columns.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a) => Math.sqrt(dot(a, a));
export const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

export const cross = (a, b) => [
    a[1] * b[2] - a[2] * b[1],
    a[2] * b[0] - a[0] * b[2],
    a[0] * b[1] - a[1] * b[0],
];

export function normalize(a) {
    const size = length(a);
    return size > 0 ? scale(a, 1 / size) : [0, 1, 0];
}

/** The unit direction of octahedral coordinates, −1 to 1. */
export function unfolded(x, y) {
    const z = 1 - Math.abs(x) - Math.abs(y);
    const fold = Math.max(-z, 0);
    return normalize([x - (x < 0 ? -fold : fold), y - (y < 0 ? -fold : fold), z]);
}

/** Matrix times vector. */
export const times = (m, v) => add(add(scale(m[0], v[0]), scale(m[1], v[1])), scale(m[2], v[2]));

/** Matrix times matrix. */
export const product = (a, b) => b.map((column) => times(a, column));

export const transpose = (m) => [0, 1, 2].map((row) => [m[0][row], m[1][row], m[2][row]]);

export const IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/** Turn by an angle in radians about a unit axis. */
export function rotation(axis, angle) {
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    const turned = (v) => add(add(scale(v, c), scale(cross(axis, v), s)), scale(axis, dot(axis, v) * (1 - c)));
    return IDENTITY.map(turned);
}

/** Two unit vectors across a unit axis, as `any_orthonormal_pair` of the glam crate has them. */
export function orthonormalPair([x, y, z]) {
    const sign = z < 0 || Object.is(z, -0) ? -1 : 1;
    const a = -1 / (sign + z);
    const b = x * y * a;
    return [[1 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]];
}
