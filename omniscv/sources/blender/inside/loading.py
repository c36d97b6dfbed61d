"""What is rendered of a scene: objects by name, instances as objects of their own. Runs inside Blender."""

from typing import Any

import bpy  # type: ignore[import-not-found]

SHAPES = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME")
"""Types of objects that pictures show."""
MESHES = ("MESH", "CURVE", "SURFACE", "META", "FONT")
"""Those of them that have vertices."""


def chosen_scene(name: str | None) -> Any:
    """Return the scene of a name; the one that was shown last if there is no name."""
    if name is None:
        return bpy.context.scene
    if name not in bpy.data.scenes:
        raise RuntimeError(f"expected one of the scenes {', '.join(bpy.data.scenes.keys())}, got {name!r}")
    return bpy.data.scenes[name]


def show_as_rendered(layer: Any) -> None:
    """Make what is evaluated for boxes equal to what is rendered: the same objects, the same subdivision."""
    shown = rendered_objects(layer.layer_collection)
    stack = [layer.layer_collection]
    while stack:
        each = stack.pop()
        stack += each.children
        each.hide_viewport = each.collection.hide_viewport = False
    for each in layer.objects:
        each.hide_viewport = each not in shown
        each.hide_render = each not in shown
    for each in bpy.data.objects:
        for modifier in each.modifiers:
            modifier.show_viewport = modifier.show_render
            if hasattr(modifier, "render_levels"):
                modifier.levels = modifier.render_levels
    bpy.context.view_layer.update()


def rendered_objects(top: Any) -> set[Any]:
    """Return the objects of a view layer that are rendered: where no collection around them is hidden."""
    found: set[Any] = set()
    if not top.exclude and not top.collection.hide_render:
        found.update(each for each in top.collection.objects if not each.hide_render)
    if not top.collection.hide_render:  # what is in an excluded collection may be in another one too
        for each in top.children:
            found |= rendered_objects(each)
    return found


def make_instances_real(scene: Any) -> None:
    """Put objects in place of the instances of collections, so that each has a pass index of its own."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    made: list[tuple[Any, ...]] = []
    meshes: dict[Any, Any] = {}
    for each in depsgraph.object_instances:
        nested = each.object.type == "EMPTY"  # what it would put is in the list too
        if each.is_instance and each.parent.instance_type == "COLLECTION" and not nested:
            made.append((each.parent.original, each.object.original, each.matrix_world.copy()))
            if each.object.type in MESHES and (each.object.modifiers or has_shape_keys(each.object)):
                key = each.object.original
                meshes[key] = meshes.get(key) or bpy.data.meshes.new_from_object(
                    each.object, preserve_all_data_layers=True, depsgraph=depsgraph
                )
    for parent, original, matrix in made:
        scene.collection.objects.link(copied(original, f"{parent.name}/{original.name}", matrix, meshes))
    for parent in {parent for parent, _, _ in made}:
        parent.instance_type = "NONE"


def copied(original: Any, name: str, matrix: Any, meshes: dict[Any, Any]) -> Any:
    """Return an object that stands still at a place, without what could move or change it."""
    new = original.copy()
    new.name = name
    new.parent = None
    new.animation_data_clear()
    new.constraints.clear()
    if original in meshes:
        new.modifiers.clear()
        new = as_mesh(new, meshes[original])
    new.matrix_world = matrix
    return new


def as_mesh(new: Any, mesh: Any) -> Any:
    """Return an object with other data; curves and the like become meshes."""
    if new.type == "MESH":
        new.data = mesh
        return new
    plain = bpy.data.objects.new(new.name, mesh)
    bpy.data.objects.remove(new)
    return plain


def has_shape_keys(each: Any) -> bool:
    return getattr(each.data, "shape_keys", None) is not None


def named_objects(layer: Any) -> dict[str, Any]:
    """Return by name the objects that are rendered; with the library's name where two have one name."""
    found: dict[str, Any] = {}
    for each in sorted(rendered_objects(layer.layer_collection), key=lambda each: each.name_full):
        if each.type in SHAPES:
            found[each.name_full if each.name in found else each.name] = each
    return found
