"""Runs inside Blender: builds a .blend file of boxes, spheres, cylinders and rectangles, from JSON.

``PYTHON blender_room.py ROOM.json OUT.blend SIDES``: so many sides has what is round. Colours are a
smooth function of the place, without light or noise.
"""

import json
import math
import sys

import bpy
import numpy as np

SIDES = int(sys.argv[-1])
RING_M = 0.05


def rectangle(half):
    return [(x * half[0], y * half[1], 0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], [(0, 1, 2, 3)]


def box(half):
    corners = [(x * half[0], y * half[1], z * half[2]) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]
    return corners, [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def circle(count):
    return [(math.cos(2 * math.pi * i / count), math.sin(2 * math.pi * i / count)) for i in range(count)]


def cylinder(half):
    """Rings of faces: Cycles is off by 0.6 mm on triangles of 2.8 m x 0.2 mm."""
    n = SIDES
    (radius, _, height) = half
    m = math.ceil(2 * height / RING_M)
    corners = [(radius * x, radius * y, z) for z in np.linspace(-height, height, m + 1) for x, y in circle(n)]
    sides = [
        (k * n + i, k * n + (i + 1) % n, (k + 1) * n + (i + 1) % n, (k + 1) * n + i)
        for k in range(m)
        for i in range(n)
    ]
    return corners, [*sides, tuple(range(n - 1, -1, -1)), tuple(range(m * n, (m + 1) * n))]


def sphere(half):
    n = SIDES
    m = SIDES // 2
    radius = half[0]
    rings = [(math.sin(math.pi * k / m), math.cos(math.pi * k / m)) for k in range(1, m)]
    corners = [(radius * s * x, radius * s * y, radius * c) for s, c in rings for x, y in circle(n)]
    faces = [
        (k * n + i, (k + 1) * n + i, (k + 1) * n + (i + 1) % n, k * n + (i + 1) % n)
        for k in range(m - 2)
        for i in range(n)
    ]
    top, bottom = len(corners), len(corners) + 1
    corners += [(0, 0, radius), (0, 0, -radius)]
    last = (m - 2) * n
    faces += [(top, i, (i + 1) % n) for i in range(n)]
    faces += [(bottom, last + (i + 1) % n, last + i) for i in range(n)]
    return corners, faces


SHAPES = {"rectangle": rectangle, "box": box, "sphere": sphere, "cylinder": cylinder}


def add(name, solids, color):
    vertices = []
    faces = []
    for each in solids:
        corners, sides = SHAPES[each["kind"]](each["half"])
        faces += [tuple(len(vertices) + i for i in side) for side in sides]
        vertices += (np.array(corners) @ np.array(each["axes"]) + each["center"]).tolist()
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    links = material.node_tree.links
    nodes.clear()
    shine = nodes.new("ShaderNodeEmission")
    out = nodes.new("ShaderNodeOutputMaterial")
    kinds = "NewGeometry", "VectorMath", "VectorMath"
    place, wave, dim = (nodes.new(f"ShaderNode{each}") for each in kinds)
    wave.operation = "SINE"
    dim.operation = "MULTIPLY_ADD"
    dim.inputs[1].default_value = (0.25, 0.25, 0.25)
    dim.inputs[2].default_value = color
    links.new(place.outputs["Position"], wave.inputs[0])
    links.new(wave.outputs[0], dim.inputs[0])
    links.new(dim.outputs[0], shine.inputs["Color"])
    links.new(shine.outputs[0], out.inputs[0])
    mesh.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))


def main():
    source, out, _ = sys.argv[-3:]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with open(source, encoding="utf-8") as file:
        room = json.load(file)
    for name, each in room.items():
        add(name, each["solids"], each["color"])
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Standard"
    # colours at the pixels' centres
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 0.01
    bpy.ops.wm.save_as_mainfile(filepath=out)


main()
