// Pictures of the object: samples of every pixel are summed as linear radiance and then developed, as in Lobelia's own renders.

import { clipFromWorld, pixelSpan } from "lobelia/camera";
import { Program, Target, Texture, cover, coverAdding } from "lobelia/gpu";
import { lobeTable, lobesOf, specularReaches, turnedLobes } from "lobelia/light";
import { Masks } from "lobelia/masks";
import { editedMaterial, greatestRoughness, regionUniforms } from "lobelia/regions";
import { Shadows, openSky } from "lobelia/shadow";

/** What can be shown, in the order of the shader's numbers, and how it is encoded (develop.frag). */
export const SHOWS = [
    { name: "full", label: "All light", encoding: 0 },
    { name: "diffuse", label: "Diffuse", encoding: 0 },
    { name: "specular", label: "Specular", encoding: 0 },
    { name: "albedo", label: "Albedo", encoding: 1 },
    { name: "normals", label: "Normals", encoding: 2 },
    { name: "visibility", label: "Visibility", encoding: 2 },
    { name: "roughness", label: "Roughness", encoding: 2 },
];

/** The base materials, the albedo's factor and the places of other edits: the same steps as those of `ron.js`, in the same order. */
export function edited(scene, state) {
    return { materials: scene.materials.map((lobe) => editedMaterial(lobe, state)), tint: state.tint, regions: state.regions };
}

export class Renderer {
    constructor(canvas, scene, shaders) {
        const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance" });
        if (!gl) throw new Error("this browser has no WebGL 2");
        if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) {
            throw new Error("this browser cannot draw into floating-point textures");
        }
        gl.getExtension("EXT_float_blend");
        Object.assign(this, { gl, canvas, scene, target: null, known: "" });
        this.lights = scene.lights.map((light, i) => ({ ...light, lobes: lobesOf(scene.data[`light${i}`]) }));
        const [width, height] = scene.texture;
        this.albedo = new Texture(gl, "srgb8", { width, height, filter: true, data: scene.data.albedo });
        // What is seen along the surface; the same without a sheen.
        const { along } = scene.data;
        this.along = along ? new Texture(gl, "srgb8", { width, height, filter: true, data: along }) : this.albedo;
        this.tilt = this.tiltTexture(width, height);
        this.blend = this.blendTexture(width, height);
        const { octahedral, diffuse, specular } = shaders;
        this.buffer = new Program(gl, octahedral + shaders["surface.vert"], octahedral + shaders["buffer.frag"]);
        this.surface = new Program(gl, shaders["texels.vert"], octahedral + diffuse + specular + shaders["surface.frag"]);
        this.develop = new Program(gl, shaders["texels.vert"], shaders["develop.frag"]);
        this.lobeMask = new Masks(gl);
        this.shadows = scene.visibility ? new Shadows(gl, scene, shaders) : openSky(gl);
        this.loadMesh();
    }

    /** How the albedo depends on the side of view: bytes around 128; one texel of 128 without. */
    tiltTexture(width, height) {
        const { tilt } = this.scene.data;
        if (tilt) return new Texture(this.gl, "rgba8", { width, height, filter: true, data: tilt });
        return new Texture(this.gl, "rgba8", { width: 1, height: 1, data: new Uint8Array([128, 128, 128, 255]) });
    }

    /** Blend weights of eight base materials a texel, four a layer. */
    blendTexture(width, height) {
        const { blend } = this.scene.data;
        if (!blend) return new Texture(this.gl, "rgba8", { width: 1, height: 1, layers: 1 });
        const layers = new Uint8Array(blend.length);
        for (let i = 0; i < width * height; i++) {
            for (let k = 0; k < 8; k++) layers[(k >> 2) * 4 * width * height + 4 * i + (k & 3)] = blend[8 * i + k];
        }
        return new Texture(this.gl, "rgba8", { width, height, layers: 2, filter: true, data: layers });
    }

    loadMesh() {
        const { gl } = this;
        const { positions, normals, uvs, triangles } = this.scene.data;
        this.mesh = gl.createVertexArray();
        gl.bindVertexArray(this.mesh);
        [[positions, 3], [normals, 2], [uvs, 2]].forEach(([values, count], place) => {
            gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
            gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
            gl.enableVertexAttribArray(place);
            gl.vertexAttribPointer(place, count, gl.UNSIGNED_SHORT, true, 0, 0);
        });
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
        gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
        gl.bindVertexArray(null);
        this.count = triangles.length;
    }

    /** The lobes of the state's light as they stand in the world before this camera. */
    lobes(state, camera) {
        return turnedLobes(this.lights[state.light], this.scene.up, state.turn, camera.axes);
    }

    /** Makes light and material of this state ready; what has not changed is kept. */
    prepare(state, camera) {
        const { gl } = this;
        const material = edited(this.scene, state);
        const standing = this.lights[state.light].frame === "world" ? null : camera.axes;
        const now = JSON.stringify([state.light, state.turn, material, standing]);
        if (now === this.known) return;
        this.known = now;
        const lobes = this.lobes(state, camera);
        if (this.table?.height !== lobes.length) {
            this.table?.free();
            this.table = new Texture(gl, "rgba32f", { width: 4, height: lobes.length });
        }
        this.table.fill(lobeTable(lobes));
        this.shadows.update(lobes, material);
        const { materials, regions } = material;
        const reaches = materials.map(({ roughness, ggx }) => specularReaches(lobes, greatestRoughness(roughness, regions), ggx));
        this.lobeMask.update(lobes.map(({ axis }) => axis), reaches);
        this.light = { lobes: this.table, lobeCount: lobes.length, lobeMask: this.lobeMask.texture, tint: material.tint };
        this.gloss = {
            materials: materials.flatMap(({ albedo, roughness }) => [...albedo, roughness]),
            kinds: materials.flatMap(({ number, ggx }) => [number, Number(ggx)]),
            materialCount: materials.length, blended: this.scene.blended, blendMap: this.blend,
        };
    }

    /** An empty sum of samples of this size. */
    begin(width, height) {
        const { gl } = this;
        if (this.target?.width !== width || this.target?.height !== height) {
            for (const old of [this.target, this.sum, this.bufferTarget, this.surfaces]) old?.free();
            this.surfaces = new Texture(gl, "rgba32ui", { width, height });
            this.bufferTarget = new Target(gl, [[this.surfaces, 0]], true);
            this.sum = new Texture(gl, "rgba16f", { width, height });
            this.target = new Target(gl, [[this.sum, 0]], this.bufferTarget);
        }
        this.target.bind();
        gl.clearColor(0, 0, 0, 0);
        gl.clear(gl.COLOR_BUFFER_BIT);
        this.samples = 0;
    }

    /** Adds one sample of every pixel, `jitter` pixels right and down of its center. */
    sample(state, camera, jitter) {
        const { gl, scene } = this;
        const { width, height } = this.target;
        this.prepare(state, camera);
        this.findSurfaces(camera, jitter);
        this.target.bind();
        const { low, size, uvLow, uvSize } = scene.mesh;
        const seen = { surface: this.surfaces, low, size, uvLow, uvSize, eye: camera.eye, pixelSpan: pixelSpan(camera, width, height) };
        const show = SHOWS.findIndex(({ name }) => name === state.show);
        const maps = { albedoMap: this.albedo, alongMap: this.along, tiltMap: this.tilt };
        const regions = regionUniforms(state.regions, state.mark);
        this.surface.use({ ...seen, show, ...maps, ...regions, ...this.light, ...this.gloss, ...this.shadows.uniforms });
        // Pixels without a surface are left out by their depth, before they are shaded.
        coverAdding(gl);
        this.samples += 1;
    }

    /** Draws the nearest surface of each pixel into the buffer from which pixels are shaded. */
    findSurfaces(camera, jitter) {
        const { gl, scene, bufferTarget } = this;
        const { low, size } = scene.mesh;
        bufferTarget.bind();
        gl.disable(gl.BLEND);
        gl.enable(gl.DEPTH_TEST);
        gl.depthFunc(gl.LESS);
        gl.depthMask(true);
        gl.clear(gl.DEPTH_BUFFER_BIT);
        gl.bindVertexArray(this.mesh);
        this.buffer.use({ low, size, clipFromWorld: clipFromWorld(camera, bufferTarget.width, bufferTarget.height, jitter, scene) });
        gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    }

    /** Develops the sum into the current frame buffer, side × side texels a pixel; `backdrop` null: straight alpha. */
    finish(state, backdrop, side = 1) {
        const { encoding } = SHOWS.find(({ name }) => name === state.show);
        const shared = { sum: this.sum, samples: this.samples, exposure: state.exposure, encoding, side };
        this.develop.use({ ...shared, backdrop: backdrop ?? [-1, -1, -1] });
        cover(this.gl);
    }

    /** Develops the sum onto the canvas, which gets its size. */
    present(state) {
        const { gl, canvas } = this;
        const { width, height } = this.target;
        if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
        gl.viewport(0, 0, width, height);
        this.finish(state, state.backdrop);
    }

    /** A picture with side × side samples a pixel: 8-bit RGBA rows from the top, with straight alpha. */
    picture(state, camera, width, height, side) {
        const { gl } = this;
        this.begin(width * side, height * side);
        this.sample(state, camera, [0, 0]);
        const texture = new Texture(gl, "rgba8", { width, height });
        const target = new Target(gl, [[texture, 0]]);
        target.bind();
        this.finish(state, null, side);
        const below = new Uint8Array(4 * width * height);
        gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, below);
        target.free();
        texture.free();
        const rows = new Uint8Array(below.length);
        for (let y = 0; y < height; y++) rows.set(below.subarray(4 * width * y, 4 * width * (y + 1)), 4 * width * (height - 1 - y));
        return rows;
    }
}
