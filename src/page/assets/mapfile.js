// Maps of a light in files: OpenEXR and Radiance HDR, averaged to few cells while they are read.

/** Cells of a map that lobes are fitted to, and most texels of a file. Fewer cells than these leave the peaks of lobes free. */
const CELLS = [64, 32];
const MOST_TEXELS = 1 << 25;
/** Most bytes of a file. */
export const MOST_MAP_BYTES = 1 << 28;
/** Radiance beyond which a texel is left out, as for a light of a scene file. */
const MOST_TEXEL = 1e10;
const ELSEWHERE = "`lobelia env fit` may read it";

/** Means of radiance over the cells of a latitude-longitude map, by solid angle. */
export class Cells {
    constructor(width, height) {
        if (!(width > 0 && height > 0 && width * height <= MOST_TEXELS)) throw new Error(`a map of ${width} × ${height} texels is not opened here; ${ELSEWHERE}`);
        if (width !== 2 * height) throw new Error(`it is ${width} × ${height}, but a latitude-longitude map is twice as wide as high`);
        if (width < CELLS[0]) throw new Error(`a map of ${width} × ${height} texels is too small for lobes to be fitted here; ${ELSEWHERE}`);
        this.texels = [width, height];
        [this.width, this.height] = CELLS;
        this.radiance = new Float64Array(3 * this.width * this.height);
        this.solidAngle = new Float64Array(this.width * this.height);
    }

    /** Adds a texel; negative values are none, and one that is not finite, or beyond all lights, is left out. */
    add(x, y, r, g, b) {
        const [width, height] = this.texels;
        if (!Number.isFinite(r + g + b) || Math.max(r, g, b) > MOST_TEXEL) return;
        const cell = Math.floor((y * this.height) / height) * this.width + Math.floor((x * this.width) / width);
        const weight = Math.sin((Math.PI * (y + 0.5)) / height);
        this.radiance[3 * cell] += weight * Math.max(r, 0);
        this.radiance[3 * cell + 1] += weight * Math.max(g, 0);
        this.radiance[3 * cell + 2] += weight * Math.max(b, 0);
        this.solidAngle[cell] += weight;
    }

    /** The map once all texels are in it. */
    done() {
        const [width, height] = this.texels;
        const texel = ((2 * Math.PI) / width) * (Math.PI / height);
        let any = false;
        for (let cell = 0; cell < this.solidAngle.length; cell++) {
            for (let c = 3 * cell; c < 3 * cell + 3; c++) {
                this.radiance[c] /= this.solidAngle[cell] || 1;
                any ||= this.radiance[c] > 0;
            }
            this.solidAngle[cell] *= texel;
        }
        if (!any) throw new Error("it gives no light");
        return this;
    }
}

const HALF = new Float64Array(1 << 16);

/** The values of 16-bit floats. */
function halves() {
    if (HALF[1] > 0) return HALF;
    for (let bits = 0; bits < HALF.length; bits++) {
        const [sign, exponent, fraction] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
        const normal = exponent === 31 ? (fraction ? NaN : Infinity) : (1 + fraction / 1024) * 2 ** (exponent - 15);
        HALF[bits] = sign * (exponent === 0 ? fraction * 2 ** -24 : normal);
    }
    return HALF;
}

/** Numbers and words from the start of a file on. */
class Reader {
    constructor(buffer) {
        Object.assign(this, { view: new DataView(buffer), bytes: new Uint8Array(buffer), at: 0 });
    }

    skip(count) {
        if (!(count >= 0 && this.at + count <= this.bytes.length)) throw new Error("the file is truncated");
        this.at += count;
        return this.at - count;
    }

    int() {
        return this.view.getInt32(this.skip(4), true);
    }

    byte() {
        return this.bytes[this.skip(1)];
    }

    /** Text up to a byte of this value. */
    text(end) {
        const stop = this.bytes.indexOf(end, this.at);
        if (stop < 0 || stop - this.at > 4096) throw new Error("the file is truncated");
        const text = String.fromCharCode(...this.bytes.subarray(this.at, stop));
        this.at = stop + 1;
        return text;
    }
}

/** What is needed of an OpenEXR header. */
function exrHeader(file) {
    if (file.int() !== 20000630) throw new Error("it does not begin as an OpenEXR file");
    const version = file.int();
    if (version & 0x1800) throw new Error(`it has deep pixels or several parts; ${ELSEWHERE}`);
    const header = { channels: [], tiles: null, compression: null, box: null };
    for (let name = file.text(0); name !== ""; name = file.text(0)) {
        file.text(0);
        const size = file.int();
        const end = file.skip(size) + size;
        file.at = end - size;
        if (name === "channels") header.channels = exrChannels(file, end);
        if (name === "compression") header.compression = file.byte();
        if (name === "dataWindow") header.box = [file.int(), file.int(), file.int(), file.int()];
        if (name === "tiles") header.tiles = { size: [file.int(), file.int()], mode: file.byte() };
        file.at = end;
    }
    if (!header.box || ![0, 1, 2, 3].includes(header.compression)) throw new Error(`its compression is not read here; ${ELSEWHERE}`);
    if (((version & 0x200) !== 0) !== (header.tiles !== null) || (header.tiles && (header.tiles.mode & 15) !== 0)) throw new Error(`it has several levels of detail; ${ELSEWHERE}`);
    return header;
}

function exrChannels(file, end) {
    const channels = [];
    while (file.at < end - 1) {
        const name = file.text(0);
        const kind = file.int();
        file.skip(4);
        if (file.int() !== 1 || file.int() !== 1) throw new Error(`a channel is smaller than the picture; ${ELSEWHERE}`);
        if (![0, 1, 2].includes(kind)) throw new Error(`its channels are not read here; ${ELSEWHERE}`);
        channels.push({ name, half: kind === 1, whole: kind === 0, bytes: kind === 1 ? 2 : 4 });
    }
    for (const name of ["R", "G", "B"]) {
        const found = channels.find((channel) => channel.name === name);
        if (!found || found.whole) throw new Error(`it has no channels R, G and B of radiance; ${ELSEWHERE}`);
    }
    return channels;
}

/** The bytes of a block in the order of its rows. */
async function unpacked(packed, size, compression) {
    if (compression === 0 || packed.length === size) {
        if (packed.length !== size) throw new Error("the file is truncated");
        return packed;
    }
    const bytes = compression === 1 ? withoutRuns(packed, size) : await inflated(packed);
    if (bytes.length !== size) throw new Error("a block of the file has not its size");
    for (let i = 1; i < size; i++) bytes[i] += bytes[i - 1] - 128;
    const rows = new Uint8Array(size);
    const middle = (size + 1) >> 1;
    for (let i = 0; i < size; i++) rows[i] = bytes[i % 2 === 0 ? i >> 1 : middle + (i >> 1)];
    return rows;
}

async function inflated(packed) {
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Bytes of runs: a count below 0 is that of bytes as they are, another is one less than that of a repeated byte. */
function withoutRuns(packed, size) {
    const bytes = new Uint8Array(size);
    let to = 0;
    for (let at = 0; at < packed.length; ) {
        const count = (packed[at++] << 24) >> 24;
        const length = count < 0 ? -count : count + 1;
        if (to + length > size || (count < 0 && at + length > packed.length)) throw new Error("a run does not fit its block");
        if (count < 0) bytes.set(packed.subarray(at, at + length), to);
        else bytes.fill(packed[at], to, to + length);
        at += count < 0 ? length : 1;
        to += length;
    }
    return bytes.subarray(0, to);
}

/** The cells of an OpenEXR map: of rows or tiles, as they are or with RLE, ZIPS or ZIP. */
export async function cellsOfExr(buffer) {
    const file = new Reader(buffer);
    const { channels, tiles, compression, box } = exrHeader(file);
    const [width, height] = [box[2] - box[0] + 1, box[3] - box[1] + 1];
    const cells = new Cells(width, height);
    const [across, down] = tiles ? tiles.size : [width, compression === 3 ? 16 : 1];
    if (!(across > 0 && down > 0)) throw new Error("its tiles have no size");
    const blocks = Math.ceil(width / across) * Math.ceil(height / down);
    file.skip(8 * blocks);
    const perTexel = channels.reduce((sum, channel) => sum + channel.bytes, 0);
    for (let i = 0; i < blocks; i++) {
        const place = tiles ? [file.int(), file.int(), file.int(), file.int()] : [0, (file.int() - box[1]) / down];
        const [x, y] = [place[0] * across, place[1] * down];
        if (!(x >= 0 && x < width && y >= 0 && y < height)) throw new Error("a block is outside the picture");
        const [columns, rows] = [Math.min(across, width - x), Math.min(down, height - y)];
        const size = file.int();
        const packed = file.bytes.subarray(file.skip(size), file.at);
        const block = await unpacked(packed, columns * rows * perTexel, compression);
        addBlock(cells, block, channels, [x, y, columns, rows]);
    }
    return cells.done();
}

/** Adds the texels of a block: row by row, and in a row channel by channel. */
function addBlock(cells, block, channels, [x, y, columns, rows]) {
    const view = new DataView(block.buffer, block.byteOffset, block.byteLength);
    const table = halves();
    const triple = { R: new Float64Array(columns), G: new Float64Array(columns), B: new Float64Array(columns) };
    let at = 0;
    for (let row = 0; row < rows; row++) {
        for (const { name, half, bytes } of channels) {
            const to = Object.hasOwn(triple, name) ? triple[name] : null;
            for (let i = 0; to && i < columns; i++) to[i] = half ? table[view.getUint16(at + 2 * i, true)] : view.getFloat32(at + 4 * i, true);
            at += bytes * columns;
        }
        for (let i = 0; i < columns; i++) cells.add(x + i, y + row, triple.R[i], triple.G[i], triple.B[i]);
    }
}

/** The cells of a Radiance HDR map: flat, with old runs or with new ones. */
export function cellsOfHdr(buffer) {
    const file = new Reader(buffer);
    let line = file.text(10);
    if (!line.startsWith("#?")) throw new Error("it does not begin as a Radiance HDR file");
    for (; line !== ""; line = file.text(10).trim()) {
        if (line.startsWith("FORMAT=") && line !== "FORMAT=32-bit_rle_rgbe") throw new Error(`its format is ${line.slice(7)}; ${ELSEWHERE}`);
    }
    const size = /^-Y (\d+) \+X (\d+)\s*$/.exec(file.text(10));
    if (!size) throw new Error(`its rows are not from the top down; ${ELSEWHERE}`);
    const [height, width] = [Number(size[1]), Number(size[2])];
    const cells = new Cells(width, height);
    const row = new Uint8Array(4 * width);
    for (let y = 0; y < height; y++) {
        const start = file.bytes.subarray(file.skip(4), file.at);
        if (start[0] === 2 && start[1] === 2 && start[2] < 128 && start[2] * 256 + start[3] === width) planes(file, row, width);
        else flat(file, row, width, start);
        for (let x = 0; x < width; x++) {
            const factor = row[4 * x + 3] === 0 ? 0 : 2 ** (row[4 * x + 3] - 136);
            cells.add(x, y, factor * row[4 * x], factor * row[4 * x + 1], factor * row[4 * x + 2]);
        }
    }
    return cells.done();
}

/** One byte of every texel after the other, with runs. */
function planes(file, row, width) {
    for (let plane = 0; plane < 4; plane++) {
        for (let x = 0; x < width; ) {
            const count = file.byte();
            const length = count > 128 ? count - 128 : count;
            if (length === 0 || x + length > width) throw new Error("a run does not fit its row");
            const repeated = count > 128 ? file.byte() : null;
            for (let i = 0; i < length; i++) row[4 * (x + i) + plane] = repeated ?? file.byte();
            x += length;
        }
    }
}

/** Texels of four bytes; 1 1 1 n repeats the one before. */
function flat(file, row, width, first) {
    let texel = first;
    for (let x = 0, shift = 0; ; texel = file.bytes.subarray(file.skip(4), file.at)) {
        if (x > 0 && texel[0] === 1 && texel[1] === 1 && texel[2] === 1) {
            const length = texel[3] * 2 ** shift;
            if (shift > 16 || x + length > width) throw new Error("a run does not fit its row");
            for (let i = 0; i < length; i++, x++) row.copyWithin(4 * x, 4 * (x - 1), 4 * x);
            shift += 8;
        } else {
            row.set(texel, 4 * x);
            [x, shift] = [x + 1, 0];
        }
        if (x === width) return;
    }
}
