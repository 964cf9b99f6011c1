#!/usr/bin/env python3
"""Runs random scenes of valid words on tiny data: each whole, then killed again and again and resumed, then compared.

    python3 tests/soak/soak.py target/release/lobelia --minutes 60 --out soak

Scenes are photographed by the program itself, so that nothing else is needed. A failure leaves its folder in --out, with the scene.
The last line has the figures: scenes, kills, files compared, largest memory and most open files of the first and the last quarter.

With a scene file, that scene alone is run whole and then killed at so many random moments, each time resumed, and compared:

    python3 tests/soak/soak.py target/release/lobelia --scene scenes/photos.ron --kills 50 -- --data DIR --set views.downscale=4
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time

# Results that hold times, and what is compared by other means.
UNCOMPARED = {"run.json", "report.html", "contact_sheet.png"}


def scene(pick):
    """A scene of random valid words."""
    shape = pick(["Sphere(radius: 0.8, texture_size: 24)", "Box(size: (0.9, 1.1, 0.8), texture_size: 24)"])
    sheen = pick(["", "sheen: None, "])
    gloss = pick(["", "", "gloss: Texels(), "])
    visibility = pick(["None", "Traced(directions: 64)", "Traced(directions: 64, bounces: 0)"])
    steps, batch = pick([20, 60, 150]), pick([64, 256])
    loss, more = pick(["L1", "L2"]), pick(["", ", exposure: Color", ", cameras: Poses"])
    shading = pick(["Accurate", "Published"])
    passes = [f'Fit(name: "fit", steps: {steps}, batch: {batch}, loss: {loss}, shading: {shading}{more})']
    if pick([True, False]):
        passes.append(f'Fit(name: "again", steps: {steps}, batch: {batch})')
    novel = pick(["Accurate", "Published", "PathTraced(spp: 4)"])
    passes.append(f'Render(name: "novel", render: (shading: {novel}))')
    if pick([True, False]):
        passes.append('Edit(name: "edited", edits: [Roughness(action: Set(0.2))])')
    if pick([True, False]):
        passes.append('Render(name: "film", render: (views: Named([]), orbit: (frames: 3, size: 16)))')
    passes.append('Evaluate(scores: [(pass: "novel", truth: Photographs)], albedo: SelfMade)')
    passes += [word for word in ["Save()", "Export(formats: [Glb, Ply, Obj])", "View()"] if pick([True, False])]
    lines = ",\n        ".join(passes)
    return f"""Scene(
    version: 1,
    seed: {pick(range(1000))},
    surface: {shape},
    views: Photographed(
        cameras: (count: {pick([4, 6])}, test: 2, size: {pick([16, 24])}),
        truth: (
            albedo: {pick(["Constant(0.5, 0.3, 0.2)", "Stripes(colors: [(0.7, 0.2, 0.1), (0.1, 0.2, 0.6)])"])},
            specular: (albedo: (0.2, 0.2, 0.2), roughness: {pick([0.15, 0.3, 0.6])}),
            light: Lobes(lobes: [(axis: (0, 1, 0), sharpness: {pick([1, 5, 20])}, amplitude: (1, 1, 1))]),
        ),
    ),
    light: Unknown(lobes: {pick([4, 8])}),
    material: ({sheen}{gloss}),
    visibility: {visibility},
    passes: [
        {lines},
    ],
)
"""


class Watch:
    """Largest memory and most open files of a process."""

    def __init__(self):
        self.kib, self.files = 0, 0

    def look(self, process):
        try:
            with open(f"/proc/{process.pid}/status") as status:
                sizes = [int(line.split()[1]) for line in status if line.startswith("VmHWM:")]
            self.kib = max([self.kib, *sizes])
            self.files = max(self.files, len(os.listdir(f"/proc/{process.pid}/fd")))
        except (OSError, ValueError):
            pass  # It has ended, or this system does not tell.


def run(program, path, out, resume, watch, kill_after=None, more=()):
    """Runs a scene; returns the exit code, or None if it was killed."""
    words = [program, "run", path, "--out", out, "--quiet", "--threads", "2", *more]
    with open(os.path.join(os.path.dirname(os.path.dirname(out)), "runs.log"), "a") as log:
        process = subprocess.Popen(words + (["--resume"] if resume else []), stdout=log, stderr=log)
    start = time.monotonic()
    while process.poll() is None:
        watch.look(process)
        if kill_after is not None and time.monotonic() - start > kill_after:
            process.send_signal(signal.SIGKILL)
            process.wait()
            return None
        time.sleep(0.005)
    return process.returncode


def without_times(value):
    """A JSON value without seconds and memory, however deep they are."""
    if isinstance(value, dict):
        return {key: without_times(of) for key, of in value.items() if key not in {"fit_secs", "peak_rss_mib", "seconds"}}
    return [without_times(of) for of in value] if isinstance(value, list) else value


def untimed(path):
    """The bytes of a result without times."""
    name = os.path.basename(path)
    with open(path, "rb") as file:
        data = file.read()
    if name == "log.csv":
        rows = [line.split(",") for line in data.decode().splitlines()]
        return "\n".join(",".join(row[:1] + row[2:]) for row in rows)
    if name == "metrics.json":
        return json.dumps(without_times(json.loads(data)))
    return data


def results(out):
    """All results by relative path."""
    found = {}
    for folder, _, names in os.walk(out):
        for name in names:
            if name not in UNCOMPARED:
                path = os.path.join(folder, name)
                found[os.path.relpath(path, out)] = untimed(path)
    return found


def try_scene(program, folder, seed, watch):
    """Returns kills and compared files; raises AssertionError."""
    dice = random.Random(seed)
    os.makedirs(folder)
    path = os.path.join(folder, "scene.ron")
    with open(path, "w") as file:
        file.write(scene(dice.choice))
    # Pages have the name of the folder.
    whole, broken = os.path.join(folder, "whole", "out"), os.path.join(folder, "broken", "out")
    start = time.monotonic()
    code = run(program, path, whole, False, watch)
    assert code == 0, f"exit code {code}"
    took = time.monotonic() - start
    kills, resume = 0, False
    # After some kills it may end in peace.
    while kills < 6:
        code = run(program, path, broken, resume, watch, dice.uniform(0.02, 1.0) * took)
        resume = os.path.exists(os.path.join(broken, "run.json"))
        if code is not None:
            break
        kills += 1
    if code is None:
        code = run(program, path, broken, resume, watch)
    assert code == 0, f"resumed: exit code {code}"
    return kills, compare(whole, broken)


def kill_often(program, path, folder, kills, seed, longest, more):
    """Kills one scene at so many moments, at most `longest` seconds apart, from the start to the end again and again; returns runs,
    compared files and a run's seconds."""
    dice, watch = random.Random(seed), Watch()
    whole = os.path.join(folder, "whole", "out")
    start = time.monotonic()
    code = run(program, path, whole, False, watch, more=more)
    assert code == 0, f"exit code {code}"
    took = time.monotonic() - start
    done, ends, compared = 0, 0, 0
    longest = longest or max(4.0, 3.0 * took / kills)
    while done < kills:
        broken = os.path.join(folder, f"broken-{ends}", "out")
        resume, code = False, None
        while code is None:
            moment = dice.uniform(0.0, longest) if done < kills else None
            code = run(program, path, broken, resume, watch, moment, more)
            resume = os.path.exists(os.path.join(broken, "run.json"))
            done += code is None
        assert code == 0, f"resumed after {done} kills: exit code {code}"
        compared += compare(whole, broken)
        ends += 1
    return ends, compared, took


def compare(whole, broken):
    """The number of files, all of them equal."""
    a, b = results(whole), results(broken)
    assert a.keys() == b.keys(), f"files differ: {sorted(a.keys() ^ b.keys())}"
    for name in a:
        assert a[name] == b[name], f"{name} differs"
    return len(a)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("program", help="the program to be tried")
    arguments.add_argument("--minutes", type=float, default=60)
    arguments.add_argument("--seed", type=int, default=1, help="of the first scene")
    arguments.add_argument("--out", default="soak")
    arguments.add_argument("--scene", help="a scene file: it alone is killed and compared")
    arguments.add_argument("--kills", type=int, default=50, help="of --scene")
    arguments.add_argument("--longest", type=float, help="most seconds between kills of --scene; more than its longest stage takes")
    # What follows `--` is for the program's runs of --scene.
    end_of_own = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    given, more = arguments.parse_args(sys.argv[1:end_of_own]), sys.argv[end_of_own + 1 :]
    os.makedirs(given.out, exist_ok=True)
    if given.scene:
        paths = [os.path.abspath(path) for path in (given.program, given.scene, given.out)]
        ends, compared, took = kill_often(*paths, given.kills, given.seed, given.longest, more)
        print(f"{given.kills} kills in {ends} runs of {took:.0f} s, {compared} files compared, all equal")
        return
    end = time.monotonic() + 60 * given.minutes
    seed, kills, compared, failures, watched = given.seed, 0, 0, [], []
    while time.monotonic() < end:
        folder, watch = os.path.join(given.out, f"scene-{seed}"), Watch()
        try:
            killed, files = try_scene(os.path.abspath(given.program), folder, seed, watch)
            kills, compared = kills + killed, compared + files
            shutil.rmtree(folder)
        except AssertionError as error:
            failures.append(seed)
            print(f"seed {seed}: {error}; see {folder}", flush=True)
        watched.append(watch)
        seed += 1
    quarter = max(1, len(watched) // 4)
    most = lambda part: (max(w.kib for w in part) // 1024, max(w.files for w in part))
    (first_mib, first_files), (last_mib, last_files) = most(watched[:quarter]), most(watched[-quarter:])
    print(
        f"{len(watched)} scenes, {kills} kills, {compared} files compared, {len(failures)} failures {failures}; "
        f"largest memory {first_mib} MiB at first and {last_mib} MiB at last, open files {first_files} and {last_files}"
    )
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
