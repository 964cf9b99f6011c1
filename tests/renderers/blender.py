"""An exported object under its light in Cycles; writes its linear radiance. Called by check.mjs."""

import json
import math
import os
import sys

import bpy
from mathutils import Vector

SAMPLES = 256


def from_gltf(point):
    """Blender's importer turns (x, y, z) to (x, -z, y)."""
    return Vector((point[0], -point[2], point[1]))


def set_light(scene, path):
    world = bpy.data.worlds.new("light")
    scene.world = world
    world.use_nodes = True
    nodes = world.node_tree.nodes
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(path)
    world.node_tree.links.new(texture.outputs["Color"], nodes["Background"].inputs["Color"])


def set_camera(scene, camera):
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit = "VERTICAL"
    lens.angle = math.radians(camera["fov"])
    placed = bpy.data.objects.new("camera", lens)
    placed.location = from_gltf(camera["eye"])
    placed.rotation_euler = (from_gltf(camera["target"]) - placed.location).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(placed)
    scene.camera = placed


def set_output(scene, camera, path):
    render = scene.render
    render.engine = "CYCLES"
    scene.cycles.samples = SAMPLES
    scene.cycles.use_denoising = False
    render.film_transparent = True
    render.resolution_x = render.resolution_y = camera["size"]
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.exr_codec = "ZIP"
    render.image_settings.color_depth = "32"
    render.image_settings.color_mode = "RGBA"
    render.filepath = path


def main():
    job = json.loads(sys.argv[-1])
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.import_scene.gltf(filepath=os.path.join(job["folder"], "mesh.glb"))
    set_light(scene, os.path.join(job["folder"], "light_blender.hdr"))
    set_camera(scene, job["camera"])
    set_output(scene, job["camera"], job["picture"])
    bpy.ops.render.render(write_still=True)


main()
