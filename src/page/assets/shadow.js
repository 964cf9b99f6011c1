// Shadows and reflected light for any light: factors of all texels × lobes, irradiance from other parts of the object, and what the
// specular light needs. Follows `visibility::occlusion`.

import { Program, Target, Texture, cover } from "lobelia/gpu";
import { lobeTable, sphereIntegral } from "lobelia/light";
import { clamp, unfolded } from "lobelia/linear";
import { Masks } from "lobelia/masks";
import { greatestRoughness, placesOfPatches, reflectedAt } from "lobelia/regions";

const NONE = 4095;
const STEPS = 15;
/** Width of the table of hidden bits, as the shaders know it. */
const BITS_WIDTH = 4096;
const EACH_PATCH = 14;
/** Exponent of the mirrored lobe up to which directions count, as the surface's shader has it. */
const MIRROR_REACH = 4;

/** Unit directions of octahedral 16-bit fractions, four numbers each; the last says whether there is one. */
function decoded(fractions, present) {
    const out = new Float32Array((fractions.length / 2) * 4);
    for (let i = 0; i < fractions.length / 2; i++) {
        if (!present(i)) continue;
        const [x, y] = [0, 1].map((c) => (fractions[2 * i + c] / 65535) * 2 - 1);
        out.set([...unfolded(x, y), 1], 4 * i);
    }
    return out;
}

/** One picture of bits per direction, as bits of directions per texel. */
function bitsOfTexels(planes, texels, directions) {
    const words = 4 * Math.ceil(directions / 128);
    const height = Math.ceil((texels * words) / (4 * BITS_WIDTH));
    const bits = new Uint32Array(BITS_WIDTH * height * 4);
    const plane = Math.ceil(texels / 8);
    for (let d = 0; d < directions; d++) {
        const word = d >> 5;
        const mask = 1 << (d & 31);
        const from = d * plane;
        for (let byte = 0; byte < plane; byte++) {
            let left = planes[from + byte];
            for (let texel = 8 * byte; left !== 0; texel++, left >>= 1) {
                if (left & 1) bits[texel * words + word] |= mask;
            }
        }
    }
    return { bits, height };
}

export class Shadows {
    constructor(gl, scene, shaders) {
        const { directions, bounces, patches } = scene.visibility;
        const [width, height] = scene.texture;
        const { hidden, texelNormals, patchOfTexel, hiders, patchMeans, albedo, ways } = scene.data;
        Object.assign(this, { gl, directions, bounces, patches, means: patchMeans, lobeCount: -1 });
        this.ways = Array.from({ length: directions }, (_, d) => [...ways.subarray(3 * d, 3 * d + 3)]);
        this.places = placesOfPatches(scene, patches);
        const table = bitsOfTexels(hidden, width * height, directions);
        this.hidden = new Texture(gl, "rgba32ui", { width: BITS_WIDTH, height: table.height, data: table.bits });
        const normals = decoded(texelNormals, (i) => albedo[4 * i + 3] > 0);
        this.normals = new Texture(gl, "rgba32f", { width, height, data: normals });
        this.patchOfTexel = new Texture(gl, "r16ui", { width, height, data: patchOfTexel });
        this.hiders = new Texture(gl, "r16ui", { width: directions, height: patches, data: hiders });
        this.leaving = new Texture(gl, "rgba32f", { width: patches, height: 1 });
        this.sent = new Texture(gl, "rgba32f", { width: patches, height: 1 });
        this.sky = new Texture(gl, "rgba32f", { width: directions, height: 2 });
        this.indirect = new Texture(gl, "rgba16f", { width, height, filter: true });
        this.indirectTarget = new Target(gl, [[this.indirect, 0]]);
        this.occlusion = new Program(gl, shaders["texels.vert"], shaders.diffuse + shaders["occlusion.frag"]);
        this.bounce = new Program(gl, shaders["texels.vert"], `const float PI = 3.14159265358979;\n${shaders["indirect.frag"]}`);
        this.mask = new Masks(gl);
        this.listHiders(hiders);
    }

    /** The hidden directions of patches, one after another, with the cosine to the patch's normal. */
    listHiders(hiders) {
        const found = [];
        this.first = new Uint32Array(this.patches + 1);
        this.open = new Float32Array(this.patches * this.directions);
        for (let p = 0; p < this.patches; p++) {
            const normal = this.means.subarray(EACH_PATCH * p, EACH_PATCH * p + 3);
            const size = Math.hypot(...normal) || 1;
            for (let d = 0; d < this.directions; d++) {
                const way = this.ways[d];
                const cosine = (normal[0] * way[0] + normal[1] * way[1] + normal[2] * way[2]) / size;
                if (cosine <= 0) continue;
                const entry = hiders[p * this.directions + d];
                const part = (entry >> 12) / STEPS;
                this.open[p * this.directions + d] = (1 - part) * cosine;
                if (part > 0 && (entry & NONE) !== NONE) found.push([entry & NONE, part * cosine]);
            }
            this.first[p + 1] = found.length;
        }
        this.hider = Uint16Array.from(found, ([hider]) => hider);
        this.share = Float32Array.from(found, ([, share]) => share);
    }

    /** Textures for as many lobes. */
    makeRoom(count) {
        if (count === this.lobeCount) return;
        for (const old of [this.parts, this.table, this.weights, ...(this.partTargets ?? [])]) old?.free();
        this.lobeCount = count;
        const { width, height } = this.normals;
        const layers = 4 * Math.ceil(count / 16);
        const gl = this.gl;
        this.parts = new Texture(gl, "rgba8", { width, height, layers, filter: true });
        this.partTargets = [];
        for (let layer = 0; layer < layers; layer += 4) {
            this.partTargets.push(new Target(gl, [0, 1, 2, 3].map((i) => [this.parts, layer + i])));
        }
        this.table = new Texture(gl, "rgba32f", { width: 4, height: count });
        this.weights = new Texture(gl, "rgba32f", { width: Math.ceil(count / 4), height: this.directions });
    }

    /** Finds shadows and reflected light for these lobes and materials. */
    update(lobes, material) {
        this.makeRoom(lobes.length);
        const roughest = Math.max(...material.materials.map(({ roughness }) => greatestRoughness(roughness, material.regions)));
        this.mask.update(this.ways, [this.ways.map(() => this.reach(roughest))]);
        const cell = this.directions / 2;
        const wide = lobes.map((lobe) => {
            const sharpness = (lobe.sharpness * cell) / (lobe.sharpness + cell);
            const factor = sphereIntegral(lobe.sharpness) / sphereIntegral(sharpness);
            return { axis: lobe.axis, sharpness, amplitude: lobe.amplitude.map((a) => a * factor) };
        });
        this.table.fill(lobeTable(wide));
        const radiance = this.lightDirections(wide);
        const [before, last] = this.bounced(radiance, material);
        this.sent.fill(before);
        this.leaving.fill(last);
        this.draw(lobes.length);
    }

    /** How far from the mirrored view directions count for a roughness, in radians, seen from where that is farthest: straight above. */
    reach(roughness) {
        const cell = this.directions / 2;
        const lobe = 0.5 / roughness ** 4;
        return Math.acos(clamp(1 - MIRROR_REACH / ((lobe * cell) / (lobe + cell)), -1, 1));
    }

    /** Fills the tables of the sky, and returns its radiance from each direction. */
    lightDirections(lobes) {
        const stride = 4 * Math.ceil(lobes.length / 4);
        const weights = new Float32Array(stride * this.directions);
        const sky = new Float32Array(8 * this.directions);
        const radiance = new Float32Array(3 * this.directions);
        this.ways.forEach((way, d) => {
            const sum = [0, 0, 0];
            lobes.forEach(({ axis, sharpness, amplitude }, i) => {
                const weight = Math.exp(sharpness * (axis[0] * way[0] + axis[1] * way[1] + axis[2] * way[2] - 1));
                weights[d * stride + i] = weight;
                for (let c = 0; c < 3; c++) sum[c] += amplitude[c] * weight;
            });
            sky.set(way, 4 * d);
            sky.set(sum, 4 * (this.directions + d));
            radiance.set(sum, 3 * d);
        });
        this.weights.fill(weights);
        this.sky.fill(sky);
        return radiance;
    }

    /** Outgoing radiance of the patches, as if all reflection were diffuse: before the last bounce, and after it. */
    bounced(radiance, material) {
        const { patches, directions, open } = this;
        const cell = (4 * Math.PI) / directions;
        const direct = new Float32Array(3 * patches);
        for (let p = 0; p < patches; p++) {
            for (let d = 0; d < directions; d++) {
                const share = open[p * directions + d];
                if (share > 0) for (let c = 0; c < 3; c++) direct[3 * p + c] += cell * share * radiance[3 * d + c];
            }
        }
        const reflectance = this.reflectances(material);
        const reflected = (light) => light.map((value, i) => (value * reflectance[i]) / Math.PI);
        let [before, last] = [reflected(direct), reflected(direct)];
        for (let bounce = 0; bounce < this.bounces; bounce++) {
            before = last;
            const sum = direct.slice();
            for (let p = 0; p < patches; p++) {
                for (let k = this.first[p]; k < this.first[p + 1]; k++) {
                    const [hider, share] = [this.hider[k], cell * this.share[k]];
                    for (let c = 0; c < 3; c++) sum[3 * p + c] += share * before[3 * hider + c];
                }
            }
            last = reflected(sum);
        }
        return [before, last].map((light) => {
            const texels = new Float32Array(4 * patches);
            for (let i = 0; i < 3 * patches; i++) texels[4 * Math.floor(i / 3) + (i % 3)] = light[i];
            return texels;
        });
    }

    reflectances({ tint, materials, regions }) {
        const out = new Float32Array(3 * this.patches);
        for (let p = 0; p < this.patches; p++) {
            const mean = this.means.subarray(EACH_PATCH * p, EACH_PATCH * (p + 1));
            let diffuse = [0, 1, 2].map((c) => Math.min(mean[3 + c] * tint[c], 1));
            let specular = [0, 1, 2].map((c) => materials.reduce((sum, { number, albedo }) => sum + mean[6 + number] * albedo[c], 0));
            if (this.places[p]) [diffuse, specular] = reflectedAt(this.places[p], diffuse, specular, regions);
            for (let c = 0; c < 3; c++) out[3 * p + c] = Math.min(diffuse[c] + specular[c], 1);
        }
        return out;
    }

    draw(count) {
        const { directions, hidden, normals, sky, weights, table } = this;
        this.partTargets.forEach((target, group) => {
            target.bind();
            const lobes = { lobes: table, weights, firstLobe: 16 * group, lobeCount: count };
            this.occlusion.use({ directions, hidden, normals, sky, ...lobes });
            cover(this.gl);
        });
        this.indirectTarget.bind();
        const { patchOfTexel, hiders, sent } = this;
        if (this.bounces > 0) {
            this.bounce.use({ directions, hidden, normals, sky, patchOfTexel, hiders, leaving: sent });
            cover(this.gl);
        } else {
            this.gl.clearColor(0, 0, 0, 1);
            this.gl.clear(this.gl.COLOR_BUFFER_BIT);
        }
    }

    /** What the surface's shader reads. */
    get uniforms() {
        const { directions, hidden, patchOfTexel, hiders, leaving, sky, parts, indirect, mask } = this;
        return { shadowed: true, directions, directionMask: mask.texture, hidden, patchOfTexel, hiders, leaving, sky, parts, indirect };
    }
}

/** What the surface's shader reads of an object that hides nothing from itself. */
export function openSky(gl) {
    const one = (format, layers = 0) => new Texture(gl, format, { width: 1, height: 1, layers });
    const [bits, short, number] = [one("rgba32ui"), one("r16ui"), one("rgba32f")];
    return {
        uniforms: {
            shadowed: false, directions: 128, directionMask: bits, hidden: bits, patchOfTexel: short, hiders: short,
            leaving: number, sky: number, parts: one("rgba8", 1), indirect: number,
        },
        update() {},
    };
}
