// Lights in files that are dropped on the page: lobes as RON (`Lobes(…)`), an `.npy` array [M, 7], or a map.

import { length, normalize, product, rotation, times } from "lobelia/linear";
import { MOST_MAP_BYTES, cellsOfExr, cellsOfHdr } from "lobelia/mapfile";
import { lobesOfCells } from "lobelia/mapfit";

/** The limits of a light, as Lobelia has them. */
const MOST_LOBES = 2048;
const MOST_SHARPNESS = 1e12;
const MOST_RADIANCE = 1e15;
const MOST_BYTES = 1 << 20;
/** Lobes that a map is fitted with, at least and at most. */
const MAP_LOBES = [64, 128];

/** Numbers, words and marks of RON text; comments are left out. */
function tokens(text) {
    const plain = text.replace(/\/\/[^\n]*|\/\*[\s\S]*?(?:\*\/|$)/g, " ");
    return plain.match(/[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[A-Za-z_]\w*|"(?:[^"\\]|\\.)*"|[()[\]:,]/g) ?? [];
}

/** RON as values: tuples and lists are arrays; what has names is an object, whose own name is `is`. */
function parsed(list) {
    let at = 0;
    const among = (end) => {
        const items = [];
        const named = {};
        for (; list[at] !== end; ) {
            if (at >= list.length) throw new Error(`the text ends before a "${end}"`);
            if (list[at + 1] === ":") {
                const name = list[at];
                at += 2;
                named[name] = value();
            } else {
                items.push(value());
            }
            if (list[at] === ",") at += 1;
            else if (list[at] !== end) throw new Error(`"${list[at] ?? "the end"}" is not expected`);
        }
        at += 1;
        return Object.keys(named).length > 0 ? named : items;
    };
    const value = () => {
        const token = list[at++];
        if (token === "(" || token === "[") return among(token === "(" ? ")" : "]");
        if (token !== undefined && /^[-+.\d]/.test(token)) return Number(token);
        if (token === undefined || !/^[A-Za-z_]/.test(token)) throw new Error(`"${token ?? "the end"}" is not expected`);
        if (list[at] !== "(") return token;
        at += 1;
        return { is: token, ...among(")") };
    };
    return value();
}

/** Lobes of RON text, scaled and turned (about x, then y, then z) as it says. */
export function lobesOfRon(text) {
    const light = parsed(tokens(text));
    if (light?.is !== "Lobes" || !Array.isArray(light.lobes)) throw new Error("a light in RON has the form Lobes(lobes: […])");
    const angles = (light.rotation_degrees ?? [0, 0, 0]).map((degrees) => (degrees * Math.PI) / 180);
    const [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis, i) => rotation(axis, angles[i]));
    const turn = product(z, product(y, x));
    const factor = light.scale ?? 1;
    return light.lobes.map((lobe) => ({
        axis: times(turn, triple(lobe.axis, "axis")), sharpness: lobe.sharpness,
        amplitude: triple(lobe.amplitude, "amplitude").map((value) => value * factor),
    }));
}

function triple(value, name) {
    if (Array.isArray(value) && value.length === 3) return value;
    throw new Error(`a lobe has no ${name} of three numbers`);
}

/** Lobes of an `.npy` file: float32 or float64 of shape [M, 7], or [M, 5] with one gray amplitude. */
export function lobesOfNpy(buffer) {
    const view = new DataView(buffer);
    const bytes = new Uint8Array(buffer);
    const letters = (from, to) => String.fromCharCode(...bytes.subarray(from, to));
    if (letters(1, 6) !== "NUMPY") throw new Error("it does not begin as an .npy file");
    const wide = bytes[6] > 1;
    const from = wide ? 12 : 10;
    const start = from + (wide ? view.getUint32(8, true) : view.getUint16(8, true));
    const header = letters(from, start);
    const kind = /'descr':\s*'([<>=|]?)f([48])'/.exec(header);
    const shape = /'shape':\s*\((\d+),\s*([57])\)/.exec(header);
    if (!kind || !shape) throw new Error("an .npy light is an array of float32 or float64 of shape [M, 7]");
    const [rows, columns, size] = [Number(shape[1]), Number(shape[2]), Number(kind[2])];
    if (start + rows * columns * size > buffer.byteLength) throw new Error("the file is truncated");
    const fortran = /'fortran_order':\s*True/.test(header);
    const number = (row, column) => {
        const place = start + size * (fortran ? column * rows + row : row * columns + column);
        return size === 4 ? view.getFloat32(place, kind[1] !== ">") : view.getFloat64(place, kind[1] !== ">");
    };
    return Array.from({ length: rows }, (_, row) => {
        const values = Array.from({ length: columns }, (_, column) => number(row, column));
        const amplitude = columns === 7 ? values.slice(4) : [4, 4, 4].map((column) => values[column]);
        return { axis: values.slice(0, 3), sharpness: Math.abs(values[3]), amplitude: amplitude.map(Math.abs) };
    });
}

function checked(lobes) {
    if (lobes.length === 0 || lobes.length > MOST_LOBES) throw new Error(`a light has 1 to ${MOST_LOBES} lobes, not ${lobes.length}`);
    lobes.forEach(({ axis, sharpness, amplitude }, i) => {
        const within = (value, most) => typeof value === "number" && value >= 0 && value <= most;
        const fits = within(sharpness, MOST_SHARPNESS) && amplitude.every((value) => within(value, MOST_RADIANCE));
        if (!fits || !(length(axis) >= 1e-20 && length(axis) < Infinity)) throw new Error(`lobe ${i} is no light`);
    });
    return lobes.map((lobe) => ({ ...lobe, axis: normalize(lobe.axis) }));
}

/** What reads a file of this ending; `usual` is how many lobes the found light has. */
const KINDS = {
    ron: async (file) => lobesOfRon(await file.text()),
    npy: async (file) => lobesOfNpy(await file.arrayBuffer()),
    exr: async (file, usual) => lobesOfCells(await cellsOfExr(await file.arrayBuffer()), mapLobes(usual)),
    hdr: async (file, usual) => lobesOfCells(cellsOfHdr(await file.arrayBuffer()), mapLobes(usual)),
};

const mapLobes = (usual) => Math.min(Math.max(usual, MAP_LOBES[0]), MAP_LOBES[1]);

/** The light of a file, under its name; a map gets about as many lobes as are `usual`. */
export async function lightOfFile(file, usual) {
    const [, name, ending] = /^(.*?)(?:\.([^.]*))?$/.exec(file.name);
    const kind = (ending ?? "").toLowerCase();
    if (!Object.hasOwn(KINDS, kind)) {
        throw new Error("a light is a .ron file, an .npy array, or an .exr or .hdr map; `lobelia env fit` makes one of other maps");
    }
    if (file.size > (kind === "ron" || kind === "npy" ? MOST_BYTES : MOST_MAP_BYTES)) throw new Error("it is too large for a light");
    const lobes = await KINDS[kind](file, usual);
    return { name, own: false, frame: "world", lobes: checked(lobes) };
}
