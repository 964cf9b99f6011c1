// How large a moving picture becomes on machines of several kinds, whose frames take as long as is said here.

import { Pace } from "../../src/page/assets/pace.js";

/** Frames of a machine over some seconds: its display's interval, and what a frame takes besides its pixels and, at full size, for them. */
function moved({ interval = 0, fixed = 1, pixels, seconds = 60 }) {
    const pace = new Pace();
    const frames = [];
    let [time, drawn] = [0, pace.scale];
    while (time < 1000 * seconds) {
        const cost = fixed + pixels * drawn * drawn;
        const elapsed = interval > 0 ? Math.max(Math.ceil(cost / interval - 1e-3), 1) * interval : cost;
        // What is shown is a frame behind.
        drawn = pace.scale;
        pace.moved(elapsed);
        frames.push({ elapsed, scale: pace.scale });
        time += elapsed;
    }
    return { scale: pace.scale, frames, late: frames.filter((frame) => frame.elapsed > 19).length };
}

export function paced(fail) {
    const expect = (name, holds) => holds || fail(`moving pictures: ${name}`);
    const sixty = 1000 / 60;
    const quick = moved({ interval: sixty, pixels: 6 });
    expect("a quick machine draws all pixels within 5 s", quick.frames.findIndex(({ scale }) => scale === 1) < 300 && quick.late === 0);
    for (const interval of [sixty, 1000 / 144, 1000 / 75]) {
        const { scale, late } = moved({ interval, pixels: 40 });
        expect(`40 ms become 60 frames a second at ${interval.toFixed(1)} ms`, scale > 0.5 && scale < 0.65 && late < 30);
    }
    for (const interval of [20, 1000 / 30]) {
        expect(`a display of ${interval.toFixed(1)} ms has all pixels`, moved({ interval, pixels: 6 }).scale === 1);
    }
    const software = moved({ fixed: 30, pixels: 1000 });
    expect("software is at its lowest after 5 frames", software.frames.slice(5).every(({ scale }) => scale === 0.2));
    const still = new Pace();
    for (let i = 0; i < 14; i++) still.rested(sixty);
    expect("what stands still at full speed moves at full size", still.scale === 1);
}
