// Octahedral tables of bits: which of many axes may lie within reach of a direction. The shader goes through the bits of the cell of
// its direction instead of all axes.

import { Texture } from "lobelia/gpu";
import { clamp, dot, unfolded } from "lobelia/linear";

/** Cells along each side of a table, as octahedral.glsl knows it; a power of two, so that the fold runs along diagonals of squares. */
const CELLS = 64;
/** Radians that are added to every reach for the shader's rounding. */
const MARGIN = 2e-3;

/** A square of cells, a cone around its directions, and its quarters. */
function square(x, y, side) {
    const at = (i, j) => unfolded((2 * i) / CELLS - 1, (2 * j) / CELLS - 1);
    const axis = at(x + side / 2, y + side / 2);
    // Edges and folds of a square are arcs of great circles: nothing is farther from its middle than its corners.
    const corners = [[x, y], [x + side, y], [x, y + side], [x + side, y + side]].map(([i, j]) => dot(axis, at(i, j)));
    const radius = Math.acos(clamp(Math.min(...corners), -1, 1)) + MARGIN;
    const half = side / 2;
    const quarters = [[x, y], [x + half, y], [x, y + half], [x + half, y + half]];
    return {
        at: y * CELLS + x, axis, radius, cosine: Math.cos(radius), sine: Math.sin(radius),
        quarters: side > 1 ? quarters.map(([i, j]) => square(i, j, half)) : [],
    };
}

/** Axes in a flat array, and how far from each a direction may be, in radians. */
class Cones {
    constructor(axes, reaches) {
        this.axes = Float64Array.from(axes.flat());
        this.reaches = Float64Array.from(reaches);
        this.cosines = this.reaches.map(Math.cos);
        this.sines = this.reaches.map(Math.sin);
    }

    /** Those of a list that may reach into a square but not all over it; of those that do reach all over it the bits are set. */
    into({ axis: [x, y, z], radius, cosine, sine }, list, words) {
        const { axes, reaches, cosines, sines } = this;
        const found = [];
        for (const k of list) {
            const along = x * axes[3 * k] + y * axes[3 * k + 1] + z * axes[3 * k + 2];
            const [product, change] = [cosines[k] * cosine, sines[k] * sine];
            if (reaches[k] >= radius && along >= product + change) words[k >> 5] |= 1 << (k & 31);
            else if (reaches[k] + radius >= Math.PI || along >= product - change) found.push(k);
        }
        return found;
    }

    /** Sets the bits of all cells of a square: `words` of all of them, and those of a list that may reach into each. */
    mark(bits, place, list, words) {
        const within = words.slice();
        const near = this.into(place, list, within);
        for (const quarter of place.quarters) this.mark(bits, quarter, near, within);
        if (place.quarters.length > 0) return;
        for (const k of near) within[k >> 5] |= 1 << (k & 31);
        bits.set(within, place.at * within.length);
    }
}

export class Masks {
    constructor(gl) {
        Object.assign(this, { gl, known: "", texture: null });
    }

    /** Fills one table for each list of reaches of the same axes, one below the other. */
    update(axes, lists) {
        const now = JSON.stringify([axes, lists]);
        if (now === this.known) return;
        this.known = now;
        Masks.whole ??= square(0, 0, CELLS);
        const blocks = Math.ceil(axes.length / 128);
        const [each, table] = [4 * blocks, 4 * blocks * CELLS * CELLS];
        const bits = new Uint32Array(table * lists.length);
        const all = axes.map((_, k) => k);
        lists.forEach((reaches, i) => {
            new Cones(axes, reaches).mark(bits.subarray(i * table, (i + 1) * table), Masks.whole, all, new Uint32Array(each));
        });
        const [width, height] = [CELLS * blocks, CELLS * lists.length];
        if (this.texture?.width !== width || this.texture?.height !== height) {
            this.texture?.free();
            this.texture = new Texture(this.gl, "rgba32ui", { width, height });
        }
        this.texture.fill(bits);
    }
}
