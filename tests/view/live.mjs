// The page of a run that is at work (`lobelia run --live`), as a person has it: it fills itself, and its button stops the run.

import { spawn } from "node:child_process";
import { writeFileSync } from "node:fs";
import { join } from "node:path";

/** Starts an endless fit of a scene, watches it, and stops it with the keyboard. */
export async function atWork(browser, program, scene, folder, fail) {
    const passes = "passes=[Fit(name: \"fit\", steps: 1000000)]";
    const run = spawn(program, ["run", scene, "--quiet", "--force", "--out", join(folder, "live"), "--set", passes, "--set", "light=Unknown(lobes: 16)", "--live"], { stdio: ["ignore", "ignore", "pipe"] });
    const ended = new Promise((done) => run.once("exit", done));
    try {
        const address = await new Promise((done, failed) => {
            let said = "";
            run.stderr.on("data", (data) => ((said += data), /live: (\S+)\n/.test(said) && done(/live: (\S+)/.exec(said)[1])));
            run.once("exit", () => failed(new Error(`the run ended: ${said}`)));
        });
        const before = browser.requests.length;
        await browser.open(address, 1100, 900);
        const text = (id) => browser.evaluate(`document.getElementById("${id}").textContent`);
        await browser.until("document.getElementById('at').textContent.startsWith('As it was at fit, step')");
        if (!(await text("doing")).includes("pass fit, 1 of 1")) fail(`the live page says: ${await text("doing")}`);
        if ((await browser.evaluate("document.querySelectorAll('#views .card').length")) !== 3) fail("the live page has not its three views");
        await browser.until("document.querySelectorAll('#curves svg').length > 0");
        await browser.evaluate("document.getElementById('over-seconds').click()");
        const first = await text("at");
        for (const scheme of ["light", "dark"]) {
            await browser.send("Emulation.setEmulatedMedia", { features: [{ name: "prefers-color-scheme", value: scheme }] });
            writeFileSync(join(folder, `live_${scheme}.png`), await browser.screenshot());
        }
        await browser.evaluate("document.querySelector('#views .strip').click()");
        if (!(await browser.evaluate("document.getElementById('wipe').open"))) fail("a view of the live page does not open");
        await browser.evaluate("document.getElementById('wipe').close(), lobelia.renew()");
        if ((await text("at")) === first) fail("the object is not renewed");
        if (!(await browser.evaluate("document.getElementById('over-seconds').checked"))) fail("new curves forget the axis");
        await browser.evaluate("globalThis.confirm = () => true, document.getElementById('stop').focus()");
        await browser.key(" ");
        await browser.until("document.getElementById('state').textContent === 'interrupted'");
        if ((await ended) !== 130) fail("the button of the live page does not stop the run as Ctrl-C does");
        const foreign = browser.requests.splice(before).filter((url) => !url.startsWith(address) && !url.startsWith("data:"));
        if (foreign.length > 0) fail(`the live page asked for ${foreign.join(", ")}`);
    } finally {
        run.kill();
    }
}
