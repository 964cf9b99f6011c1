// What the page holds: the scene in words, and its arrays in one compressed block.

const KINDS = { u8: Uint8Array, u16: Uint16Array, u32: Uint32Array, f32: Float32Array };

/** Text of a script element of the page. */
function textOf(id) {
    return document.getElementById(id).textContent;
}

/** The bytes of the block. */
async function inflate(base64) {
    const packed = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** One array: bytes are sorted by significance, and numbers may be differences from those `delta` places before. */
function unpack(bytes, { kind, at, count, delta }) {
    const Kind = KINDS[kind];
    const width = Kind.BYTES_PER_ELEMENT;
    const raw = new Uint8Array(count * width);
    for (let plane = 0; plane < width; plane++) {
        const from = at + plane * count;
        for (let i = 0; i < count; i++) raw[i * width + plane] = bytes[from + i];
    }
    const values = new Kind(raw.buffer);
    if (delta > 0) for (let i = delta; i < count; i++) values[i] += values[i - delta];
    return values;
}

/** The scene, with `scene.data[name]` for every array. */
export async function readScene() {
    const scene = JSON.parse(textOf("scene"));
    const bytes = await inflate(textOf("block").trim());
    scene.data = {};
    for (const [name, entry] of Object.entries(scene.arrays)) scene.data[name] = unpack(bytes, entry);
    return scene;
}

/** The shaders, by name. */
export function readShaders() {
    return JSON.parse(textOf("shaders"));
}
