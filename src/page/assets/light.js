// Lobes as the shaders read them. The formulas are those of `accurate::diffuse` and `shading::limits` in Lobelia's crate of kernels.

import { clamp, dot, normalize, orthonormalPair, rotation, scale, times, transpose, IDENTITY, cross, product } from "lobelia/linear";

const SCALED_ERFC = [
    0.383841213067, 0.306753512712, 0.192277455528, 0.0898987791954, 0.0272801696181, 0.00238949866222,
    -0.00195151911803, -0.000670684595379, 0.000106820557434, 7.47882407367e-5,
];

/** Polynomial; the constant term comes first. */
const polynomial = (x, terms) => terms.reduceRight((sum, term) => sum * x + term, 0);

function scaledErfc(x) {
    const s = 1 / (1 + 0.36 * x);
    return polynomial(2 * s - 1, SCALED_ERFC) * s;
}

const fadingExp = (x) => Math.exp(Math.max(x, -60));

/** What of the diffuse integral depends on the sharpness alone: t, up, low, e^-t², and that times erfc. */
export function sharpnessTerms(l) {
    const n = (l + 2.73608316) * l + 17.0212978;
    const d = ((l + 4.01008267) * l + 15.2191563) * l + 76.0878963;
    const t = l * Math.sqrt((0.5 * n) / d);
    const e = fadingExp(-l);
    let up, q;
    if (l < 0.5) {
        up = polynomial(l, [0.5, -1 / 6, 1 / 24, -1 / 120, 1 / 720, -1 / 5040, 1 / 40320]);
        q = polynomial(l, [0.5, -1 / 3, 0.125, -1 / 30, 1 / 144, -1 / 840, 1 / 5760]);
    } else {
        const g = (1 - e) / l;
        up = (1 - g) / l;
        q = (g - e) / l;
    }
    const axis = fadingExp(-t * t);
    return [t, up, e * q, axis, axis * scaledErfc(t)];
}

/** Integral of a lobe of unit amplitude over the sphere. */
export function sphereIntegral(l) {
    return l < 1e-6 ? 4 * Math.PI : (-2 * Math.PI * Math.expm1(-2 * l)) / l;
}

/** The lobes of a light of the page: axis, sharpness, amplitude. */
export function lobesOf(numbers) {
    const lobes = [];
    for (let i = 0; i < numbers.length; i += 7) {
        const at = (from, to) => Array.from(numbers.subarray(i + from, i + to));
        lobes.push({ axis: at(0, 3), sharpness: numbers[i + 3], amplitude: at(4, 7) });
    }
    return lobes;
}

/** Exponents above which a lobe's specular light is negligible. */
function exponentLimits(lobes) {
    const brightest = lobes.map(({ amplitude }) => Math.max(...amplitude));
    const mean = (l) => -Math.expm1(-2 * Math.max(l, 1e-6)) / (2 * Math.max(l, 1e-6));
    const total = lobes.reduce((sum, lobe, i) => sum + brightest[i] * mean(lobe.sharpness), 0);
    const average = brightest.reduce((sum, value) => sum + value, 0) / lobes.length;
    const least = Math.max((0.1 * total) / lobes.length, 1e-30);
    return brightest.map((value) => Math.log(Math.max(Math.max(value, average) / least, 1e-30)));
}

/** Sharpness of the broadest SG of a base material's distribution of normals, as the shaders have it. */
function broadestFacets(roughness, ggx) {
    const alpha2 = roughness ** 4;
    if (!ggx) return 2 / alpha2;
    const scaled = Math.max(1 / alpha2 - 1, 1e-2) * 0.100521506;
    return scaled * (2 - 1 / (2 * scaled + 1));
}

/** How far from the mirrored view, in radians, the axis of each lobe may be for its specular light to count. */
export function specularReaches(lobes, roughness, ggx) {
    const limits = exponentLimits(lobes);
    const wide = 0.25 * broadestFacets(roughness, ggx);
    return lobes.map(({ sharpness }, i) => {
        const narrow = (wide * sharpness) / (wide + sharpness);
        return Math.acos(clamp(1 - limits[i] / narrow, -1, 1));
    });
}

/** Numbers of a table of lobes, four texels a lobe. */
export function lobeTable(lobes) {
    const limits = exponentLimits(lobes);
    const table = new Float32Array(lobes.length * 16);
    lobes.forEach(({ axis, sharpness, amplitude }, i) => {
        const [t, up, low, edge, tail] = sharpnessTerms(sharpness);
        table.set([...axis, sharpness, ...amplitude, limits[i], t, up, low, edge, tail, 0, 0, 0], 16 * i);
    });
    return table;
}

/** The rotation from a light's frame into the world, for a camera's axes (right, down, forward). */
export function worldFromLight(frame, axes) {
    if (frame === "world") return IDENTITY;
    if (frame === "camera") return [axes[0], scale(axes[1], -1), scale(axes[2], -1)];
    const axis = normalize(frame);
    const [side, front] = orthonormalPair(axis);
    const [x, y] = axes;
    const across = Math.abs(dot(x, axis)) <= Math.abs(dot(y, axis)) ? x : y;
    const angle = Math.atan2(dot(across, side), dot(across, front));
    const sense = -Math.sign(dot(axis, cross(front, side)));
    return transpose(rotation(axis, sense * angle));
}

/** The lobes of a light as they stand in the world: in its frame, then turned about the up direction. */
export function turnedLobes(light, up, degrees, axes) {
    const turn = product(rotation(up, (degrees * Math.PI) / 180), worldFromLight(light.frame, axes));
    return light.lobes.map((lobe) => ({ ...lobe, axis: normalize(times(turn, lobe.axis)) }));
}
