// What was done, to be undone and done again: earlier and later settings, without those that only say how one looks.

/** Settings that are no changes of the object, of its light or of the picture. */
const PASSING = ["view", "compare", "left", "right", "wipe", "ball", "placing", "region"];
/** Changes of the same settings within this time, in milliseconds, are one: a slider is dragged. */
const TOGETHER = 700;
const MOST = 100;

/** The settings that are kept, as text. */
function kept(settings) {
    return JSON.stringify(Object.fromEntries(Object.entries(settings).filter(([name]) => !PASSING.includes(name))));
}

/** The settings that differ, and of places the values that do. */
function differing(before, after) {
    const names = (a, b) => Object.keys(b).filter((name) => JSON.stringify(a?.[name]) !== JSON.stringify(b[name]));
    const ofPlaces = after.regions?.map((place, i) => names(before.regions?.[i], place).join("+"));
    return [...names(before, after), ...(ofPlaces ?? []), after.regions?.length].join();
}

export class History {
    constructor() {
        Object.assign(this, { past: [], future: [], last: "", time: 0 });
    }

    /** Notes a change from some settings to others; `time` in milliseconds. */
    note(before, after, time) {
        const [old, now] = [kept(before), kept(after)];
        if (old === now) return;
        const changed = differing(before, after);
        const goesOn = changed === this.last && time - this.time < TOGETHER && this.past.length > 0;
        if (!goesOn) this.past.push(old);
        // A change and its reverse are none.
        else if (this.past.at(-1) === now) return Object.assign(this, { past: this.past.slice(0, -1), last: "" });
        if (this.past.length > MOST) this.past.shift();
        Object.assign(this, { future: [], last: changed, time });
    }

    /** The settings to go back to (`past`) or on to (`future`), given those of now; null if there are none. */
    step(settings, from, to) {
        const found = this[from].pop();
        if (found === undefined) return null;
        this[to].push(kept(settings));
        this.last = "";
        return JSON.parse(found);
    }

    undo(settings) {
        return this.step(settings, "past", "future");
    }

    redo(settings) {
        return this.step(settings, "future", "past");
    }
}
