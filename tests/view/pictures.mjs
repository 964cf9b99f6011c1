// Reading of PNG and of the EXR files that Lobelia writes, and the difference of pictures.

import { deflateSync, inflateSync } from "node:zlib";

/** An 8-bit PNG without interlacing, as RGBA. */
export function readPng(bytes) {
    const [width, height] = [bytes.readUInt32BE(16), bytes.readUInt32BE(20)];
    const channels = { 2: 3, 6: 4 }[bytes[25]];
    if (bytes[24] !== 8 || !channels) throw new Error("expected an 8-bit RGB or RGBA PNG");
    const parts = [];
    for (let at = 8; at < bytes.length;) {
        const size = bytes.readUInt32BE(at);
        if (bytes.toString("latin1", at + 4, at + 8) === "IDAT") parts.push(bytes.subarray(at + 8, at + 8 + size));
        at += size + 12;
    }
    const raw = inflateSync(Buffer.concat(parts));
    const stride = width * channels;
    const rows = Buffer.alloc(stride * height);
    for (let y = 0; y < height; y++) {
        const filter = raw[y * (stride + 1)];
        for (let i = 0; i < stride; i++) {
            const left = i >= channels ? rows[y * stride + i - channels] : 0;
            const up = y > 0 ? rows[(y - 1) * stride + i] : 0;
            const corner = i >= channels && y > 0 ? rows[(y - 1) * stride + i - channels] : 0;
            const guess = [0, left, up, (left + up) >> 1, paeth(left, up, corner)][filter];
            rows[y * stride + i] = raw[y * (stride + 1) + 1 + i] + guess;
        }
    }
    const rgba = new Uint8Array(4 * width * height).fill(255);
    for (let i = 0; i < width * height; i++) for (let c = 0; c < channels; c++) rgba[4 * i + c] = rows[channels * i + c];
    return { width, height, rgba };
}

function paeth(a, b, c) {
    const [pa, pb, pc] = [a, b, c].map((x) => Math.abs(a + b - c - x));
    return pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
}

function half(bits) {
    const [sign, exponent, fraction] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
    if (exponent === 0) return sign * fraction * 2 ** -24;
    return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

/** Channels of a scan-line EXR with ZIP compression, by name. */
export function readExr(bytes) {
    let at = 8;
    const word = () => {
        const end = bytes.indexOf(0, at);
        const text = bytes.toString("latin1", at, end);
        at = end + 1;
        return text;
    };
    let channels = [];
    let box = null;
    for (let name = word(); name !== ""; name = word()) {
        const type = word();
        const end = at + 4 + bytes.readUInt32LE(at);
        at += 4;
        if (type === "chlist") while (bytes[at] !== 0) {
            const channel = { name: word(), kind: bytes.readUInt32LE(at) };
            channels.push(channel);
            at += 16;
        }
        if (name === "dataWindow") box = [0, 4, 8, 12].map((o) => bytes.readInt32LE(at + o));
        at = end;
    }
    const [width, height] = [box[2] - box[0] + 1, box[3] - box[1] + 1];
    const planes = Object.fromEntries(channels.map(({ name }) => [name, new Float32Array(width * height)]));
    at += 8 * Math.ceil(height / 16);
    while (at < bytes.length) {
        const [first, size] = [bytes.readInt32LE(at) - box[1], bytes.readUInt32LE(at + 4)];
        const rows = Math.min(16, height - first);
        const line = channels.reduce((sum, { kind }) => sum + width * (kind === 1 ? 2 : 4), 0);
        const packed = bytes.subarray(at + 8, at + 8 + size);
        const data = size < rows * line ? unzipped(inflateSync(packed)) : packed;
        let from = 0;
        for (let y = first; y < first + rows; y++) for (const { name, kind } of channels) for (let x = 0; x < width; x++) {
            planes[name][y * width + x] = kind === 1 ? half(data.readUInt16LE(from)) : data.readFloatLE(from);
            from += kind === 1 ? 2 : 4;
        }
        at += 8 + size;
    }
    return { width, height, planes };
}

/** Undoes EXR's differences and its interleaving of bytes. */
function unzipped(data) {
    for (let i = 1; i < data.length; i++) data[i] = data[i - 1] + data[i] - 128;
    const out = Buffer.alloc(data.length);
    const middle = (data.length + 1) >> 1;
    for (let i = 0; i < data.length; i++) out[i] = data[i % 2 === 0 ? i >> 1 : middle + (i >> 1)];
    return out;
}

const srgb = (x) => {
    const c = Math.min(Math.max(x, 0), 1);
    return Math.round(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055));
};

/** A layer of an EXR as an 8-bit picture with straight alpha; radiance is weighted by coverage, albedo is not. */
export function layerPicture({ width, height, planes }, layer) {
    const names = ["R", "G", "B"].map((c) => `${layer}.${c}`);
    const rgba = new Uint8Array(4 * width * height);
    for (let i = 0; i < width * height; i++) {
        const alpha = planes.A[i];
        const weight = layer === "albedo" ? 1 : alpha;
        names.forEach((name, c) => (rgba[4 * i + c] = alpha > 1e-4 ? srgb(planes[name][i] / weight) : 0));
        rgba[4 * i + 3] = Math.round(255 * alpha);
    }
    return { width, height, rgba };
}

/** PSNR in dB of two RGBA pictures on white, over the pixels that either shows something in; and the largest difference. */
export function psnr(a, b) {
    const over = (p, i, c) => (p[4 * i + c] * p[4 * i + 3] + 255 * (255 - p[4 * i + 3])) / 255;
    let [sum, count, most] = [0, 0, 0];
    for (let i = 0; i < a.length / 4; i++) {
        if (a[4 * i + 3] === 0 && b[4 * i + 3] === 0) continue;
        for (let c = 0; c < 3; c++) {
            const difference = Math.abs(over(a, i, c) - over(b, i, c)) / 255;
            sum += difference ** 2;
            most = Math.max(most, difference);
        }
        count += 3;
    }
    return { psnr: sum > 0 ? -10 * Math.log10(sum / count) : Infinity, most: Math.round(255 * most) };
}

/** Bits of a 16-bit float of a value that it holds. */
function halfBits(value) {
    if (value === 0) return 0;
    const exponent = Math.floor(Math.log2(value));
    return exponent < -14 ? Math.round(value * 2 ** 24) : ((exponent + 15) << 10) + Math.round((value / 2 ** exponent - 1) * 1024);
}

/** What `unzipped` undoes. */
function interleaved(data) {
    const out = Buffer.alloc(data.length);
    const middle = (data.length + 1) >> 1;
    for (let i = 0; i < data.length; i++) out[i % 2 === 0 ? i >> 1 : middle + (i >> 1)] = data[i];
    for (let i = out.length - 1; i > 0; i--) out[i] = out[i] - out[i - 1] + 128;
    return out;
}

/** Runs of EXR: repeated bytes, and others as they are. */
function runs(data) {
    const out = [];
    for (let at = 0; at < data.length; ) {
        let length = 1;
        while (length < 127 && data[at + length] === data[at]) length++;
        if (length > 2) out.push(length - 1, data[at]);
        else out.push(256 - length, ...data.subarray(at, at + length));
        at += length;
    }
    return Buffer.from(out);
}

/** How EXR packs bytes, by the number of the compression; a block that does not get smaller stays as it is. */
const PACK = [(data) => data, (data) => runs(interleaved(data)), (data) => deflateSync(interleaved(data)), (data) => deflateSync(interleaved(data))];

/** An EXR of float channels of 32 or 16 bits: `channels` by name, each of width × height values. */
export function writeExr(width, height, channels, { compression = 0, is16 = false } = {}) {
    const names = Object.keys(channels).sort();
    const int = (...values) => Buffer.from(Int32Array.from(values).buffer);
    const float = (...values) => Buffer.from(Float32Array.from(values).buffer);
    const text = (value) => Buffer.from(`${value}\0`, "latin1");
    const entry = (name, kind, value) => Buffer.concat([text(name), text(kind), int(value.length), value]);
    const listed = names.map((name) => Buffer.concat([text(name), int(is16 ? 1 : 2, 0, 1, 1)]));
    const window = int(0, 0, width - 1, height - 1);
    const header = Buffer.concat([
        int(20000630, 2),
        entry("channels", "chlist", Buffer.concat([...listed, Buffer.from([0])])),
        entry("compression", "compression", Buffer.from([compression])),
        entry("dataWindow", "box2i", window),
        entry("displayWindow", "box2i", window),
        entry("lineOrder", "lineOrder", Buffer.from([0])),
        entry("pixelAspectRatio", "float", float(1)),
        entry("screenWindowCenter", "v2f", float(0, 0)),
        entry("screenWindowWidth", "float", float(1)),
        Buffer.from([0]),
    ]);
    const packed16 = (values) => Buffer.from(Uint16Array.from(values, halfBits).buffer);
    const line = (values) => (is16 ? packed16(values) : float(...values));
    const row = (y) => Buffer.concat(names.map((name) => line(channels[name].slice(y * width, (y + 1) * width))));
    const deep = compression === 3 ? 16 : 1;
    const blocks = Array.from({ length: Math.ceil(height / deep) }, (_, i) => {
        const data = Buffer.concat(Array.from({ length: Math.min(deep, height - i * deep) }, (_, k) => row(i * deep + k)));
        const packed = PACK[compression]?.(data) ?? data;
        const kept = packed.length < data.length ? packed : data;
        return Buffer.concat([int(i * deep, kept.length), kept]);
    });
    let start = header.length + 8 * blocks.length;
    const offsets = blocks.map((bytes) => BigInt((start += bytes.length) - bytes.length));
    return Buffer.concat([header, Buffer.from(BigInt64Array.from(offsets).buffer), ...blocks]);
}
