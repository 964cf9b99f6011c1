// Cameras: of the views, and one that is moved around the object. Axes are right, down and forward; sizes are in pixels, or in heights
// of the picture.

import { add, clamp, cross, dot, normalize, scale, sub } from "lobelia/linear";

/** Field of view of the moved camera, degrees, of the picture's shorter side. */
const FOV = 38;
const MOST_ELEVATION = 89;

/** The camera of a view of the page. */
export function viewCamera({ eye, axes, width, height, focal, center, skew }) {
    return { eye, axes, width, height, focal, center, skew };
}

/** A camera that is moved around a point. */
export class Orbit {
    constructor({ up, center, radius }) {
        Object.assign(this, { up, home: center, radius });
        const hint = Math.abs(up[2]) < 0.9 ? [0, 0, 1] : [0, -1, 0];
        this.front = normalize(sub(hint, scale(up, dot(up, hint))));
        this.side = cross(up, this.front);
        this.reset();
    }

    reset() {
        this.target = [...this.home];
        this.azimuth = 30;
        this.elevation = 20;
        this.distance = (1.15 * this.radius) / Math.sin((FOV * Math.PI) / 360);
    }

    /** Direction from the target to the camera, and the camera's right. */
    bearings() {
        const [a, e] = [this.azimuth, this.elevation].map((degrees) => (degrees * Math.PI) / 180);
        const level = add(scale(this.front, Math.cos(a)), scale(this.side, Math.sin(a)));
        const outward = add(scale(level, Math.cos(e)), scale(this.up, Math.sin(e)));
        return [outward, sub(scale(this.side, Math.cos(a)), scale(this.front, Math.sin(a)))];
    }

    /** The camera for a picture of this aspect ratio, width over height. */
    camera(aspect) {
        const [outward, right] = this.bearings();
        const forward = scale(outward, -1);
        const focal = (0.5 * Math.min(1, aspect)) / Math.tan((FOV * Math.PI) / 360);
        return {
            eye: add(this.target, scale(outward, this.distance)), axes: [right, cross(forward, right), forward],
            width: aspect, height: 1, focal: [focal, focal], center: [aspect / 2, 0.5], skew: 0,
        };
    }

    /** Goes to where a view's camera is, looking at the point on its axis that is nearest to the object. */
    follow({ eye, axes }) {
        const along = Math.max(dot(sub(this.home, eye), axes[2]), 0.1 * this.radius);
        this.target = add(eye, scale(axes[2], along));
        this.distance = along;
        const outward = scale(axes[2], -1);
        const degrees = 180 / Math.PI;
        this.elevation = clamp(Math.asin(clamp(dot(outward, this.up), -1, 1)) * degrees, -MOST_ELEVATION, MOST_ELEVATION);
        this.azimuth = Math.atan2(dot(outward, this.side), dot(outward, this.front)) * degrees;
    }

    turn(degreesRight, degreesUp) {
        this.azimuth = (this.azimuth + degreesRight) % 360;
        this.elevation = clamp(this.elevation + degreesUp, -MOST_ELEVATION, MOST_ELEVATION);
    }

    zoom(factor) {
        this.distance = clamp(this.distance * factor, 0.2 * this.radius, 40 * this.radius);
    }

    /** Moves the target by parts of the picture's height. */
    pan(right, up) {
        const [outward, across] = this.bearings();
        const size = 2 * this.distance * Math.tan((FOV * Math.PI) / 360);
        const upward = cross(outward, across);
        const moved = add(this.target, add(scale(across, right * size), scale(upward, up * size)));
        const away = sub(moved, this.home);
        const far = Math.sqrt(dot(away, away)) / (3 * this.radius);
        this.target = far > 1 ? add(this.home, scale(away, 1 / far)) : moved;
    }
}

/** Pixels of a target a unit of the camera's picture, which is as large in it as fits. */
const fitOf = (camera, width, height) => Math.min(width / camera.width, height / camera.height);

/** Length that a pixel of a target spans at unit distance. */
export const pixelSpan = (camera, width, height) => 1 / (camera.focal[0] * fitOf(camera, width, height));

/** Columns of the matrix from the world into clip space, for a target in which the picture is as large as fits. */
export function clipFromWorld(camera, width, height, jitter, { center, radius }) {
    const fit = fitOf(camera, width, height);
    const [sx, sy] = [(fit * camera.width) / width, (fit * camera.height) / height];
    const away = dot(sub(center, camera.eye), camera.axes[2]);
    const near = Math.max(away - 1.1 * radius, 0.002 * radius);
    const far = Math.max(away + 1.1 * radius, 2 * near);
    const [fx, fy] = camera.focal;
    const [cx, cy] = camera.center;
    const [w, h] = [camera.width, camera.height];
    const rows = [
        [(2 * fx * sx) / w, (2 * camera.skew * sx) / w, ((2 * cx) / w - 1) * sx - (2 * jitter[0]) / width],
        [0, (-2 * fy * sy) / h, (1 - (2 * cy) / h) * sy + (2 * jitter[1]) / height],
        [0, 0, (far + near) / (far - near)],
        [0, 0, 1],
    ];
    const shifts = [0, 0, (-2 * far * near) / (far - near), 0];
    const matrix = new Float32Array(16);
    rows.forEach((row, r) => {
        const inWorld = [0, 1, 2].map((c) => row[0] * camera.axes[0][c] + row[1] * camera.axes[1][c] + row[2] * camera.axes[2][c]);
        inWorld.forEach((value, c) => (matrix[4 * c + r] = value));
        matrix[12 + r] = shifts[r] - dot(inWorld, camera.eye);
    });
    return matrix;
}
