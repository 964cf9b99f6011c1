// How large a moving picture is drawn: as large as can be drawn 60 times a second.

/** Milliseconds: a frame at 60 a second has 16.7, and a longer one than this is late. */
const LATE = 19;
/** Frames that are shorter leave time for more pixels: the display shows more than 60 a second. */
const EARLY = 13;
/** What a frame gets that was late. */
const AIM = 15;
/** Frames of which the mean is looked at: one long frame among so many is none too late. */
const WINDOW = 8;
/** Frames far longer than this are late without a window. */
const FAR_TOO_LATE = 60;
/** Displays show frames at least this often. */
const SLOWEST_DISPLAY = 45;
/** Time without a late frame after which more pixels are tried: when frames are early, and when they are on time. */
const SOON = 100;
const LATER = 1000;
/** How long a step that failed is not tried again: at first, and at most; each failure doubles it. */
const FIRST_WAIT = 2000;
const MOST_WAIT = 60000;
/** How long a slower display is believed in, at first; each time doubles it. */
const FIRST_BELIEF = 30000;
/** Part of the full width and height, at least. */
const LEAST = 0.2;
const STEP = 1.1;
/** Part of a scale from which on it is clear whether fewer pixels help: frames of a display last whole intervals. */
const FAR_LESS = 0.55;
/** Full pictures in a row that show that a moving picture can be as large. */
const ENOUGH = 6;

export class Pace {
    constructor() {
        // `before`: the scale from which the last step up was made, until it stands; `larger`: scale and time before the first step down;
        // `skip`: frames that may still be of the scale before.
        Object.assign(this, { scale: 0.7, frames: [], recent: [], skip: 1, limit: LATE, good: 0, wait: 0, before: null, larger: null, full: 0 });
        Object.assign(this, { belief: FIRST_BELIEF, believed: 0 });
    }

    /** Takes the time of a frame of a moving picture. */
    moved(elapsed) {
        this.frames.push(elapsed);
        if (this.frames.length > 60) this.frames.shift();
        this.full = 0;
        this.doubt(elapsed);
        if (this.skip > 0) return void (this.skip -= 1);
        this.recent.push(elapsed);
        if (this.recent.length > WINDOW) this.recent.shift();
        const mean = this.recent.reduce((sum, time) => sum + time, 0) / this.recent.length;
        if (mean > FAR_TOO_LATE) this.late(mean);
        else if (this.recent.length < WINDOW) this.good += elapsed;
        else if (mean > this.limit) this.late(mean);
        else this.onTime(elapsed, mean);
    }

    /** Takes the time of a frame at full size. */
    rested(elapsed) {
        this.full = elapsed <= LATE ? this.full + 1 : 0;
        if (this.full >= ENOUGH && this.wait === 0 && this.scale < 1) this.resize(1, this.scale);
    }

    /** Gives up the belief in a slower display after a time, to see whether fewer pixels help now. */
    doubt(elapsed) {
        if (this.limit === LATE) return;
        this.believed += elapsed;
        if (this.believed < this.belief) return;
        Object.assign(this, { limit: LATE, believed: 0, belief: 2 * this.belief });
    }

    /** Changes the scale. */
    resize(scale, before = null) {
        Object.assign(this, { scale, before, recent: [], skip: 2, good: 0 });
    }

    late(time) {
        const { larger, before, scale } = this;
        if (before !== null) {
            this.wait = Math.min(Math.max(2 * this.wait, FIRST_WAIT), MOST_WAIT);
            this.larger = null;
            this.resize(before);
        } else if (larger && scale <= Math.max(FAR_LESS * larger.scale, LEAST) && time > 0.9 * larger.time && time < SLOWEST_DISPLAY) {
            // Fewer pixels do not help: frames wait for the display, or for something else.
            Object.assign(this, { limit: 1.2 * time, larger: null });
            this.resize(larger.scale);
        } else if (scale > LEAST) {
            this.larger ??= { scale, time };
            const factor = Math.min(Math.max(Math.sqrt(AIM / time), 0.5), 0.8);
            this.resize(Math.max(scale * factor, LEAST));
        }
    }

    onTime(elapsed, mean) {
        this.larger = null;
        if (mean < 0.7 * this.limit) this.limit = LATE;
        this.good += elapsed;
        if (this.before !== null && this.good > LATER) Object.assign(this, { before: null, wait: 0 });
        const due = Math.max(mean < EARLY ? SOON : LATER, this.wait);
        if (this.good > due && this.scale < 1) this.resize(Math.min(this.scale * STEP, 1), this.scale);
    }
}
