// How large a moving picture becomes on machines of several kinds, whose frames take as long as is said here.

import { Pace } from "../../src/page/assets/pace.js";

/**
 * Frames of a machine over some seconds: its display's interval, what a frame takes besides its pixels and, at full size, for them, and how
 * many frames may be drawn ahead of the one that is shown.
 */
function moved({ interval = 0, fixed = 1, pixels, queue = 0, seconds = 60 }) {
    const pace = new Pace();
    const frames = [];
    let [ready, drawn] = [0, pace.scale];
    const shown = [0];
    while (shown.at(-1) < 1000 * seconds) {
        ready = Math.max(ready, shown.at(-1 - queue) ?? 0) + fixed + pixels * drawn * drawn;
        const last = shown.at(-1);
        shown.push(interval > 0 ? Math.max(last + interval, Math.ceil(ready / interval - 1e-3) * interval) : ready);
        // What is shown is a frame behind.
        drawn = pace.scale;
        const elapsed = shown.at(-1) - last;
        pace.moved(elapsed);
        frames.push({ elapsed, scale: pace.scale });
    }
    const end = frames.slice(-600).map(({ elapsed }) => elapsed);
    return { scale: pace.scale, frames, late: frames.filter((frame) => frame.elapsed > 19).length, rate: (1000 * end.length) / end.reduce((a, b) => a + b) };
}

export function paced(fail) {
    const expect = (name, holds) => holds || fail(`moving pictures: ${name}`);
    const sixty = 1000 / 60;
    const quick = moved({ interval: sixty, pixels: 6 });
    expect("a quick machine draws all pixels within 5 s", quick.frames.findIndex(({ scale }) => scale === 1) < 300 && quick.late === 0);
    for (const interval of [sixty, 1000 / 144, 1000 / 75]) {
        const { scale, late } = moved({ interval, pixels: 40 });
        expect(`40 ms become 60 frames a second at ${interval.toFixed(1)} ms`, scale > 0.5 && scale < 0.65 && late < 80);
    }
    for (const interval of [20, 1000 / 30]) {
        expect(`a display of ${interval.toFixed(1)} ms has all pixels`, moved({ interval, pixels: 6 }).scale === 1);
    }
    for (const [fixed, pixels] of [[5, 55], [8, 50], [10, 45], [12, 30], [1, 40]]) {
        for (const queue of [0, 1]) {
            const { rate } = moved({ interval: sixty, fixed, pixels, queue, seconds: 120 });
            expect(`${fixed} + ${pixels} ms with ${queue} frames ahead become 60 frames a second, not ${rate.toFixed(1)}`, rate > 54);
        }
    }
    const software = moved({ fixed: 30, pixels: 1000 });
    expect("software is at its lowest after 12 frames", software.frames.slice(12).every(({ scale }) => scale === 0.2));
    const still = new Pace();
    for (let i = 0; i < 14; i++) still.rested(sixty);
    expect("what stands still at full speed moves at full size", still.scale === 1);
}
