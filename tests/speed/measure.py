#!/usr/bin/env python3
"""How time and memory grow, and how two builds compare.

    python3 tests/speed/measure.py growth PROGRAM [--axes lobes,texels] [--data DIR] [--quick]
    python3 tests/speed/measure.py compare OLD NEW [--runs 3] [--data DIR] [--quick]

`growth` runs scenes that differ in one number at a time and prints a table per number, as in docs/research/growth.md: seconds of each part, peak memory, and
the exponents p of seconds ~ number^p, between the first and the last row and between the last two. `compare` runs the same scenes with two programs, in
turn, and prints the least seconds of each part with their ratio; it ends with status 1 where a part of at least a second became slower by a tenth, which
a quiet machine tells from noise in three runs, and marks that row. DIR is the folder of an object with photographs and masks; without it the numbers of grid cells are left
out. `--quick` leaves out the largest numbers. Python's standard library is enough.
"""

import argparse
import json
import math
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
SCENES = HERE.parent.parent / "scenes"

FIT = 'Fit(name: "fit", steps: 200, batch: 4096)'
FILM = 'Render(name: "picture", render: (views: Named([]), orbit: (frames: 2, size: {size})))'

# Numbers of each axis, ascending; --quick leaves out the last.
AXES = {
    "lobes": [8, 32, 128, 512, 2048],
    "texels": [96**2, 256**2, 512**2, 1024**2, 2048**2, 3162**2],
    "triangles": [10**3, 10**4, 10**5, 10**6, 10**7],
    "views": [10, 30, 100, 300, 1000],
    "pixels": [256**2, 512**2, 1024**2, 2048**2],
    "cells": [64, 128, 256, 512],
    "threads": [1, 2],
}


def write_glb(path, triangles):
    """A sphere with a dent, of about so many triangles, with texture coordinates."""
    rows = max(4, round(math.sqrt(triangles / 4)))
    columns = 2 * rows
    positions, normals, places, indices = [], [], [], []
    for j in range(rows + 1):
        for i in range(columns + 1):
            polar, around = math.pi * j / rows, 2 * math.pi * i / columns
            normal = (math.sin(polar) * math.cos(around), math.cos(polar), math.sin(polar) * math.sin(around))
            radius = 0.9 - 0.25 * math.exp(-6 * ((normal[0] - 0.8) ** 2 + normal[1] ** 2))
            positions += [radius * c for c in normal]
            normals += normal
            places += [i / columns, j / rows]
    for j in range(rows):
        for i in range(columns):
            a, b = j * (columns + 1) + i, (j + 1) * (columns + 1) + i
            indices += [a, a + 1, b] if j > 0 else []
            indices += [a + 1, b + 1, b] if j < rows - 1 else []
    parts = [struct.pack(f"<{len(v)}{kind}", *v) for v, kind in [(positions, "f"), (normals, "f"), (places, "f"), (indices, "I")]]
    views, offset = [], 0
    for part in parts:
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(part)})
        offset += len(part)
    count = len(positions) // 3
    vertex = lambda view, kind: {"bufferView": view, "componentType": 5126, "count": count, "type": kind}
    bounds = {"min": [min(positions[k::3]) for k in range(3)], "max": [max(positions[k::3]) for k in range(3)]}
    accessors = [vertex(0, "VEC3") | bounds, vertex(1, "VEC3"), vertex(2, "VEC2")]
    accessors.append({"bufferView": 3, "componentType": 5125, "count": len(indices), "type": "SCALAR"})
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3}
    scene = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
    scene |= {"meshes": [{"primitives": [primitive]}], "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": offset}]}
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    blob = b"".join(parts)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(blob), len(text), 0x4E4F534A)
    path.write_bytes(head + text + struct.pack("<II", len(blob), 0x004E4942) + blob)


def settings(axis, number, home):
    """The scene and the changes to it in which this number is the given one, and the number of threads."""
    picture = FILM.format(size=1024)
    changes = {"views.spp": "4", "views.cameras": "(count: 20, test: 1, size: 128)", "light": "Unknown(lobes: 64)"}
    passes, threads = [FIT, picture], 2
    if axis == "lobes":
        changes["light"] = f"Unknown(lobes: {number})"
    elif axis == "texels":
        changes["surface"] = f"Sphere(radius: 0.9, texture_size: {math.isqrt(number)})"
    elif axis == "triangles":
        write_glb(home / "sphere.glb", number)
        changes["surface"] = f'Mesh(path: "{home / "sphere.glb"}", texture_size: 256)'
    elif axis == "views":
        changes["views.cameras"] = f"(count: {number}, test: 1, size: 128)"
    elif axis == "pixels":
        passes = [FILM.format(size=math.isqrt(number))]
        changes["light"] = "Fixed(Lobes(lobes: [(axis: (0, 1, 0), sharpness: 2, amplitude: (1, 1, 1))]))"
        changes["material"] = "(albedo: Fixed(Constant(0.4, 0.3, 0.2)), specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.3)))"
    elif axis == "threads":
        threads = number
    if axis == "cells":
        return SCENES / "photos.ron", {"passes": f"[Shape(hollows: false, levels: [(cells: {number}, steps: 100)])]"}, threads
    return SCENES / "quickstart.ron", changes | {"passes": f"[{','.join(passes)}]"}, threads


def measure(program, axis, number, options, home):
    """Seconds of each part of a run, and its peak memory in MiB."""
    scene, changes, threads = settings(axis, number, home)
    command = [program, "run", scene, "--out", home / "out", "--force", "--quiet", "--profile", "--threads", str(threads)]
    command += ["--data", options.data] if axis == "cells" else []
    for path, value in changes.items():
        command += ["--set", f"{path}={value}"]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{axis} {number}:\n{done.stderr}")
    metrics = json.loads((home / "out" / "metrics.json").read_text())
    return seconds_by_part((home / "out" / "profile.txt").read_text()), metrics["peak_rss_mib"]


def seconds_by_part(table):
    """Seconds of the run and of each of its spans, from the table of --profile."""
    head, *rows = table.splitlines()
    found = {"run": float(head.split()[-2])}
    for row in rows:
        seconds, _, name = row.split(maxsplit=2)
        found[name] = float(seconds)
    return found


def exponent(first, last):
    """p of value ~ number^p through two points."""
    (a, x), (b, y) = first, last
    return math.log(y / x) / math.log(b / a) if x > 0 and y > 0 else float("nan")


def growth(options, home):
    for axis, numbers in axes(options):
        rows = [(number, *measure(options.program, axis, number, options, home)) for number in numbers]
        names = [name for name in all_names(row[1] for row in rows) if max(row[1].get(name, 0.0) for row in rows) >= 0.2]
        print(f"\n| {axis} | " + " | ".join(f"{name}, s" for name in names) + " | memory, MiB |")
        print("|---" * (len(names) + 2) + "|")
        for number, seconds, memory in rows:
            print(f"| {number} | " + " | ".join(f"{seconds.get(name, 0.0):.2f}" for name in names) + f" | {memory:.0f} |")
        series = [[(row[0], row[1].get(name, 0.0)) for row in rows] for name in names] + [[(row[0], row[2]) for row in rows]]
        for words, first in [("exponent", 0), ("of the last two", -2)]:
            print(f"| {words} | " + " | ".join(f"{exponent(values[first], values[-1]):.2f}" for values in series) + " |", flush=True)


def all_names(runs):
    """The names of all parts of some runs, in their order."""
    return list(dict.fromkeys(name for seconds in runs for name in seconds))


def compare(options, home):
    any_slower = False
    print("| scene | part | old, s | new, s | new / old |\n|---|---|---|---|---|")
    for axis, numbers in axes(options):
        number = numbers[-1]
        runs = [[measure(program, axis, number, options, home) for program in (options.old, options.new)] for _ in range(options.runs)]
        for name in all_names(run[k][0] for run in runs for k in (0, 1)):
            old, new = (min(run[k][0].get(name, 0.0) for run in runs) for k in (0, 1))
            slower = max(old, new) >= 1.0 and new > 1.1 * old
            any_slower |= slower
            if max(old, new) >= 0.2:
                ratio = f"{new / old:.2f}" if old > 0 else "new"
                print(f"| {axis} {number} | {name} | {old:.2f} | {new:.2f} | {ratio}{' (slower)' if slower else ''} |", flush=True)
        old, new = (min(run[k][1] for run in runs) for k in (0, 1))
        print(f"| {axis} {number} | memory, MiB | {old:.0f} | {new:.0f} | {new / old:.2f} |", flush=True)
    return any_slower


def axes(options):
    """The axes that were asked for, with their numbers."""
    for axis in options.axes.split(","):
        if axis == "cells" and not options.data:
            print("cells: left out without --data", file=sys.stderr)
            continue
        numbers = AXES[axis]
        yield axis, numbers[: max(2, len(numbers) - 1)] if options.quick else numbers


def programs_of(options):
    return [options.program] if options.kind == "growth" else [options.old, options.new]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="kind", required=True)
    for kind, programs in [("growth", ["program"]), ("compare", ["old", "new"])]:
        one = kinds.add_parser(kind)
        for program in programs:
            one.add_argument(program, type=Path)
        one.add_argument("--axes", default=",".join(AXES))
        one.add_argument("--data", type=Path)
        one.add_argument("--quick", action="store_true")
        one.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    unknown = [axis for axis in options.axes.split(",") if axis not in AXES]
    if unknown:
        parser.error(f"unknown axis {', '.join(unknown)}; the axes are {', '.join(AXES)}")
    if options.runs < 1:
        parser.error("--runs must be at least 1")
    for program in programs_of(options):
        if not program.is_file():
            parser.error(f"{program} is not a file; build it with cargo build --release")
    with tempfile.TemporaryDirectory(prefix="lobelia-speed-") as home:
        if options.kind == "growth":
            growth(options, Path(home))
        elif compare(options, Path(home)):
            sys.exit(1)


if __name__ == "__main__":
    main()
