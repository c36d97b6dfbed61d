"""Build a furnished living room and save it as a .blend file.

    python examples/blender/make_room.py room.blend       # a Python that has bpy, or:
    blender --background --python examples/blender/make_room.py -- room.blend

The script builds everything: boxes and cylinders with rounded edges, and materials of noise and colours.
The world axes are omniscv's: X forward, Y left, Z up, metres. The origin is the middle of the floor.

This file runs inside Blender and uses its Python API, which is licensed under the GNU GPL: consider that
before you share a changed copy. omniscv itself neither imports nor needs it.
"""

import math
import random
import sys

import bpy

LENGTH, WIDTH, HEIGHT = 5.6, 4.4, 2.7
"""Size of the room along X, Y and Z, metres."""
WINDOW = (-0.1, 1.9, 0.75, 2.25)
"""Lowest and highest Y, lowest and highest Z, metres: in the wall at X = LENGTH / 2."""
WALL = 0.2
_random = random.Random(7)


# -- materials -----------------------------------------------------------------------------------------


def material(
    name, color, roughness=0.6, metallic=0.0, *, second=None, scale=8.0, stretch=(1, 1, 1), bump=0.0
):
    """Return a material of one colour, or of two mixed by noise; ``bump`` is the height of the noise."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic
    if second is None and not bump:
        return made
    where, mapping = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    noise = nodes.new("ShaderNodeTexNoise")
    mapping.inputs["Scale"].default_value = stretch
    noise.inputs["Scale"].default_value = scale
    noise.inputs["Detail"].default_value = 6
    links.new(where.outputs["Object"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], noise.inputs["Vector"])
    if second is not None:
        ramp = nodes.new("ShaderNodeValToRGB")
        ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.35, 0.65
        ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (*color, 1), (*second, 1)
        links.new(noise.outputs["Fac"], ramp.inputs["Fac"])
        links.new(ramp.outputs["Color"], shader.inputs["Base Color"])
    if bump:
        raised = nodes.new("ShaderNodeBump")
        raised.inputs["Distance"].default_value = bump
        links.new(noise.outputs["Fac"], raised.inputs["Height"])
        links.new(raised.outputs["Normal"], shader.inputs["Normal"])
    return made


def light(name, color, strength):
    """Return a material that emits light, about W/m^2 a steradian."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Emission Color"].default_value = (*color, 1)
    shader.inputs["Emission Strength"].default_value = strength
    return made


# -- shapes --------------------------------------------------------------------------------------------


def add(name, points, faces, surface, rounded=0.0, *, smooth=False):
    """Return an object of points and faces; ``rounded`` is the radius of its edges, metres."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    mesh.materials.append(surface)
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    for polygon in mesh.polygons:
        polygon.use_smooth = smooth
    if rounded:
        bevel = made.modifiers.new("rounded", "BEVEL")
        bevel.width, bevel.segments = rounded, 3
    return made


def box(name, center, size, surface, rounded=0.0, turn_deg=0.0):
    """Return a box by its centre, turned about the vertical."""
    half = [s / 2 for s in size]
    corners = [(x * half[0], y * half[1], z * half[2]) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    made = add(name, corners, faces, surface, rounded)
    made.location, made.rotation_euler = center, (0, 0, math.radians(turn_deg))
    return made


def turned(name, center, profile, surface, sides=40):
    """Return a body of revolution about the vertical; ``profile``: (radius, height) upwards, metres."""
    around = [(math.cos(2 * math.pi * i / sides), math.sin(2 * math.pi * i / sides)) for i in range(sides)]
    points = [(r * x, r * y, z) for r, z in profile for x, y in around]
    faces = []
    for low in range(0, (len(profile) - 1) * sides, sides):
        for i in range(sides):
            j = (i + 1) % sides
            faces.append((low + i, low + j, low + sides + j, low + sides + i))
    faces += [tuple(reversed(range(sides))), tuple(range(len(points) - sides, len(points)))]
    made = add(name, points, faces, surface, smooth=True)
    made.location = center
    return made


def ball(radius, height=0.0, steps=24):
    """Return the profile of a sphere whose lowest point is at a height."""
    turns = [math.pi * k / steps for k in range(steps + 1)]
    return [(radius * math.sin(t) + 1e-4, height + radius * (1 - math.cos(t))) for t in turns]


def four(name, center, apart, size, surface):
    """Return four boxes, such as legs, ``apart`` from the centre along X and Y."""
    (x, y, z), (a, b) = center, apart
    return [box(name, (x + s * a, y + t * b, z), size, surface, 0.006) for s in (-1, 1) for t in (-1, 1)]


def joined(name, *objects):
    """Join several objects into one, with their modifiers applied."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for each in objects:
        mesh = bpy.data.meshes.new_from_object(each.evaluated_get(depsgraph))
        mesh.transform(each.matrix_world)
        each.modifiers.clear()
        each.data, each.location, each.rotation_euler = mesh, (0, 0, 0), (0, 0, 0)
    first = {"active_object": objects[0], "object": objects[0]}
    if len(objects) > 1:
        with bpy.context.temp_override(**first, selected_objects=objects, selected_editable_objects=objects):
            bpy.ops.object.join()
    objects[0].name = objects[0].data.name = name
    return objects[0]


# -- the room ------------------------------------------------------------------------------------------


def shell(plaster, accent, paint):
    """Build a floor of planks, the ceiling, walls with a window, and the skirting."""
    x, y = LENGTH / 2, WIDTH / 2
    oak = []
    for d in (-0.03, 0.0, 0.04):
        light_one, dark_one = (0.42 + d, 0.26 + d, 0.13 + d), (0.3 + d, 0.17 + d, 0.08 + d)
        grain = {"second": dark_one, "scale": 3.0, "stretch": (1, 14, 1), "bump": 0.0008}
        oak.append(material("oak", light_one, 0.35, **grain))
    planks, width, start = [], 0.14, -y
    while start < y - 1e-6:
        left = -x - _random.uniform(0, 1.6)
        while left < x:
            a, b = max(left, -x), min(left + 1.8, x)
            here = ((a + b) / 2, start + width / 2, -0.01)
            size = (b - a - 0.002, min(width, y - start) - 0.002, 0.02)
            planks.append(box("plank", here, size, _random.choice(oak), 0.001))
            left += 1.8
        start += width
    planks.append(box("ground", (0, 0, -0.06), (LENGTH + 2 * WALL, WIDTH + 2 * WALL, 0.08), oak[0]))
    joined("Floor", *planks)
    box("Ceiling", (0, 0, HEIGHT + WALL / 2), (LENGTH + 2 * WALL, WIDTH + 2 * WALL, WALL), paint)
    box("Wall_Back", (-x - WALL / 2, 0, HEIGHT / 2), (WALL, WIDTH + 2 * WALL, HEIGHT), plaster)
    box("Wall_Left", (0, y + WALL / 2, HEIGHT / 2), (LENGTH, WALL, HEIGHT), accent)
    box("Wall_Right", (0, -y - WALL / 2, HEIGHT / 2), (LENGTH, WALL, HEIGHT), plaster)
    y0, y1, z0, z1 = WINDOW
    around = (
        ((y0 - y - WALL) / 2, HEIGHT / 2, y0 + y + WALL, HEIGHT),
        ((y1 + y + WALL) / 2, HEIGHT / 2, y + WALL - y1, HEIGHT),
        ((y0 + y1) / 2, z0 / 2, y1 - y0, z0),
        ((y0 + y1) / 2, (z1 + HEIGHT) / 2, y1 - y0, HEIGHT - z1),
    )
    parts = [box("part", (x + WALL / 2, yc, zc), (WALL, w, h), plaster) for yc, zc, w, h in around]
    joined("Wall_Front", *parts)
    bars = [((y0 + y1) / 2, z, y1 - y0, 0.06) for z in (z0 + 0.03, z1 - 0.03)]
    bars += [(yc, (z0 + z1) / 2, 0.06, z1 - z0) for yc in (y0 + 0.03, (y0 + y1) / 2, y1 - 0.03)]
    frame = [box("bar", (x + 0.1, yc, zc), (0.06, w, h), paint, 0.008) for yc, zc, w, h in bars]
    joined("Window_Frame", *frame)
    box("Window_Sill", (x - 0.06, (y0 + y1) / 2, z0 - 0.02), (0.24, y1 - y0 + 0.16, 0.04), paint, 0.008)
    skirting = [((0, s * (y - 0.008), 0.045), (LENGTH, 0.016, 0.09)) for s in (-1, 1)] + [
        ((s * (x - 0.008), 0, 0.045), (0.016, WIDTH, 0.09)) for s in (-1, 1)
    ]
    joined("Skirting", *(box("strip", at, size, paint, 0.003) for at, size in skirting))


def sofa(cloth, wood):
    """Build a sofa with cushions along the left wall."""
    cx, cy = -0.6, WIDTH / 2 - 0.55
    parts = [box("seat", (cx, cy, 0.25), (2.1, 0.9, 0.26), cloth, 0.04)]
    parts += [box("arm", (cx + s * 1.0, cy, 0.36), (0.18, 0.9, 0.5), cloth, 0.06) for s in (-1, 1)]
    parts += [box("back", (cx, cy + 0.36, 0.5), (2.1, 0.2, 0.6), cloth, 0.07)]
    seats = (0.9, 0.76, 0.16)
    parts += [box("cushion", (cx + s * 0.46, cy - 0.06, 0.44), seats, cloth, 0.06) for s in (-1, 1)]
    joined("Sofa", *parts, *four("foot", (cx, cy, 0.06), (0.95, 0.38), (0.06, 0.06, 0.12), wood))
    for i, (shift, color, turn) in enumerate(((-0.72, (0.75, 0.38, 0.08), 12), (0.7, (0.1, 0.28, 0.3), -14))):
        fabric = material(f"pillow {i}", color, 0.9, bump=0.002, scale=60)
        pillow = box(f"Pillow_{i}", (cx + shift, cy + 0.16, 0.68), (0.42, 0.14, 0.4), fabric, 0.065, turn)
        pillow.rotation_euler[0] = math.radians(-14)


def table(wood, ceramic, paper):
    """Build a low table in front of the sofa, with a bowl, books and a cup."""
    cx, cy = -0.5, 0.55
    top = box("top", (cx, cy, 0.4), (1.1, 0.6, 0.04), wood, 0.012)
    joined("Table", top, *four("leg", (cx, cy, 0.19), (0.48, 0.24), (0.05, 0.05, 0.38), wood))
    bowl = [(0.05, 0), (0.1, 0.02), (0.15, 0.07), (0.165, 0.1)]
    turned("Bowl", (cx + 0.25, cy + 0.05, 0.42), [*bowl, (0.155, 0.1), (0.14, 0.07), (0.02, 0.02)], ceramic)
    colors = (0.75, 0.2, 0.03), (0.8, 0.42, 0.03), (0.45, 0.5, 0.05)
    for i, (a, b) in enumerate(((0.03, 0.02), (-0.05, 0.03), (0.0, -0.05))):
        fruit = material(f"fruit {i}", colors[i], 0.35)
        turned(f"Fruit_{i}", (cx + 0.25 + a, cy + 0.05 + b, 0.455), ball(0.04), fruit)
    for i, (width, color) in enumerate(((0.3, (0.1, 0.14, 0.3)), (0.26, (0.5, 0.08, 0.06)))):
        cover, at = material(f"cover {i}", color, 0.5), (cx - 0.28, cy - 0.06, 0.432 + 0.024 * i)
        box(f"Magazine_{i}", at, (width, 0.2, 0.022), cover, 0.003, 20 - 32 * i)
    cup = [(0.03, 0), (0.036, 0.02), (0.04, 0.09), (0.035, 0.09), (0.03, 0.01)]
    turned("Cup", (cx - 0.02, cy - 0.16, 0.42), cup, paper)


def bookshelf(wood):
    """Build a full bookshelf along the back wall."""
    bx, by, width, height, depth = -LENGTH / 2 + 0.17, -0.9, 1.3, 2.0, 0.3
    side = (depth, 0.03, height)
    parts = [box("side", (bx, by + s * width / 2, height / 2), side, wood, 0.004) for s in (-1, 1)]
    parts += [box("back", (bx - depth / 2 + 0.008, by, height / 2), (0.016, width, height), wood)]
    levels = [0.04, 0.44, 0.83, 1.22, 1.61, height - 0.015]
    parts += [box("board", (bx, by, z), (depth, width, 0.03), wood, 0.004) for z in levels]
    joined("Bookshelf", *parts)
    colors = [(0.35, 0.05, 0.05), (0.05, 0.12, 0.3), (0.55, 0.42, 0.2), (0.08, 0.22, 0.12), (0.6, 0.57, 0.5)]
    covers = [material(f"book {i}", color, 0.55) for i, color in enumerate(colors)]
    for row, z in enumerate(levels[:-1]):
        books, at = [], by - width / 2 + 0.03
        end = by + width / 2 - 0.03 - (0.35 if row in (1, 3) else 0.0)
        while at < end - 0.05:
            thick, tall = _random.uniform(0.018, 0.05), _random.uniform(0.2, 0.32)
            place = (bx + 0.03 - _random.uniform(0, 0.02), at + thick / 2, z + 0.016 + tall / 2)
            books.append(box("book", place, (0.2, thick - 0.002, tall), _random.choice(covers), 0.003))
            at += thick
        joined(f"Books_{row}", *books)
    clay = material("clay", (0.6, 0.27, 0.15), 0.7)
    vase = [(0.05, 0), (0.08, 0.06), (0.085, 0.12), (0.05, 0.19), (0.035, 0.22), (0.045, 0.25), (0.03, 0.25)]
    turned("Vase", (bx + 0.02, by + width / 2 - 0.2, levels[1] + 0.016), vase, clay)
    globe = [(0.06, 0), (0.05, 0.015), (0.01, 0.03), *ball(0.09, 0.03)]
    sea = material("sea", (0.04, 0.16, 0.35), 0.25, second=(0.22, 0.35, 0.1), scale=6)
    turned("Globe", (bx + 0.02, by + width / 2 - 0.2, levels[3] + 0.016), globe, sea)


def desk(wood, metal):
    """Build a desk with a chair and a screen at the right wall."""
    cx, cy = 1.2, -WIDTH / 2 + 0.36
    top = box("top", (cx, cy, 0.73), (1.5, 0.65, 0.03), wood, 0.006)
    joined("Desk", top, *four("leg", (cx, cy, 0.357), (0.68, 0.26), (0.05, 0.05, 0.715), metal))
    dark = material("screen", (0.01, 0.012, 0.015), 0.08)
    joined(
        "Screen",
        box("panel", (cx, cy - 0.12, 1.06), (0.62, 0.03, 0.37), dark, 0.006),
        box("neck", (cx, cy - 0.14, 0.82), (0.05, 0.03, 0.16), metal),
        box("base", (cx, cy - 0.12, 0.752), (0.24, 0.18, 0.012), metal, 0.004),
    )
    box("Keyboard", (cx, cy + 0.16, 0.756), (0.42, 0.14, 0.02), metal, 0.005)
    leather = material("leather", (0.03, 0.03, 0.035), 0.45, bump=0.0006, scale=120)
    chair_x, chair_y = cx - 0.1, cy + 0.62
    joined(
        "Chair",
        box("seat", (chair_x, chair_y, 0.46), (0.46, 0.46, 0.07), leather, 0.025, 15),
        box("back", (chair_x + 0.05, chair_y + 0.2, 0.78), (0.42, 0.06, 0.5), leather, 0.025, 15),
        turned("post", (chair_x, chair_y, 0.06), [(0.03, 0), (0.03, 0.37)], metal, 20),
        *(box("star", (chair_x, chair_y, 0.05), (0.56, 0.04, 0.03), metal, 0.008, 36 * i) for i in range(5)),
    )


def plant(clay):
    """Build a plant, leaves on stems, in the corner beside the window."""
    px, py = LENGTH / 2 - 0.42, -WIDTH / 2 + 0.45
    earth = material("earth", (0.05, 0.03, 0.02), 0.95)
    turned("Pot", (px, py, 0), [(0.13, 0), (0.17, 0.3), (0.18, 0.32), (0.16, 0.32), (0.15, 0.29)], clay)
    turned("Earth", (px, py, 0.27), [(0.15, 0), (0.14, 0.02)], earth)
    leaf = material("leaf", (0.04, 0.16, 0.03), 0.4, second=(0.09, 0.27, 0.06), scale=20)
    points, faces = [], []
    for i in range(46):
        turn, lift, reach = 2.4 * i, math.radians(28 + 50 * _random.random()), 0.3 + 0.4 * _random.random()
        root = (0.05 * math.cos(turn), 0.05 * math.sin(turn), 0.3 + 0.012 * i)
        for k in range(5):  # along the leaf, which bends down
            part = k / 4
            out, up = reach * part * math.cos(lift), reach * (part * math.sin(lift) - 0.55 * part * part)
            half = 0.045 * math.sin(math.pi * (0.12 + 0.86 * part))
            for side in (-1, 1):
                points.append((
                    root[0] + out * math.cos(turn) - side * half * math.sin(turn),
                    root[1] + out * math.sin(turn) + side * half * math.cos(turn),
                    root[2] + up,
                ))  # fmt: skip
        first = 10 * i
        faces += [(first + 2 * k, first + 2 * k + 1, first + 2 * k + 3, first + 2 * k + 2) for k in range(4)]
    add("Plant", points, faces, leaf, smooth=True).location = (px, py, 0)


def lamps(metal):
    """Build a floor lamp that is switched on, and a globe under the ceiling."""
    lx, ly = -LENGTH / 2 + 0.45, WIDTH / 2 - 0.5
    joined(
        "Lamp_Stand",
        turned("foot", (lx, ly, 0), [(0.14, 0), (0.14, 0.02), (0.012, 0.03), (0.012, 1.45)], metal),
    )
    shade = material("shade", (0.85, 0.78, 0.65), 0.8)
    shade.node_tree.nodes["Principled BSDF"].inputs["Transmission Weight"].default_value = 0.35
    turned("Lamp_Shade", (lx, ly, 1.42), [(0.2, 0), (0.14, 0.26), (0.135, 0.26), (0.195, 0)], shade)
    warm = light("bulb", (1.0, 0.72, 0.42), 60)
    turned("Lamp_Bulb", (lx, ly, 1.47), [(0.01, 0), (0.04, 0.04), (0.045, 0.08), (0.01, 0.12)], warm)
    hung = light("globe lamp", (1.0, 0.86, 0.68), 6)
    turned("Ceiling_Lamp", (0.3, -0.2, HEIGHT - 0.5), ball(0.15), hung)
    turned("Ceiling_Cord", (0.3, -0.2, HEIGHT - 0.2), [(0.008, 0), (0.008, 0.2)], metal, 12)


def pictures(wood):
    """Build frames around fields of colour on the left wall, above the sofa."""
    fields = (
        ((0.85, 0.5, 0.2), (0.2, 0.25, 0.4), 2.0),
        ((0.75, 0.72, 0.66), (0.1, 0.3, 0.3), 3.5),
        ((0.5, 0.1, 0.1), (0.9, 0.8, 0.6), 1.4),
    )
    for i, (first, second, scale) in enumerate(fields):
        canvas = material(f"canvas {i}", first, 0.8, second=second, scale=scale)
        at = (-1.4 + 0.8 * i, WIDTH / 2 - 0.015, 1.65)
        parts = [box("canvas", (at[0], at[1] - 0.008, at[2]), (0.5, 0.016, 0.66), canvas)]
        for s in (-1, 1):
            parts.append(
                box("bar", (at[0] + s * 0.27, at[1] - 0.012, at[2]), (0.04, 0.034, 0.74), wood, 0.004)
            )
            parts.append(
                box("bar", (at[0], at[1] - 0.012, at[2] + s * 0.35), (0.58, 0.034, 0.04), wood, 0.004)
            )
        joined(f"Picture_{i}", *parts)


def rug():
    """Build a rug between sofa and table."""
    wool = material("wool", (0.62, 0.56, 0.47), 0.95, second=(0.3, 0.2, 0.16), scale=3.2, bump=0.004)
    box("Rug", (-0.4, 0.5, 0.008), (2.3, 1.6, 0.016), wool, 0.007)


def daylight():
    """Add a soft sky, and a low sun that shines through the window."""
    world = bpy.data.worlds.new("Day")
    bpy.context.scene.world = world
    world.use_nodes = True
    sky = world.node_tree.nodes["Background"]
    sky.inputs["Color"].default_value, sky.inputs["Strength"].default_value = (0.62, 0.78, 1.0, 1), 2.2
    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy, sun.angle, sun.color = 4.5, math.radians(1.5), (1.0, 0.9, 0.75)
    y0, y1, z0, z1 = WINDOW
    opening = bpy.data.lights.new("Window_Light", "AREA")
    opening.shape, opening.size, opening.size_y = "RECTANGLE", z1 - z0, y1 - y0
    opening.energy, opening.color = 60, (0.8, 0.9, 1.0)
    for lamp, at, turn in (
        (sun, (4, 2, 3), (math.radians(0), math.radians(58), math.radians(14))),
        (opening, (LENGTH / 2 + WALL + 0.05, (y0 + y1) / 2, (z0 + z1) / 2), (0, math.radians(90), 0)),
    ):
        made = bpy.data.objects.new(lamp.name, lamp)
        made.location, made.rotation_euler = at, turn
        bpy.context.scene.collection.objects.link(made)


def main(path):
    """Build the room into an empty file, and save it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    plaster = material("plaster", (0.78, 0.75, 0.7), 0.9, bump=0.001, scale=40)
    accent = material("accent", (0.2, 0.3, 0.3), 0.9, bump=0.001, scale=40)
    paint = material("white paint", (0.85, 0.85, 0.83), 0.5)
    grain = {"second": (0.12, 0.06, 0.03), "scale": 4, "stretch": (2, 16, 16)}
    walnut = material("walnut", (0.2, 0.11, 0.06), 0.4, **grain)
    metal = material("metal", (0.15, 0.15, 0.16), 0.35, 0.9)
    glazed = material("glazed", (0.75, 0.77, 0.72), 0.15)
    shell(plaster, accent, paint)
    sofa(material("cloth", (0.32, 0.34, 0.38), 0.95, bump=0.0015, scale=150), walnut)
    table(walnut, glazed, paint)
    bookshelf(walnut)
    desk(walnut, metal)
    plant(material("terracotta", (0.5, 0.22, 0.12), 0.8))
    lamps(metal)
    pictures(walnut)
    rug()
    daylight()
    bpy.context.scene.view_settings.view_transform = "AgX"
    bpy.ops.wm.save_as_mainfile(filepath=path, compress=True)


if __name__ == "__main__":
    main(sys.argv[-1])
