"""Runs inside Blender: its own panoramic cameras, ``PYTHON blender_panoramas.py SCENE.blend SHOTS.json``.

Each shot is written as a multi-part EXR of colours and data, one sample at the centre of every pixel. It
shares nothing with the program that omniscv starts: this is the judge of it.
"""

import json
import math
import sys

import bpy
from mathutils import Matrix


def prepare(scene, layer):
    render = scene.render
    cycles = scene.cycles
    render.engine = "CYCLES"
    cycles.device = "CPU"
    cycles.samples = 1
    cycles.use_denoising = False
    cycles.use_adaptive_sampling = False
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 0.01
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_object_index = True
    settings = render.image_settings
    settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    render.resolution_percentage = 100
    render.use_persistent_data = True
    meshes = sorted((each for each in bpy.data.objects if each.type == "MESH"), key=lambda each: each.name)
    for index, each in enumerate(meshes, start=1):
        each.pass_index = index


def aim(camera, shot):
    data = camera.data
    data.type = "PANO"
    data.panorama_type = shot["type"]
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36.0
    data.sensor_height = 36.0
    data.clip_start = 1e-3
    data.clip_end = 1e4
    data.fisheye_fov = math.radians(shot["fov_deg"])
    data.fisheye_lens = shot.get("lens_mm", 10.0)
    for number, value in enumerate(shot.get("polynomial", ())):
        setattr(data, f"fisheye_polynomial_k{number}", value)
    camera.matrix_world = Matrix.Translation(shot["position"]) @ Matrix(shot["R_w_b"]).to_4x4()


def main():
    path, shots = sys.argv[-2:]
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=False)
    scene = bpy.context.scene
    layer = bpy.context.view_layer
    prepare(scene, layer)
    scene.camera = bpy.data.objects.new("Judge", bpy.data.cameras.new("Judge"))
    scene.collection.objects.link(scene.camera)
    with open(shots, encoding="utf-8") as file:
        for shot in json.load(file):
            aim(scene.camera, shot)
            scene.render.resolution_x, scene.render.resolution_y = shot["size"]
            scene.render.filepath = shot["file"]
            bpy.ops.render.render(write_still=True)


main()
