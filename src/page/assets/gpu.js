// WebGL2: programs, textures and targets.

const HEAD = "#version 300 es\nprecision highp float;\nprecision highp int;\nprecision highp sampler2D;\n";

function compile(gl, kind, text) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, HEAD + text);
    gl.compileShader(shader);
    return shader;
}

/** A program, and its uniforms by name. */
export class Program {
    constructor(gl, vertex, fragment) {
        this.gl = gl;
        this.program = gl.createProgram();
        const shaders = [compile(gl, gl.VERTEX_SHADER, vertex), compile(gl, gl.FRAGMENT_SHADER, fragment)];
        for (const shader of shaders) gl.attachShader(this.program, shader);
        gl.linkProgram(this.program);
        if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) {
            const logs = shaders.map((shader) => gl.getShaderInfoLog(shader)).concat(gl.getProgramInfoLog(this.program));
            throw new Error(`a shader does not compile: ${logs.join(" ")}`);
        }
        this.places = new Map();
        const count = gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS);
        for (let i = 0; i < count; i++) {
            const { name, type } = gl.getActiveUniform(this.program, i);
            this.places.set(name.replace("[0]", ""), { type, place: gl.getUniformLocation(this.program, name) });
        }
    }

    /** Makes the program current and sets uniforms: numbers, arrays, or textures. Names that the program lacks are passed over. */
    use(values) {
        const gl = this.gl;
        gl.useProgram(this.program);
        let unit = 0;
        for (const [name, value] of Object.entries(values)) {
            const found = this.places.get(name);
            if (!found) continue;
            if (value instanceof Texture) {
                gl.activeTexture(gl.TEXTURE0 + unit);
                gl.bindTexture(value.target, value.texture);
                gl.uniform1i(found.place, unit++);
            } else {
                this.set(found, value);
            }
        }
    }

    set({ type, place }, value) {
        const gl = this.gl;
        const many = typeof value === "object" ? value : [Number(value)];
        switch (type) {
            case gl.INT: case gl.BOOL: return gl.uniform1iv(place, many);
            case gl.INT_VEC2: return gl.uniform2iv(place, many);
            case gl.FLOAT: return gl.uniform1fv(place, many);
            case gl.FLOAT_VEC2: return gl.uniform2fv(place, many);
            case gl.FLOAT_VEC3: return gl.uniform3fv(place, many);
            case gl.FLOAT_VEC4: return gl.uniform4fv(place, many);
            case gl.FLOAT_MAT4: return gl.uniformMatrix4fv(place, false, many);
            default: throw new Error(`a uniform of unknown type ${type}`);
        }
    }
}

/** A texture or an array of textures. Formats: see `formatOf`. */
export class Texture {
    constructor(gl, format, { width, height, layers = 0, filter = false, data = null }) {
        Object.assign(this, { gl, format, width, height, layers });
        this.target = layers > 0 ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D;
        this.texture = gl.createTexture();
        gl.bindTexture(this.target, this.texture);
        const kind = filter ? gl.LINEAR : gl.NEAREST;
        for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(this.target, name, kind);
        for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(this.target, name, gl.CLAMP_TO_EDGE);
        const { internal } = this.words();
        if (layers > 0) gl.texStorage3D(this.target, 1, internal, width, height, layers);
        else gl.texStorage2D(this.target, 1, internal, width, height);
        if (data) this.fill(data);
    }

    words() {
        const gl = this.gl;
        const [internal, format, type] = {
            rgba8: [gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE],
            srgb8: [gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE],
            rgba16f: [gl.RGBA16F, gl.RGBA, gl.HALF_FLOAT],
            rgba32f: [gl.RGBA32F, gl.RGBA, gl.FLOAT],
            r16ui: [gl.R16UI, gl.RED_INTEGER, gl.UNSIGNED_SHORT],
            rgba32ui: [gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT],
        }[this.format];
        return { internal, format, type };
    }

    fill(data) {
        const gl = this.gl;
        const { format, type } = this.words();
        gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
        gl.bindTexture(this.target, this.texture);
        if (this.layers > 0) {
            gl.texSubImage3D(this.target, 0, 0, 0, 0, this.width, this.height, this.layers, format, type, data);
        } else {
            gl.texSubImage2D(this.target, 0, 0, 0, this.width, this.height, format, type, data);
        }
    }

    free() {
        this.gl.deleteTexture(this.texture);
    }
}

/** A frame buffer over textures: `[texture, layer]` each, and depth if asked for, of its own or that of another target. */
export class Target {
    constructor(gl, attachments, depth = false) {
        this.gl = gl;
        this.buffer = gl.createFramebuffer();
        const [{ width, height }] = attachments[0];
        Object.assign(this, { width, height });
        gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
        attachments.forEach(([texture, layer], i) => {
            const point = gl.COLOR_ATTACHMENT0 + i;
            if (texture.layers > 0) gl.framebufferTextureLayer(gl.FRAMEBUFFER, point, texture.texture, 0, layer);
            else gl.framebufferTexture2D(gl.FRAMEBUFFER, point, gl.TEXTURE_2D, texture.texture, 0);
        });
        gl.drawBuffers(attachments.map((_, i) => gl.COLOR_ATTACHMENT0 + i));
        if (depth) {
            this.depth = depth.depth ?? gl.createRenderbuffer();
            gl.bindRenderbuffer(gl.RENDERBUFFER, this.depth);
            if (!depth.depth) gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
            gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, this.depth);
        }
        if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) {
            throw new Error("this browser cannot draw into textures of this kind");
        }
        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    }

    bind() {
        this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, this.buffer);
        this.gl.viewport(0, 0, this.width, this.height);
    }

    free() {
        this.gl.deleteFramebuffer(this.buffer);
        if (this.depth) this.gl.deleteRenderbuffer(this.depth);
    }
}

/** Draws a triangle over the whole of the current target. */
export function cover(gl) {
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    fill(gl);
}

/** Adds a triangle over all of the current target that something is in front of. */
export function coverAdding(gl) {
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.GREATER);
    gl.depthMask(false);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    fill(gl);
}

function fill(gl) {
    gl.bindVertexArray(null);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
}
