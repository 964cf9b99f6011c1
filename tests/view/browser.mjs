// A headless Chromium, driven over its own pipe: no further package is needed.

import { spawn, spawnSync } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

/** The first of the usual programs that is there, or null. */
export function findChromium() {
    const names = [process.env.CHROMIUM, "chromium", "chromium-browser", "google-chrome"].filter(Boolean);
    return names.find((name) => spawnSync(name, ["--version"]).status === 0) ?? null;
}

export class Browser {
    constructor(program) {
        this.profile = mkdtempSync(join(tmpdir(), "lobelia-view-"));
        const software = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
        const quiet = ["--headless=new", "--no-sandbox", "--no-first-run", "--hide-scrollbars", `--user-data-dir=${this.profile}`];
        this.process = spawn(program, [...software, ...quiet, "--remote-debugging-pipe", "about:blank"], {
            stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"],
        });
        Object.assign(this, { next: 1, waiting: new Map(), messages: [], requests: [], rest: "" });
        this.process.stdio[4].on("data", (data) => this.receive(data));
    }

    receive(data) {
        const parts = (this.rest + data).split("\0");
        this.rest = parts.pop();
        for (const part of parts) {
            const message = JSON.parse(part);
            if (message.id) {
                const { done, failed } = this.waiting.get(message.id);
                this.waiting.delete(message.id);
                if (message.error) failed(new Error(message.error.message));
                else done(message.result);
            } else {
                this.note(message);
            }
        }
    }

    /** Console messages, exceptions and requests are kept. */
    note({ method, params }) {
        if (method === "Runtime.consoleAPICalled") this.messages.push(params.args.map((a) => a.value ?? a.description).join(" "));
        if (method === "Runtime.exceptionThrown") this.messages.push(params.exceptionDetails.exception?.description ?? params.exceptionDetails.text);
        if (method === "Log.entryAdded") this.messages.push(params.entry.text);
        if (method === "Network.requestWillBeSent") this.requests.push(params.request.url);
    }

    send(method, params = {}) {
        const id = this.next++;
        const session = this.session ? { sessionId: this.session } : {};
        this.process.stdio[3].write(`${JSON.stringify({ id, method, params, ...session })}\0`);
        return new Promise((done, failed) => this.waiting.set(id, { done, failed }));
    }

    /** Opens an address in a window of this size. */
    async open(address, width, height, mobile = false) {
        if (!this.session) {
            const { targetId } = await this.send("Target.createTarget", { url: "about:blank" });
            this.session = (await this.send("Target.attachToTarget", { targetId, flatten: true })).sessionId;
            for (const domain of ["Page", "Runtime", "Log", "Network"]) await this.send(`${domain}.enable`);
        }
        await this.resize(width, height, mobile);
        await this.send("Page.navigate", { url: address });
        await this.until("globalThis.lobelia?.ready !== undefined && document.readyState === 'complete'");
        await this.evaluate("lobelia.ready.then(() => true)");
    }

    async resize(width, height, mobile = false) {
        await this.send("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: 1, mobile });
    }

    async evaluate(expression) {
        const { result, exceptionDetails } = await this.send("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true });
        if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text);
        return result.value;
    }

    async until(expression) {
        for (let i = 0; i < 600; i++) {
            if (await this.evaluate(expression)) return;
            await new Promise((done) => setTimeout(done, 100));
        }
        throw new Error(`did not come true: ${expression}`);
    }

    async screenshot() {
        const { data } = await this.send("Page.captureScreenshot", { format: "png" });
        return Buffer.from(data, "base64");
    }

    async key(key, modifiers = 0) {
        for (const type of ["keyDown", "keyUp"]) {
            const text = key.length === 1 && type === "keyDown" ? { text: key } : {};
            await this.send("Input.dispatchKeyEvent", { type, key, modifiers, ...text });
        }
    }

    /** Drags with the left button. */
    async drag([x0, y0], [x1, y1], modifiers = 0) {
        const event = (type, x, y, buttons) =>
            this.send("Input.dispatchMouseEvent", { type, x, y, buttons, modifiers, button: "left", clickCount: 1 });
        await event("mousePressed", x0, y0, 1);
        for (let i = 1; i <= 8; i++) await event("mouseMoved", x0 + ((x1 - x0) * i) / 8, y0 + ((y1 - y0) * i) / 8, 1);
        await event("mouseReleased", x1, y1, 0);
    }

    async close() {
        const ended = new Promise((done) => this.process.once("exit", done));
        this.process.kill();
        await ended;
        rmSync(this.profile, { recursive: true, force: true });
    }
}
