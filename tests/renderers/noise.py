#!/usr/bin/env python3
"""Time to equal noise of Lobelia's path tracer and of Mitsuba 3 (LLVM), side by side on this machine.

    python tests/renderers/noise.py PROGRAM SAVED MAP [--views 3] [--size 256] [--paths 64] [--variant llvm_ad_rgb] [--keep FOLDER]

SAVED is the folder of a run's `Save` pass, MAP an equirectangular OpenEXR map that lights the object. Both render the same views with up to six
scattering events, light and BRDF sampled together. Lobelia's BRDF is PhySG's; Mitsuba has a rough plastic of the same roughness, diffuse texture and
reflectance straight on, which is as bright but not the same, so that each is compared with its own picture of many paths: the noise is the root mean
square difference to it over the object, relative to the mean radiance there. Its square falls as one over the time, and so

    time to 1 % noise = seconds x (noise / 0.01)^2.

Lobelia's seconds are those of the pass, with reading of the scene left out; Mitsuba's are those of rendering after a first one that compiles its kernels.
Needs Mitsuba and numpy (PyPI: mitsuba); without them it says so and ends with success. Mitsuba compiles with the LLVM that DRJIT_LIBLLVM_PATH names;
LLVM 15 failed on a machine with AVX-512, where LLVM 19 worked.
"""

import argparse
import json
import math
import re
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

try:
    import mitsuba as mi
    import numpy as np
except ImportError as missing:
    print(f"skipped: {missing}")
    sys.exit(0)

FOV = 38
BOUNCES = 6
# Paths of the picture that noise is measured against, in those of the one that is timed.
CONVERGED = 16


def read_glb(path):
    """Positions, normals and texture coordinates of the vertices, and the triangles, of a GLB of one mesh."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    scene = json.loads(data[20 : 20 + length])
    blob = data[28 + length :]
    kinds = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
    widths = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}

    def values(number):
        accessor = scene["accessors"][number]
        view = scene["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        width = widths[accessor["type"]]
        flat = np.frombuffer(blob, kinds[accessor["componentType"]], accessor["count"] * width, start)
        return flat.reshape(-1, width)

    part = scene["meshes"][0]["primitives"][0]
    named = part["attributes"]
    return [values(named[name]) for name in ("POSITION", "NORMAL", "TEXCOORD_0")] + [values(part["indices"])]


def cameras(positions, count):
    """Cameras around the object, which see it whole."""
    low, high = positions.min(0), positions.max(0)
    target = (low + high) / 2
    distance = 0.4 * np.linalg.norm(high - low) / math.sin(math.radians(FOV / 2))
    for k in range(count):
        turn = 2 * math.pi * k / count
        side = np.array([math.sin(turn), 0.3, math.cos(turn)])
        yield (target + distance * side / np.linalg.norm(side)).tolist(), target.tolist()


def read_picture(path):
    """Radiance and coverage of an OpenEXR picture."""
    parts = dict(mi.Bitmap(str(path)).split())
    color = np.array(parts["<root>"], np.float32)
    return color[..., :3], color[..., 3]


def lobelia(options, views, paths, seed, home):
    """Lobelia's pictures, and the seconds of the pass."""
    specs = [
        f'(name: "{k:02}", eye: ({",".join(map(str, eye))}), target: ({",".join(map(str, target))}), '
        f"fov_degrees: {FOV}, width: {options.size}, height: {options.size})"
        for k, (eye, target) in enumerate(views)
    ]
    shading = f"PathTraced(spp: {paths}, max_bounces: {BOUNCES})"
    sets = [
        f"seed={seed}",
        f"views=Cameras([{','.join(specs)}])",
        f'light=Fixed(Map(path: "{options.map.resolve()}"))',
        "visibility=None",
        f'passes=[Render(name: "paths", render: (shading: {shading}))]',
    ]
    command = [options.program, "run", options.saved / "scene.ron", "--out", home, "--force", "--quiet"]
    subprocess.run([*command, *(word for value in sets for word in ("--set", value))], check=True)
    seconds = json.loads((home / "run.json").read_text())["passes"][0]["secs"]
    return [read_picture(home / "paths" / f"{k:02}.exr") for k in range(len(views))], seconds


def specular_of(path):
    """Specular albedo (its first channel) and roughness of a saved scene of one material."""
    number = r"([0-9.eE+-]+)"
    found = re.search(rf"specular:\s*\(\s*albedo: Fixed\({number}.*?roughness: Fixed\({number}\)", path.read_text(), re.DOTALL)
    if found is None:
        sys.exit(f"{path}: not an object of one material with a fixed specular albedo and roughness")
    return float(found[1]), float(found[2])


def mitsuba_scene(options, mesh):
    """The object in Mitsuba, by the material that the scene file names."""
    positions, normals, places, triangles = mesh
    specular, roughness = specular_of(options.saved / "scene.ron")
    root = math.sqrt(specular)
    bsdf = {
        "type": "roughplastic",
        "distribution": "beckmann",
        # PhySG's lobe e^(2/R^4 (n.h - 1)) is Beckmann's with a slope of R^2.
        "alpha": roughness**2,
        "int_ior": (1 + root) / (1 - root),
        "diffuse_reflectance": {"type": "bitmap", "filename": str(options.saved / "albedo.exr"), "raw": True},
    }
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    shape = mi.Mesh("object", len(positions), len(triangles.reshape(-1)) // 3, props, True, True)
    params = mi.traverse(shape)
    params["vertex_positions"] = positions.astype(np.float32).ravel()
    params["vertex_normals"] = normals.astype(np.float32).ravel()
    params["vertex_texcoords"] = places.astype(np.float32).ravel()
    params["faces"] = triangles.astype(np.uint32).ravel()
    params.update()
    light = {"type": "envmap", "filename": str(options.map)}
    integrator = {"type": "path", "max_depth": BOUNCES + 1, "rr_depth": 4, "hide_emitters": True}
    return mi.load_dict({"type": "scene", "integrator": integrator, "light": light, "object": shape})


def mitsuba(options, scene, views, paths, seed):
    """Mitsuba's pictures, and the seconds of rendering them."""
    pictures, seconds = [], 0.0
    for k, (eye, target) in enumerate(views):
        film = {"type": "hdrfilm", "width": options.size, "height": options.size, "pixel_format": "rgba", "rfilter": {"type": "box"}}
        look = mi.ScalarTransform4f().look_at(origin=eye, target=target, up=[0, 1, 0])
        sensor = mi.load_dict({"type": "perspective", "fov": FOV, "fov_axis": "y", "to_world": look, "film": film, "sampler": {"type": "multijitter"}})
        start = time.perf_counter()
        # Memory of wide launches: a part of the paths at a time.
        most = max(1, (1 << 25) // options.size**2)
        passes = 1
        while paths // passes > most or paths % passes:
            passes += 1
        sums = 0
        for part in range(passes):
            picture = mi.render(scene, sensor=sensor, spp=paths // passes, seed=seed * 100_003 + k * 997 + part)
            sums = sums + np.array(picture)
        seconds += time.perf_counter() - start
        pictures.append((sums[..., :3] / passes, sums[..., 3] / passes))
    return pictures, seconds


def noise(pictures, converged):
    """Root mean square difference over what the object covers, relative to the mean radiance there."""
    squares, total, count = 0.0, 0.0, 0
    for (color, _), (truth, alpha) in zip(pictures, converged):
        covered = alpha > 0.999
        squares += ((color - truth)[covered] ** 2).sum()
        total += truth[covered].sum()
        count += truth[covered].size
    return math.sqrt(squares / count) / (total / count)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("saved", type=Path)
    parser.add_argument("map", type=Path)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--paths", type=int, default=64)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    if math.isqrt(options.paths) ** 2 != options.paths:
        parser.error("--paths must be a square number, for Mitsuba's sampler")
    for path in (Path(options.program), options.saved / "scene.ron", options.map):
        if not path.is_file():
            parser.error(f"{path} is not a file")
    specular_of(options.saved / "scene.ron")
    mi.set_variant(options.variant)
    mi.set_log_level(mi.LogLevel.Error)
    mesh = read_glb(options.saved / "mesh.glb")
    views = list(cameras(mesh[0], options.views))
    # Kept until the program ends.
    passing = tempfile.TemporaryDirectory(prefix="lobelia-mitsuba-")
    home = options.keep or Path(passing.name)
    home.mkdir(parents=True, exist_ok=True)
    converged, _ = lobelia(options, views, CONVERGED * options.paths, 1, home / "converged")
    pictures, seconds = lobelia(options, views, options.paths, 0, home / "timed")
    rows = [("Lobelia", seconds, noise(pictures, converged))]
    scene = mitsuba_scene(options, mesh)
    mitsuba(options, scene, views[:1], options.paths, 7)
    theirs, seconds = mitsuba(options, scene, views, options.paths, 0)
    truth, _ = mitsuba(options, scene, views, CONVERGED * options.paths, 1)
    rows.append((f"Mitsuba {mi.__version__} {options.variant}", seconds, noise(theirs, truth)))
    for name, rendered in [("lobelia", pictures), ("mitsuba", theirs)]:
        mi.util.write_bitmap(str(home / f"{name}.png"), np.concatenate([color for color, _ in rendered], 1))
    size, count, paths = options.size, options.views, options.paths
    print(f"{count} views of {size}x{size}, {paths} paths a pixel")
    for name, seconds, level in rows:
        print(f"{name:28} {seconds:7.2f} s, noise {100 * level:6.2f} %, to 1 %: {seconds * (level / 0.01) ** 2:8.1f} s")


if __name__ == "__main__":
    main()
