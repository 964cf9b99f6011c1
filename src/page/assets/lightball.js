// The light as a ball in a corner of the picture: the radiance that comes from each direction, painted where the ball faces it, and a
// dot for each lobe. It turns with the light and with the camera.

import { sphereIntegral, turnedLobes, worldFromLight } from "lobelia/light";
import { clamp, dot, product, rotation } from "lobelia/linear";

/** Size of the table of a light's radiance, by height and azimuth. */
const [WIDTH, HEIGHT] = [192, 96];
/** Radii of dots in pixels of the page: of the least and of the greatest share of the light. */
const [SMALL, LARGE] = [1.5, 5];
/** Of more lobes than this the dots are smaller. */
const MANY = 40;

const shown = (linear) => {
    const c = clamp(linear, 0, 1);
    return 255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
};

/** Radiance of lobes in all directions of their frame. */
function radianceTable(lobes) {
    const table = new Float32Array(3 * WIDTH * HEIGHT);
    for (let row = 0; row < HEIGHT; row++) {
        const polar = (Math.PI * (row + 0.5)) / HEIGHT;
        for (let column = 0; column < WIDTH; column++) {
            const azimuth = (2 * Math.PI * column) / WIDTH;
            const way = [Math.sin(polar) * Math.cos(azimuth), Math.cos(polar), Math.sin(polar) * Math.sin(azimuth)];
            for (const { axis, sharpness, amplitude } of lobes) {
                const weight = Math.exp(sharpness * (dot(axis, way) - 1));
                if (weight > 1e-6) for (let c = 0; c < 3; c++) table[3 * (row * WIDTH + column) + c] += amplitude[c] * weight;
            }
        }
    }
    return table;
}

/** Radiance between rows and columns of a table. */
function lookedUp(table, row, column) {
    const [low, left] = [Math.floor(row), Math.floor(column)];
    const [down, right] = [row - low, column - left];
    const sum = [0, 0, 0];
    for (const [dy, dx] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
        const from = 3 * (clamp(low + dy, 0, HEIGHT - 1) * WIDTH + ((left + dx + WIDTH) % WIDTH));
        const weight = (dy ? down : 1 - down) * (dx ? right : 1 - right);
        for (let c = 0; c < 3; c++) sum[c] += weight * table[from + c];
    }
    return sum;
}

export class LightBall {
    constructor(canvas) {
        Object.assign(this, { canvas, context: canvas.getContext("2d"), tables: new Map(), drawn: "" });
    }

    /** The table of a light, made once. */
    table(light) {
        if (!this.tables.has(light)) this.tables.set(light, radianceTable(light.lobes));
        return this.tables.get(light);
    }

    /** Draws a light as it stands for a camera. */
    draw(light, { up, turn, exposure, axes }) {
        const side = Math.round(this.canvas.clientWidth * Math.min(window.devicePixelRatio, 2));
        const wanted = JSON.stringify([up, turn, exposure, axes, side]);
        if ((light === this.light && wanted === this.drawn) || side === 0) return;
        Object.assign(this, { light, drawn: wanted });
        if (this.canvas.width !== side) Object.assign(this.canvas, { width: side, height: side });
        this.context.putImageData(this.painted(light, { up, turn, exposure, axes }, side), 0, 0);
        this.mark(turnedLobes(light, up, turn, axes), axes, side);
    }

    /** The ball with its radiance. */
    painted(light, { up, turn, exposure, axes }, side) {
        const picture = new ImageData(side, side);
        const table = this.table(light);
        const world = product(rotation(up, (turn * Math.PI) / 180), worldFromLight(light.frame, axes));
        // Rows of the rotation from the camera's axes into the light's frame.
        const rows = [0, 1, 2].map((k) => axes.map((axis) => dot(axis, world[k])));
        const factor = 2 ** exposure;
        const radius = side / 2 - 1;
        for (let y = 0; y < side; y++) for (let x = 0; x < side; x++) {
            const at = [(x + 0.5 - side / 2) / radius, (y + 0.5 - side / 2) / radius];
            const away = Math.hypot(...at);
            const alpha = clamp((1 - away) * radius + 0.5, 0, 1);
            if (alpha === 0) continue;
            const way = [...at, -Math.sqrt(Math.max(1 - away * away, 0))];
            const [lx, ly, lz] = rows.map((row) => dot(row, way));
            const light = lookedUp(table, (Math.acos(clamp(ly, -1, 1)) / Math.PI) * HEIGHT - 0.5, (Math.atan2(lz, lx) / (2 * Math.PI)) * WIDTH);
            for (let c = 0; c < 3; c++) picture.data[4 * (y * side + x) + c] = shown(light[c] * factor);
            picture.data[4 * (y * side + x) + 3] = 255 * alpha;
        }
        return picture;
    }

    /** A dot for each lobe, the more light the larger; those behind the ball are rings. */
    mark(lobes, axes, side) {
        const { context } = this;
        const light = lobes.map(({ sharpness, amplitude }) => Math.max(...amplitude) * sphereIntegral(sharpness));
        const most = Math.max(...light, 1e-30);
        const unit = (side / this.canvas.clientWidth) * (lobes.length > MANY ? 0.6 : 1);
        const order = lobes.map((_, i) => i).sort((a, b) => light[b] - light[a]);
        for (const i of order) {
            const [x, y, z] = axes.map((axis) => dot(axis, lobes[i].axis));
            const brightest = Math.max(...lobes[i].amplitude, 1e-30);
            const color = `rgb(${lobes[i].amplitude.map((value) => Math.round(shown(value / brightest))).join(" ")})`;
            context.globalAlpha = z < 0 ? 1 : 0.3;
            context.beginPath();
            const radius = unit * (SMALL + (LARGE - SMALL) * Math.sqrt(light[i] / most));
            context.arc(side / 2 + x * (side / 2 - 1) * 0.97, side / 2 + y * (side / 2 - 1) * 0.97, radius, 0, 2 * Math.PI);
            Object.assign(context, { fillStyle: color, strokeStyle: "rgb(20 22 30)", lineWidth: unit });
            if (z < 0) context.fill();
            context.stroke();
        }
        context.globalAlpha = 1;
    }
}
