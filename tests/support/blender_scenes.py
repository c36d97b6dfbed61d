"""Runs inside Blender: ``PYTHON blender_scenes.py NAME OUT.blend`` makes a small scene for a test."""

import math
import sys

import bpy


def cube(name, location, collection=None, size=2.0):
    bpy.ops.mesh.primitive_cube_add(size=size, location=location)
    new = bpy.context.object
    new.name = name
    if collection is not None:
        for each in list(new.users_collection):
            each.objects.unlink(new)
        collection.objects.link(new)
    return new


def put(name, collection, location, turn_deg=0.0):
    """An instance of a collection."""
    new = bpy.data.objects.new(name, None)
    new.instance_type = "COLLECTION"
    new.instance_collection = collection
    new.location = location
    new.rotation_euler = (0, 0, math.radians(turn_deg))
    bpy.context.scene.collection.objects.link(new)
    return new


def sets(out):
    """Cubes around the origin at 5 m: two instances of a set, in another set, that is itself nowhere."""
    chairs = bpy.data.collections.new("Chairs")
    seat = cube("Seat", (0, 0, 0), chairs)
    seat.scale = (0.5, 0.5, 0.5)
    outer = bpy.data.collections.new("Outer")
    inner = bpy.data.objects.new("Inner", None)
    inner.instance_type = "COLLECTION"
    inner.instance_collection = chairs
    inner.location = (1, 0, 0)
    outer.objects.link(inner)
    put("East", outer, (4, 0, 0))
    put("West", outer, (-4, 0, 0), turn_deg=180)
    cube("North", (0, 5, 0))
    unseen = cube("Unseen", (0, -3, 0))
    unseen.hide_render = True
    only_rendered = cube("South", (0, -5, 0))
    only_rendered.hide_viewport = True
    hidden = bpy.data.collections.new("Hidden")
    hidden.hide_render = True
    bpy.context.scene.collection.children.link(hidden)
    cube("InHidden", (0, 3, 0), hidden)
    left_out = bpy.data.collections.new("LeftOut")
    bpy.context.scene.collection.children.link(left_out)
    cube("InLeftOut", (0, 2, 0), left_out)
    bpy.context.view_layer.layer_collection.children["LeftOut"].exclude = True


def linking(out):
    """A chair of another file, linked as it is, beside an own object of that name."""
    library = out.replace(".blend", "-library.blend")
    cube("Chair", (5, 0, 0))
    bpy.ops.wm.save_as_mainfile(filepath=library)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    cube("Chair", (-5, 0, 0))
    with bpy.data.libraries.load(library, link=True) as (_, wanted):
        wanted.objects = ["Chair"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])


def centimetres(out):
    """A cube whose face is 4 m ahead, in a file of centimetres."""
    bpy.context.scene.unit_settings.scale_length = 0.01
    cube("Cube", (500, 0, 0), size=200)


def lit(out):
    """A lamp over a floor, drawn with the view transform Standard; a depth of field, a border, two eyes."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=20)
    bpy.context.object.name = "Floor"
    bpy.ops.object.light_add(type="AREA", location=(2, 0, 3))
    bpy.context.object.data.energy = 200
    scene.world = bpy.data.worlds.new("World")
    scene.view_settings.view_transform = "Standard"
    render = scene.render
    render.use_border = True
    render.border_max_x = 0.5
    render.resolution_percentage = 50
    render.use_multiview = True
    render.pixel_aspect_x = 2.0
    render.film_transparent = False
    scene.cycles.samples = 4096


def varied(out):
    """A box turned by 30 degrees in a box without a lid, of one material, a lamp above, and a grey world."""
    scene = bpy.context.scene
    paint = bpy.data.materials.new("Paint")
    paint.use_nodes = True
    for name, location, size in (("Crate", (3, 0, 0), 1.0), ("Hall", (0, 0, 0), 20.0)):
        cube(name, location, size=size).data.materials.append(paint)
    bpy.data.objects["Crate"].rotation_euler = (0, 0, math.radians(30))
    bpy.ops.object.light_add(type="POINT", location=(0, 0, 2))
    bpy.context.object.name = "Lamp"
    bpy.context.object.data.energy = 100
    scene.world = bpy.data.worlds.new("World")
    scene.view_settings.view_transform = "Standard"


def main():
    name, out = sys.argv[-2:]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    {each.__name__: each for each in (sets, linking, centimetres, lit, varied)}[name](out)
    bpy.ops.wm.save_as_mainfile(filepath=out)


main()
