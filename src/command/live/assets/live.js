// The run while it works: its state every second, the object and its worst views when they are renewed.
(() => {
    const by = (id) => document.getElementById(id);
    const token = document.body.dataset.token;
    const EVERY = 1000;
    const OFTEN = 60000;
    const SELDOM = 5000;
    const LOST = 4;
    /** Where this page saw a pass first: the steps before, of a run that was resumed, took no time of this one. */
    let first = {};
    let [points, missed, number, renewing, renewed, over] = [0, 0, 0, false, 0, false];

    const minutes = (secs) => (secs < 100 ? `${secs.toFixed(0)} s` : `${Math.floor(secs / 60)} min ${String(Math.floor(secs % 60)).padStart(2, "0")} s`);

    async function ask(path, method = "GET") {
        const headers = method === "POST" ? { "X-Lobelia-Token": token } : {};
        const answer = await fetch(path, { method, headers, cache: "no-store" });
        if (!answer.ok) throw new Error((await answer.text()).trim());
        return answer;
    }

    function tile(name, value) {
        const box = document.createElement("div");
        const [dt, dd] = ["dt", "dd"].map((kind) => box.appendChild(document.createElement(kind)));
        [dt.textContent, dd.textContent] = [name, value];
        return box;
    }

    /** A task and how far it is; of one whose length is not known, what it is at. */
    function told({ title, position, length, message }) {
        return length > 0 ? `${title}: ${position} of ${length} ${message}` : `${title}: ${message}`;
    }

    /** What is being done, in words. */
    function doing({ pass, step, bar }) {
        if (!pass) return bar ? `before the first pass: ${told(bar)}` : "before the first pass";
        const words = [`pass ${pass.name}, ${pass.number} of ${pass.count}, for ${minutes(pass.secs)}`];
        if (step && step.levels > 1) words.push(`level ${step.level} of ${step.levels}`);
        if (step) words.push(`step ${step.step} of ${step.steps}`);
        if (step && first.pass !== pass.number) first = { pass: pass.number, level: step.level, step: step.step, secs: pass.secs };
        if (step && first.level !== step.level) first = { ...first, level: step.level, step: step.step, secs: pass.secs };
        const moved = step ? step.step - first.step : 0;
        const left = moved > 0 ? ((pass.secs - first.secs) * (step.steps - step.step)) / moved : 0;
        if (left > 1 && left < 1e6) words.push(`about ${minutes(left)} left`);
        if (bar && !(step && bar.title === pass.name)) words.push(told(bar));
        return words.join(" · ");
    }

    function show(run) {
        const state = by("state");
        if (state.textContent !== run.state) {
            state.textContent = run.state;
            state.className = `s-${run.state}`;
        }
        by("doing").textContent = doing(run);
        const [done, all] = run.step ? [run.step.step, run.step.steps] : [run.bar?.position ?? 0, run.bar?.length ?? 1];
        by("progress").value = all > 0 ? done / all : 0;
        const tiles = [tile("time", minutes(run.secs))];
        if (run.step) {
            tiles.push(tile("PSNR", `${run.step.psnr?.toFixed(1) ?? "–"} dB`), tile("loss", run.step.loss?.toPrecision(3) ?? "–"));
            tiles.push(tile("roughness", run.step.roughness?.toFixed(3) ?? "–"));
        }
        by("tiles").replaceChildren(...tiles);
        const lines = by("lines");
        const text = run.lines.join("\n");
        if (lines.textContent !== text) {
            const atEnd = lines.scrollTop + lines.clientHeight >= lines.scrollHeight - 4;
            lines.textContent = text;
            if (atEnd) lines.scrollTop = lines.scrollHeight;
        }
        over = run.state !== "running" && run.state !== "stopping";
        by("stop").disabled = run.state !== "running";
    }

    async function curves(run) {
        if (run.points === points) return;
        const axis = document.querySelector("#curves input:checked")?.id;
        by("curves").innerHTML = await (await ask("/curves.html")).text();
        if (axis) by(axis).checked = true;
        points = run.points;
    }

    /** The object and its worst views, at the next step. */
    async function renew() {
        if (renewing) return;
        renewing = true;
        by("renew").disabled = true;
        by("at").textContent = "Waiting for the next step …";
        try {
            const { copy, problem } = await (await ask("/renew", "POST")).json();
            if (copy) await draw(copy);
            const where = copy ? `As it was at ${copy.at}.` : "There is no object yet.";
            by("at").textContent = problem ? `${where} ${problem}` : where;
        } catch (error) {
            by("at").textContent = `It cannot be shown: ${error.message}`;
        }
        renewed = performance.now();
        renewing = false;
        by("renew").disabled = over;
    }

    /** Shows a copy that the server has. */
    async function draw(copy) {
        if (copy.number === number) return;
        number = copy.number;
        by("at").textContent = `Drawing the object as it was at ${copy.at} …`;
        by("object").src = `/object.html?${copy.number}`;
        by("object").hidden = false;
        by("views").innerHTML = (await (await ask("/views.html")).text()) || "<p class=\"note\">No photograph shows the object.</p>";
        by("at").textContent = `As it was at ${copy.at}.`;
    }

    async function look() {
        try {
            const run = await (await ask("/state.json")).json();
            missed = 0;
            show(run);
            await curves(run);
            // A copy that came late, or that another page asked for.
            if (run.copy && !renewing) draw(run.copy).catch(() => {});
            const isTime = by("often").checked && performance.now() - renewed > OFTEN;
            if (run.step && run.state === "running" && ((number === 0 && renewed === 0) || isTime)) renew();
        } catch {
            missed += 1;
        }
        const isLost = !over && missed >= LOST;
        if (isLost) {
            by("state").textContent = "no answer; the run may have ended";
            by("state").className = "s-gone";
        }
        if (over) {
            by("doing").textContent += " · the run has ended; this page stays as it was";
            by("doing").classList.add("gone");
            for (const id of ["stop", "renew", "often"]) by(id).disabled = true;
            return;
        }
        setTimeout(look, isLost ? SELDOM : EVERY);
    }

    by("renew").addEventListener("click", renew);
    by("stop").addEventListener("click", async () => {
        if (!confirm("Stop the run? What was found is scored and saved; the same command with --resume goes on.")) return;
        by("stop").disabled = true;
        try {
            await ask("/stop", "POST");
        } catch (error) {
            by("stop").disabled = false;
            by("doing").textContent = `The run was not stopped: ${error.message}`;
        }
    });
    globalThis.lobelia = { ready: look(), renew };
})();
