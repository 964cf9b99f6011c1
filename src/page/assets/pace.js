// How large a moving picture is drawn: as large as can be drawn 60 times a second.

/** Milliseconds: a frame at 60 a second has 16.7, and a longer one than this is late. */
const LATE = 19;
/** Frames that are shorter leave time for more pixels: the display shows more than 60 a second. */
const EARLY = 13;
/** What a frame gets that was late. */
const AIM = 15;
/** Displays show frames at least this often. */
const SLOWEST_DISPLAY = 45;
/** Time without a late frame after which more pixels are tried: when frames are early, and when they are on time. */
const SOON = 100;
const LATER = 1000;
/** How long a step that failed is not tried again: at first, and at most; each failure doubles it. */
const FIRST_WAIT = 2000;
const MOST_WAIT = 60000;
/** Part of the full width and height, at least. */
const LEAST = 0.2;
const STEP = 1.1;
/** Full pictures in a row that show that a moving picture can be as large. */
const ENOUGH = 6;

export class Pace {
    constructor() {
        // `before`: the scale from which the last step up was made, until it stands; `larger`: scale and time before the last step down.
        Object.assign(this, { scale: 0.7, frames: [], last: 0, limit: LATE, good: 0, wait: 0, before: null, larger: null, full: 0 });
    }

    /** Takes the time of a frame of a moving picture. One long frame says nothing, so two in a row are looked at. */
    moved(elapsed) {
        this.frames.push(elapsed);
        if (this.frames.length > 60) this.frames.shift();
        const [shorter, longer] = [Math.min(elapsed, this.last), Math.max(elapsed, this.last)];
        this.last = elapsed;
        this.full = 0;
        if (shorter > this.limit) this.late(shorter);
        else if (shorter > 0 && longer <= this.limit) this.onTime(elapsed, longer);
    }

    /** Takes the time of a frame at full size. */
    rested(elapsed) {
        this.full = elapsed <= LATE ? this.full + 1 : 0;
        if (this.full >= ENOUGH && this.wait === 0 && this.scale < 1) this.resize(1, this.scale);
    }

    /** Changes the scale. The next frame may still be one of before. */
    resize(scale, before = null) {
        Object.assign(this, { scale, before, last: 0, good: 0 });
    }

    late(time) {
        const { larger, before } = this;
        this.larger = null;
        if (before !== null) {
            this.wait = Math.min(Math.max(2 * this.wait, FIRST_WAIT), MOST_WAIT);
            this.resize(before);
        } else if (larger && time > 0.9 * larger.time && time < SLOWEST_DISPLAY) {
            // Fewer pixels do not help: frames wait for the display, or for something else.
            this.limit = 1.2 * time;
            this.resize(larger.scale);
        } else if (this.scale > LEAST) {
            this.larger = { scale: this.scale, time };
            const factor = Math.min(Math.max(Math.sqrt(AIM / time), 0.5), 0.8);
            this.resize(Math.max(this.scale * factor, LEAST));
        }
    }

    onTime(elapsed, longer) {
        this.larger = null;
        if (longer < 0.7 * this.limit) this.limit = LATE;
        this.good += elapsed;
        if (this.before !== null && this.good > LATER) Object.assign(this, { before: null, wait: 0 });
        const due = Math.max(longer < EARLY ? SOON : LATER, this.wait);
        if (this.good > due && this.scale < 1) this.resize(Math.min(this.scale * STEP, 1), this.scale);
    }
}
