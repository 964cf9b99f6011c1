// Lobes of a map: amplitudes of lobes that stand evenly around, by least squares.

/** Sweeps over the lobes, and the change, as a part of the largest amplitude, from which on there is no other. */
const SWEEPS = 300;
const SETTLED = 1e-5;

/** Directions on the Fibonacci spiral as Lobelia has them, and a sharpness at which what they sum up to is even. */
export function evenLobes(count) {
    const golden = Math.PI * (3 - Math.sqrt(5));
    const axis = (i) => {
        const y = 1 - (2 * i + 1) / count;
        const radius = Math.sqrt(1 - y * y);
        return [Math.cos(golden * i) * radius, y, Math.sin(golden * i) * radius];
    };
    return { axes: Array.from({ length: count }, (_, i) => axis(i)), sharpness: 0.8 * ((Math.LN2 * count) / 2) };
}

/** The direction of (u, v) in a map: +Y up, the left edge looks along −Z, a quarter in is +X, the middle +Z. */
export function direction(u, v) {
    const [phi, theta] = [Math.PI * v, 2 * Math.PI * u - Math.PI / 2];
    return [Math.cos(theta) * Math.sin(phi), Math.cos(phi), Math.sin(theta) * Math.sin(phi)];
}

/** Each lobe of amplitude 1 at each cell, lobe by lobe. */
function values({ width, height }, { axes, sharpness }) {
    const table = new Float64Array(axes.length * width * height);
    for (let cell = 0; cell < width * height; cell++) {
        const [x, y, z] = direction(((cell % width) + 0.5) / width, (Math.floor(cell / width) + 0.5) / height);
        axes.forEach((a, lobe) => {
            table[lobe * width * height + cell] = Math.exp(sharpness * (a[0] * x + a[1] * y + a[2] * z - 1));
        });
    }
    return table;
}

/** The normal equations: products of lobes with each other, and with the three channels of the map. */
function equations(cells, table, count) {
    const { solidAngle, radiance } = cells;
    const size = solidAngle.length;
    const [gram, right] = [new Float64Array(count * count), new Float64Array(3 * count)];
    const weighted = new Float64Array(size);
    for (let a = 0; a < count; a++) {
        for (let cell = 0; cell < size; cell++) {
            weighted[cell] = table[a * size + cell] * solidAngle[cell];
            for (let c = 0; c < 3; c++) right[3 * a + c] += weighted[cell] * radiance[3 * cell + c];
        }
        for (let b = 0; b <= a; b++) {
            let sum = 0;
            for (let cell = 0; cell < size; cell++) sum += weighted[cell] * table[b * size + cell];
            gram[a * count + b] = gram[b * count + a] = sum;
        }
    }
    return { gram, right };
}

/** The amplitudes, none below 0, that solve the equations best: one after the other, again and again. */
function solved({ gram, right }, count) {
    const amplitudes = new Float64Array(3 * count);
    for (let c = 0; c < 3; c++) {
        for (let sweep = 0, change = Infinity, largest = 0; sweep < SWEEPS && change > SETTLED * largest; sweep++) {
            [change, largest] = [0, 0];
            for (let a = 0; a < count; a++) {
                let rest = right[3 * a + c];
                for (let b = 0; b < count; b++) rest -= gram[a * count + b] * amplitudes[3 * b + c];
                const before = amplitudes[3 * a + c];
                const after = Math.max(0, before + rest / gram[a * count + a]);
                amplitudes[3 * a + c] = after;
                change = Math.max(change, Math.abs(after - before));
                largest = Math.max(largest, after);
            }
        }
    }
    return amplitudes;
}

/** At most `count` lobes of a map; those without light are left out. */
export function lobesOfCells(cells, count) {
    const lobes = evenLobes(count);
    const amplitudes = solved(equations(cells, values(cells, lobes), count), count);
    const found = lobes.axes.map((axis, i) => ({ axis, sharpness: lobes.sharpness, amplitude: [...amplitudes.subarray(3 * i, 3 * i + 3)] }));
    return found.filter(({ amplitude }) => amplitude.some((value) => value > 0));
}
