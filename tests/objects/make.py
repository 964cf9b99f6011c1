#!/usr/bin/env python3
"""Test objects of known surface, material and light, one a kind, path traced by Mitsuba 3.

    python tests/objects/make.py FOLDER [--only cavities,print] [--size 192] [--views 48] [--samples 128]

Writes FOLDER/<kind>/ in PhySG's layout: training and test views, masks, cameras, mesh.glb, the lights as maps, and below test/gt the truth: albedo, normals,
and the test views under each other light. No part of Lobelia makes the truth: shapes are formulas, meshed by marching cubes; the BRDF is written here
(PhySG supp. eqs. 1-7 with the distribution of normals "sg", or Lambert + GGX with Smith's term, "ggx").

Needs mitsuba, numpy and scikit-image (PyPI), and LLVM (DRJIT_LIBLLVM_PATH names it).
"""

import argparse
import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from skimage.measure import marching_cubes

mi.set_variant("llvm_ad_rgb")
FOV = 38
DISTANCE = 2.8
EVENTS = 6


# Shapes: signed distances of points (n, 3), not necessarily exact.


def length(p):
    return np.linalg.norm(p, axis=-1)


def ball(p, center, radius):
    return length(p - np.array(center)) - radius


def capsule(p, a, b, radius):
    a, b = np.array(a, float), np.array(b, float)
    along = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return length(p - a - along[:, None] * (b - a)) - radius


def box(p, center, half, rounded):
    q = np.abs(p - np.array(center)) - (np.array(half) - rounded)
    return length(np.maximum(q, 0)) + np.minimum(q.max(-1), 0) - rounded


def torus(p, major, minor):
    return np.hypot(np.hypot(p[:, 0], p[:, 2]) - major, p[:, 1]) - minor


def joined(*distances, softness=0.0):
    result = distances[0]
    for other in distances[1:]:
        h = np.clip(0.5 + 0.5 * (other - result) / max(softness, 1e-9), 0, 1)
        result = other + (result - other) * h - softness * h * (1 - h)
    return result


def cut(p, solid, hole, softness):
    return -joined(-solid, hole, softness=softness)


def cavities(p):
    solid = ball(p, (0, 0, 0), 0.82)
    golden = math.pi * (3 - math.sqrt(5))
    for i in range(11):
        y = 1 - 2 * (i + 0.5) / 11
        r, angle = math.sqrt(1 - y * y), golden * i
        axis = np.array([r * math.cos(angle), y, r * math.sin(angle)])
        solid = cut(p, solid, capsule(p, 0.42 * axis, 1.2 * axis, 0.13 + 0.05 * (i % 3)), 0.04)
    return solid


def corner(p):
    walls = joined(box(p, (0, -0.5, 0), (0.62, 0.05, 0.62), 0.02), box(p, (-0.57, 0, 0), (0.05, 0.5, 0.62), 0.02))
    walls = joined(walls, box(p, (0, 0, -0.57), (0.62, 0.5, 0.05), 0.02), softness=0.02)
    return joined(walls, ball(p, (-0.12, -0.18, -0.12), 0.28), ball(p, (0.34, -0.32, 0.2), 0.14), softness=0.02)


def blob(p):
    return joined(ball(p, (0, -0.25, 0), 0.5), ball(p, (0.3, 0.3, 0.1), 0.33), ball(p, (-0.35, 0.25, -0.1), 0.3), softness=0.18)


def ring(p):
    bent = p[:, [0, 2, 1]] * np.array([1, 1, -1])
    return joined(torus(p, 0.6, 0.2), torus(bent, 0.6, 0.12), ball(p, (0, 0, 0), 0.26), softness=0.05)


def drapery(p):
    folds = 0.035 * np.sin(9 * np.arctan2(p[:, 2], p[:, 0]) + 4 * p[:, 1]) * np.clip(0.3 - p[:, 1], 0, 1)
    body = joined(capsule(p, (0, -0.6, 0), (0, 0.1, 0), 0.36), ball(p, (0, 0.5, 0.03), 0.27), softness=0.12)
    return joined(body + folds, capsule(p, (-0.4, 0.05, 0.1), (0.25, -0.25, 0.42), 0.1), softness=0.08)


def pot(p):
    around = np.hypot(p[:, 0], p[:, 2])
    profile = 0.5 + 0.1 * np.sin(5 * p[:, 1]) - 0.25 * p[:, 1] ** 2
    body = np.maximum((around - profile) * 0.8, np.abs(p[:, 1]) - 0.62) - 0.02
    body = cut(p, body, np.maximum((around - profile + 0.12) * 0.8, 0.1 - p[:, 1]), 0.03)
    handle = np.hypot(np.hypot(p[:, 0] - 0.55, p[:, 1]) - 0.22, p[:, 2]) - 0.06
    return joined(body, np.maximum(handle, 0.42 - p[:, 0]), softness=0.04)


def twisted(p):
    angle = 1.6 * p[:, 1]
    c, s = np.cos(angle), np.sin(angle)
    turned = np.stack([c * p[:, 0] - s * p[:, 2], p[:, 1], s * p[:, 0] + c * p[:, 2]], -1)
    return 0.7 * box(turned, (0, 0, 0), (0.42, 0.7, 0.3), 0.12)


def carton(p):
    return joined(box(p, (0, -0.1, 0), (0.52, 0.42, 0.34), 0.03), box(p, (0.12, 0.42, 0.02), (0.28, 0.14, 0.2), 0.02), softness=0.01)


# Materials: base color, specular albedo and roughness at points, in Dr.Jit or NumPy.


def mixed(dry, wet, amount):
    return [a + (b - a) * amount for a, b in zip(dry, wet)]


def stripe(m, x):
    """1 where x is in the first half of its period 1, else 0, with a soft edge of 2 %."""
    return step(m, m.abs(2 * (x - m.floor(x)) - 1) - 0.5, 0.04)


def step(m, x, width):
    return m.minimum(m.maximum(x / width + 0.5, 0), 1)


def noise(m, x, y, z):
    """A fixed random number of each cell of the unit lattice."""
    value = m.sin(12.9898 * m.floor(x) + 78.233 * m.floor(y) + 37.719 * m.floor(z)) * 43.7585
    return value - m.floor(value)


def gray(value):
    return [value, value, value]


def banded(m, x, y, z):
    color = mixed([0.75, 0.7, 0.6], [0.6, 0.22, 0.14], stripe(m, 2.2 * y + 0.15 * m.sin(5 * x)))
    return mixed(color, [0.16, 0.27, 0.42], stripe(m, 1.1 * y + 0.3)), gray(0.05), 0.25


def saturated(m, x, y, z):
    white = [0.78, 0.76, 0.72]
    color = mixed(white, [0.75, 0.06, 0.04], step(m, -0.5 - x, 0.02))
    return mixed(color, [0.05, 0.4, 0.65], step(m, -0.5 - z, 0.02)), gray(0.04), 0.45


def checks(m, x, y, z):
    a, b = stripe(m, 1.9 * x + 0.2), stripe(m, 1.9 * y)
    odd = a + b - 2 * a * b
    color = mixed([0.5, 0.47, 0.4], [0.16, 0.3, 0.26], stripe(m, 1.3 * z + 0.3 * x))
    return color, gray(0.05), 0.2 + 0.3 * odd


def gilded(m, x, y, z):
    metal = stripe(m, 4 * m.atan2(z, x) / math.pi + 0.1)
    return mixed([0.35, 0.06, 0.08], gray(0.0), metal), mixed(gray(0.04), [0.95, 0.72, 0.36], metal), 0.4 - 0.12 * metal


def plaster(m, x, y, z):
    dirt = 0.5 + 0.5 * m.sin(3 * x + 1) * m.sin(2.3 * y) * m.sin(2.7 * z + 0.5)
    return mixed([0.82, 0.8, 0.77], [0.66, 0.61, 0.53], dirt * dirt), gray(0.04), 0.6


def lacquer(m, x, y, z):
    return mixed([0.03, 0.028, 0.028], [0.13, 0.012, 0.01], stripe(m, 2.3 * y + 0.1)), gray(0.05), 0.16


def gradient(m, x, y, z):
    return [0.45 + 0.3 * m.sin(2.1 * y + c) * m.cos(1.3 * x + 0.7 * c + 0.6 * z) for c in (0.0, 1.9, 3.7)], gray(0.04), 0.35


def printed(m, x, y, z):
    cream = [0.78, 0.72, 0.58]
    ink = step(m, noise(m, 26 * x, 11 * y, 26 * z) - 0.5, 0.01) * stripe(m, 11 * y) * step(m, 0.5 - noise(m, 4 * x, 3 * y, 4 * z), 0.01)
    color = mixed(cream, [0.05, 0.05, 0.07], ink)
    color = mixed(color, [0.62, 0.08, 0.06], step(m, -0.36 - y, 0.01) * step(m, y + 0.47, 0.01))
    return mixed(color, [0.1, 0.2, 0.5], step(m, y - 0.31, 0.005)), gray(0.04), 0.3


# Lights: radiance from directions (..., 3), +Y up.


def glow(d, axis, sharpness, color):
    axis = np.array(axis, float) / np.linalg.norm(axis)
    return np.exp(sharpness * (d @ axis - 1))[..., None] * np.array(color)


def panel(d, axis, half, color):
    axis = np.array(axis, float) / np.linalg.norm(axis)
    side = np.cross(axis, [0, 1, 0.01])
    side /= np.linalg.norm(side)
    front = np.maximum(d @ axis, 1e-6)
    x, y = d @ side / front, d @ np.cross(side, axis) / front
    inside = [np.clip((h - np.abs(v)) / 0.03 + 0.5, 0, 1) for v, h in ((x, half[0]), (y, half[1]))]
    return (inside[0] * inside[1] * (d @ axis > 0.01))[..., None] * np.array(color)


def noon(d):
    up = np.clip(d[..., 1:2], -1, 1)
    sky = np.where(up > 0, (1 - up) ** 3 * np.array([0.75, 0.8, 0.85]) + (1 - (1 - up) ** 3) * np.array([0.25, 0.42, 0.8]), np.array([0.22, 0.19, 0.15]))
    return 0.8 * sky + glow(d, (0.5, 0.75, 0.35), 900, (210, 195, 165)) + glow(d, (0.5, 0.75, 0.35), 25, (1.2, 1.05, 0.8))


def studio(d):
    room = 0.06 + 0.03 * d[..., 1:2] * np.array([1, 1, 1])
    lamps = panel(d, (0.9, 0.5, 0.4), (0.45, 0.6), (6.5, 6.1, 5.4)) + panel(d, (-0.8, 0.3, -0.6), (0.25, 0.7), (3.4, 3.9, 4.6))
    return room * np.array([1, 0.97, 0.93]) + lamps + panel(d, (-0.1, 1, 0.2), (0.5, 0.3), (3.2, 3.2, 3.1))


def evening(d):
    up = d[..., 1:2]
    sky = np.exp(-((up - 0.05) / 0.22) ** 2) * np.array([1.6, 0.75, 0.35]) * (0.5 + 0.5 * np.clip(-d[..., 0:1] + 0.4, 0, 1))
    sky = sky + np.clip(up, 0, 1) * np.array([0.2, 0.25, 0.5]) + 0.06
    return sky + glow(d, (-0.8, 0.25, 0.5), 300, (60, 34, 16)) + glow(d, (0.6, 0.5, -0.7), 60, (2.5, 2.7, 3.4))


SKIES = {"noon": noon, "studio": studio, "evening": evening}


@dataclass
class Kind:
    shape: Callable
    material: Callable
    light: str
    ndf: str


KINDS = {
    "cavities": Kind(cavities, banded, "noon", "sg"),
    "corner": Kind(corner, saturated, "evening", "ggx"),
    "checks": Kind(blob, checks, "studio", "ggx"),
    "gilded": Kind(ring, gilded, "noon", "ggx"),
    "plaster": Kind(drapery, plaster, "studio", "ggx"),
    "lacquer": Kind(pot, lacquer, "evening", "sg"),
    "gradient": Kind(twisted, gradient, "noon", "sg"),
    "print": Kind(carton, printed, "studio", "sg"),
}


class Surface(mi.BSDF):
    """Lambert's diffuse and one specular lobe, both read from a formula of the position."""

    def __init__(self, props):
        super().__init__(props)
        self.kind = KINDS[props["kind"]]
        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        self.m_components = [flags]
        self.m_flags = flags

    def at(self, si):
        albedo, specular, roughness = self.kind.material(dr, si.p.x, si.p.y, si.p.z)
        return mi.Color3f(*albedo), mi.Color3f(*specular), mi.Float(roughness)

    def distribution(self, cos_half, roughness):
        alpha2 = roughness**4
        if self.kind.ndf == "sg":
            return dr.exp(2 / alpha2 * (cos_half - 1)) / (dr.pi * alpha2)
        below = cos_half**2 * (alpha2 - 1) + 1
        return alpha2 / (dr.pi * below**2)

    def masking(self, l, v, roughness):
        """G / ((n.l) (n.v))"""
        if self.kind.ndf == "sg":
            k = (roughness + 1) ** 2 / 8
            return 1 / ((l * (1 - k) + k) * (v * (1 - k) + k))
        alpha2 = roughness**4
        return 2 / (l * dr.sqrt(alpha2 + (1 - alpha2) * v**2) + v * dr.sqrt(alpha2 + (1 - alpha2) * l**2))

    def both(self, si, wo):
        """BRDF times cosine, and the density of `sample`."""
        albedo, specular, roughness = self.at(si)
        l, v = wo.z, si.wi.z
        h = dr.normalize(wo + si.wi)
        hv = dr.maximum(dr.dot(h, si.wi), 1e-4)
        d = self.distribution(h.z, roughness)
        power = dr.exp2(-(5.55473 * hv + 6.8316) * hv) if self.kind.ndf == "sg" else (1 - hv) ** 5
        fresnel = specular + (1 - specular) * power
        value = (albedo / dr.pi + fresnel * d * self.masking(l, v, roughness) / 4) * l
        pdf = 0.5 * l / dr.pi + 0.5 * d * h.z / (4 * hv)
        ok = (l > 0) & (v > 0)
        return dr.select(ok, value, 0), dr.select(ok, pdf, 0)

    def sample(self, ctx, si, sample1, sample2, active=True):
        roughness = self.at(si)[2]
        alpha2 = roughness**4
        if self.kind.ndf == "sg":
            cos = 1 + alpha2 / 2 * dr.log(1 - sample2.x * (1 - dr.exp(-4 / alpha2)))
        else:
            cos = dr.sqrt((1 - sample2.x) / (1 + (alpha2 - 1) * sample2.x))
        cos = dr.clip(cos, 0, 1)
        sin, angle = dr.safe_sqrt(1 - cos**2), 2 * dr.pi * sample2.y
        h = mi.Vector3f(sin * dr.cos(angle), sin * dr.sin(angle), cos)
        wo = dr.select(sample1 < 0.5, mi.warp.square_to_cosine_hemisphere(sample2), mi.reflect(si.wi, h))
        value, pdf = self.both(si, wo)
        active = active & (pdf > 0)
        bs = mi.BSDFSample3f()
        bs.wo, bs.pdf, bs.eta = wo, pdf, 1.0
        bs.sampled_component, bs.sampled_type = mi.UInt32(0), mi.UInt32(+mi.BSDFFlags.GlossyReflection)
        return bs, dr.select(active, value / dr.maximum(pdf, 1e-12), 0)

    def eval(self, ctx, si, wo, active=True):
        return self.both(si, wo)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self.both(si, wo)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        return self.both(si, wo)

    def eval_diffuse_reflectance(self, si, active=True):
        return self.at(si)[0]

    def to_string(self):
        return "Surface[]"


mi.register_bsdf("surface", Surface)


def mesh_of(shape, cells):
    """Positions and unit normals of the vertices and the triangles, filling the ball of radius 0.88."""
    line = np.linspace(-1, 1, cells + 1)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
    values = shape(grid).reshape(cells + 1, cells + 1, cells + 1)
    positions, triangles, _, _ = marching_cubes(values, 0.0, spacing=(2 / cells,) * 3)
    positions -= 1
    e = 1e-3
    normals = np.stack([shape(positions + e * axis) - shape(positions - e * axis) for axis in np.eye(3)], -1)
    # Marching cubes' winding: outside is where values are positive.
    triangles = triangles[:, ::-1]
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    facing = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[triangles[:, 0]])
    if np.median(facing) < 0:
        triangles = triangles[:, ::-1]
    solid = length(np.cross(b - a, c - a)) > 1e-12
    normals /= length(normals)[:, None]
    positions *= 0.88 / length(positions).max()
    return positions.astype("f4"), normals.astype("f4"), np.ascontiguousarray(triangles[solid]).astype("u4")


def write_glb(path, positions, normals, triangles):
    blobs = [positions.tobytes(), normals.tobytes(), triangles.tobytes()]
    offsets = np.cumsum([0] + [len(b) for b in blobs]).tolist()
    views = [{"buffer": 0, "byteOffset": o, "byteLength": len(b)} for o, b in zip(offsets, blobs)]
    bounds = {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": len(positions), "type": "VEC3", **bounds},
        {"bufferView": 1, "componentType": 5126, "count": len(normals), "type": "VEC3"},
        {"bufferView": 2, "componentType": 5125, "count": triangles.size, "type": "SCALAR"},
    ]
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}
    scene = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}]}
    scene |= {"buffers": [{"byteLength": offsets[-1]}], "bufferViews": views, "accessors": accessors}
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(blobs)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(body), len(text), 0x4E4F534A)
    path.write_bytes(head + text + struct.pack("<II", len(body), 0x004E4942) + body)


def sky_map(sky, height=256):
    """A latitude-longitude map: +Y up, the left edge -Z, then +X, +Z, -X."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    theta, phi = np.pi * v, 2 * np.pi * u
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)
    return sky(d).astype("f4")


def cameras(count, turn):
    """Eyes on a sphere, few of them far below."""
    golden = math.pi * (3 - math.sqrt(5))
    for i in range(count):
        y = 0.92 - 1.45 * (i + 0.5) / count
        r, angle = math.sqrt(1 - y * y), golden * i + turn
        yield DISTANCE * np.array([r * math.cos(angle), y, r * math.sin(angle)])


def camera_entry(eye, size):
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    w2c = np.eye(4)
    w2c[:3, :3], w2c[:3, 3] = rotation, -rotation @ eye
    k = np.eye(4)
    k[0, 0] = k[1, 1] = 0.5 * size / math.tan(math.radians(FOV) / 2)
    k[0, 2] = k[1, 2] = 0.5 * size
    return {"K": k.ravel().tolist(), "W2C": w2c.ravel().tolist(), "img_size": [size, size]}


def sensor(eye, size, samples):
    to_world = mi.ScalarTransform4f().look_at(origin=eye.tolist(), target=[0, 0, 0], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgba", "component_format": "float32", "rfilter": {"type": "box"}}
    return mi.load_dict({"type": "perspective", "fov": FOV, "to_world": to_world, "film": film, "sampler": {"type": "multijitter", "sample_count": samples}})


def write_exr(path, pixels):
    path.parent.mkdir(parents=True, exist_ok=True)
    mi.Bitmap(np.ascontiguousarray(pixels[..., :3].astype("f4"))).write(str(path))


def write_mask(path, alpha):
    path.parent.mkdir(parents=True, exist_ok=True)
    mi.Bitmap((255 * (alpha > 0.5)).astype("u1")).write(str(path))


def make(name, folder, splits, size, views, samples, cells):
    kind = KINDS[name]
    folder.mkdir(parents=True, exist_ok=True)
    positions, normals, triangles = mesh_of(kind.shape, cells)
    write_glb(folder / "mesh.glb", positions, normals, triangles)
    shape = mi.Mesh("mesh", len(positions), len(triangles), has_vertex_normals=True, props=mesh_props(name))
    params = mi.traverse(shape)
    params["vertex_positions"], params["vertex_normals"], params["faces"] = positions.ravel(), normals.ravel(), triangles.ravel()
    params.update()
    scenes = {}
    for sky, radiance in SKIES.items():
        values = sky_map(radiance)
        write_exr(folder / "env" / f"{sky}.exr", values)
        light = {"type": "envmap", "bitmap": mi.Bitmap(values)}
        scenes[sky] = mi.load_dict({"type": "scene", "light": light, "mesh": shape})
    path = mi.load_dict({"type": "path", "max_depth": EVENTS + 1, "rr_depth": 100, "hide_emitters": True})
    truth = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
    # The truth is seen in fewer, coarser and cleaner pictures.
    for split, count, turn, many in (("train", views, 0.0, samples), ("test", 4, 1.0, 16 * samples)):
        if split not in splits:
            continue
        if split == "test":
            size = size * 2 // 3
        entries = {}
        for i, eye in enumerate(cameras(count, turn)):
            picture = f"rgb_{i:06}"
            entries[f"{picture}.exr"] = camera_entry(eye, size)
            rendered = lambda integrator, sky, n: np.array(mi.render(scenes[sky], sensor=sensor(eye, size, n), integrator=integrator, seed=i, spp=n))
            seen = rendered(path, kind.light, many)
            write_exr(folder / split / "image" / f"{picture}.exr", seen)
            write_mask(folder / split / "mask" / f"{picture}.png", seen[..., 3])
            if split == "test":
                values = rendered(truth, kind.light, samples)
                write_exr(folder / "test/gt" / f"albedo_{i:06}.exr", values[..., -6:-3])
                write_exr(folder / "test/gt" / f"normal_{i:06}.exr", values[..., -3:])
                for sky in SKIES:
                    if sky != kind.light:
                        write_exr(folder / "test/gt" / f"relight_{sky}" / f"{picture}.exr", rendered(path, sky, many))
        (folder / split / "cam_dict_norm.json").write_text(json.dumps(entries))
    (folder / "truth.json").write_text(json.dumps({"kind": name, "light": kind.light, "ndf": kind.ndf, "events": EVENTS, "samples": samples}))


def mesh_props(name):
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "surface", "kind": name})
    return props


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--only", default=",".join(KINDS))
    arguments.add_argument("--splits", default="train,test")
    arguments.add_argument("--size", type=int, default=192)
    arguments.add_argument("--views", type=int, default=48)
    arguments.add_argument("--samples", type=int, default=128)
    arguments.add_argument("--cells", type=int, default=128)
    given = arguments.parse_args()
    for name in given.only.split(","):
        make(name, given.folder / name, given.splits.split(","), given.size, given.views, given.samples, given.cells)
        print(name, flush=True)


if __name__ == "__main__":
    main()
