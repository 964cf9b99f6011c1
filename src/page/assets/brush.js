// Places that are made by hand: a click makes a ball, and the brush paints a line.

import { say } from "lobelia/controls";
import { MOST_POINTS, UNCHANGED, thinned } from "lobelia/regions";
import { length, sub } from "lobelia/linear";

/** Ways to make a place; radius in radii of the object, and what the page says first. */
const WAYS = {
    click: { radius: 0.3, said: "Click on the object, or press Enter for the middle of the picture." },
    brush: { radius: 0.12, said: "Paint on the object; a drag that begins beside it turns the view." },
};
/** Part of the radius over which the edits of a new place set in. */
const SOFT = 0.3;
/** Parts of the radius: how far apart points are looked for, and how far the line may be from those that are left out. */
const APART = 0.25;
const LEFT_OUT = 0.06;
/** Most pixels between two looks at the surface. */
const STEP = 8;
/** What the page says of a stroke that ends by itself. */
const FULL = "The stroke is as long as it can be.";

/** What the page says when a place is to be made; nothing where none is. */
export const saidFirst = (placing) => WAYS[placing]?.said ?? "";

/** A place that is being made: it is shown from its first point on, and noted as one step when it ends. */
export class Stroke {
    constructor(page) {
        const { regions, region, placing } = page.settings;
        const { radius } = page.scene;
        // So few digits that a scene file has the very same points.
        this.grid = 10 ** (Math.floor(Math.log10(radius)) - 3);
        Object.assign(this, { page, regions, region, found: [], at: null, full: false });
        this.made = { ...UNCHANGED, points: [], radius: WAYS[placing].radius * radius, soft: SOFT };
    }

    /** Goes on to a point of the canvas. Returns whether there are points by now. */
    to(x, y) {
        const [fromX, fromY] = this.at ?? [x, y];
        const steps = Math.max(Math.ceil(Math.hypot(x - fromX, y - fromY) / STEP), 1);
        for (let i = 1; i <= steps; i++) this.look(fromX + ((x - fromX) * i) / steps, fromY + ((y - fromY) * i) / steps);
        this.at = [x, y];
        return this.found.length > 0;
    }

    /** Takes the surface under a point of the canvas, if it is far enough from the last. */
    look(x, y) {
        if (this.full) return;
        const place = this.page.pick(x, y)?.map((v) => Number((Math.round(v / this.grid) * this.grid).toPrecision(7)));
        if (!place) return;
        const { radius } = this.made;
        const last = this.found.at(-1);
        if (last && length(sub(place, last)) <= APART * radius) return;
        const points = thinned([...this.found, place], LEFT_OUT * radius);
        this.full = points.length > MOST_POINTS;
        if (this.full) return say(FULL);
        this.found.push(place);
        this.made = { ...this.made, points };
        this.page.show({ regions: [...this.regions, this.made], region: this.regions.length });
    }

    /** Keeps the place. */
    end() {
        const number = this.regions.length + 1;
        this.page.note({ regions: this.regions }, { placing: "" });
        return `Place ${number}: the sliders of the material change it alone.${this.full ? ` ${FULL}` : ""}`;
    }

    /** Takes the place back. */
    drop() {
        this.page.show({ regions: this.regions, region: this.region });
    }
}
