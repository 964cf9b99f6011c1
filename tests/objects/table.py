#!/usr/bin/env python3
"""Fits the objects of make.py with one thing at a time replaced by the truth, and prints a table.

    python tests/objects/table.py PROGRAM FOLDER OUT [--only cavities,print] [--cases found,light] [--scene 'visibility: None,']

Cases: `found`, everything but the mesh unknown; `light`, under the true light. Columns are PSNR in dB: held-out views; each other light; albedo;
and `bias`, the closed form against the path tracer on the object that the case has found, in the held-out views.
"""

import argparse
import json
import re
import subprocess
from pathlib import Path

KINDS = ["cavities", "corner", "checks", "gilded", "plaster", "lacquer", "gradient", "print"]
PASSES = """
    Fit(name: "fit"), Render(name: "novel"), Render(name: "traced", render: (shading: PathTraced(spp: 256, max_bounces: 6, map: false))),
    {relights}
    Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs), {truths}], albedo: Folder("$DATA/test/gt")),
"""


def scene(folder, case, more):
    truth = json.loads((folder / "truth.json").read_text())
    skies = [path.stem for path in sorted((folder / "env").glob("*.exr")) if path.stem != truth["light"]]
    relights = [f'Relight(name: "{sky}", light: Map(path: "$DATA/env/{sky}.exr")),' for sky in skies]
    truths = [f'(pass: "{sky}", truth: Folder("$DATA/test/gt/relight_{sky}"), scale: PerChannel),' for sky in skies]
    passes = PASSES.format(relights="\n    ".join(relights), truths=" ".join(truths))
    light = f'Fixed(Map(path: "$DATA/env/{truth["light"]}.exr", lobes: 256))' if case == "light" else "Unknown()"
    return (
        f'Scene(version: 1, surface: Mesh(path: "$DATA/mesh.glb"), views: Dataset(path: "$DATA"),\nlight: {light},{more}\npasses: [{passes}])\n',
        skies,
    )


def run(program, folder, case, out, more):
    text, skies = scene(folder, case, more)
    out.mkdir(parents=True, exist_ok=True)
    (out / "scene.ron").write_text(text)
    command = [program, "run", out / "scene.ron", "--data", folder, "--out", out / "run", "--force", "--quiet"]
    subprocess.run(command, check=True)
    metrics = json.loads((out / "run/metrics.json").read_text())
    passes = metrics["passes"]
    compared = subprocess.run([program, "eval", out / "run/novel", out / "run/traced"], check=True, capture_output=True, text=True).stdout
    bias = float(re.search(r"^mean +([\d.]+)", compared, re.MULTILINE)[1])
    return [passes[name]["psnr"] for name in ["novel", *skies]] + [metrics["albedo_psnr"], bias]


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("program")
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("out", type=Path)
    arguments.add_argument("--only", default=",".join(KINDS))
    arguments.add_argument("--cases", default="found,light")
    arguments.add_argument("--scene", default="", help="more of the scene, such as 'visibility: None,'")
    given = arguments.parse_args()
    print(f"{'object':10}{'case':8}{'novel':>8}{'relit':>8}{'relit':>8}{'albedo':>8}{'bias':>8}")
    for name in given.only.split(","):
        for case in given.cases.split(","):
            scores = run(given.program, given.folder / name, case, given.out / name / case, given.scene)
            print(f"{name:10}{case:8}" + "".join(f"{score:8.2f}" for score in scores), flush=True)


if __name__ == "__main__":
    main()
