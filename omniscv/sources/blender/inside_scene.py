"""What is rendered of a scene in Blender: objects by name, instances as objects of their own.

It runs inside Blender's process, as ``inside.py`` says, which imports it.
"""

from typing import Any

import bpy  # type: ignore[import-not-found]
import numpy as np
from numpy.typing import NDArray

SHAPES = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME")
"""Types of objects that pictures show."""
MESHES = ("MESH", "CURVE", "SURFACE", "META", "FONT")
"""Those of them that have vertices."""


def select_scene(name: str | None) -> Any:
    """Return the scene of a name; the one that was shown last if there is no name."""
    if name is None:
        return bpy.context.scene
    if name not in bpy.data.scenes:
        raise RuntimeError(f"expected one of the scenes {', '.join(bpy.data.scenes.keys())}, got {name!r}")
    return bpy.data.scenes[name]


def show_as_rendered(layer: Any) -> None:
    """Make what is evaluated for boxes equal to what is rendered: the same objects, the same subdivision."""
    rendered = rendered_objects(layer.layer_collection)
    stack = [layer.layer_collection]
    while stack:
        item = stack.pop()
        stack += item.children
        item.hide_viewport = item.collection.hide_viewport = False
    for item in layer.objects:
        item.hide_viewport = item.hide_render = item not in rendered
    for item in bpy.data.objects:
        for modifier in item.modifiers:
            modifier.show_viewport = modifier.show_render
            if hasattr(modifier, "render_levels"):
                modifier.levels = modifier.render_levels
    bpy.context.view_layer.update()


def rendered_objects(top: Any) -> set[Any]:
    """Return the objects of a view layer that are rendered: where no collection around them is hidden."""
    rendered: set[Any] = set()
    if not top.exclude and not top.collection.hide_render:
        rendered.update(item for item in top.collection.objects if not item.hide_render)
    if not top.collection.hide_render:  # an object of an excluded collection may be in another one too
        for child in top.children:
            rendered |= rendered_objects(child)
    return rendered


def make_instances_real(scene: Any) -> None:
    """Replace instances of collections by objects, so that each has a pass index of its own."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    instances: list[tuple[Any, ...]] = []
    meshes: dict[Any, Any] = {}
    for item in depsgraph.object_instances:
        nested = item.object.type == "EMPTY"  # its own instances are in the list too
        if item.is_instance and item.parent.instance_type == "COLLECTION" and not nested:
            original = item.object.original
            instances.append((item.parent.original, original, item.matrix_world.copy()))
            shape_keys = getattr(item.object.data, "shape_keys", None)
            if item.object.type in MESHES and (item.object.modifiers or shape_keys is not None):
                meshes[original] = meshes.get(original) or bpy.data.meshes.new_from_object(
                    item.object, preserve_all_data_layers=True, depsgraph=depsgraph
                )
    for parent, original, matrix in instances:
        name = f"{parent.name}/{original.name}"
        scene.collection.objects.link(copy_object(original, name, matrix, meshes.get(original)))
    for parent, _, _ in instances:
        parent.instance_type = "NONE"


def copy_object(original: Any, name: str, matrix: Any, mesh: Any) -> Any:
    """Return a copy of an object that stands still.

    Args:
        original: the object.
        name: of the copy.
        matrix: its world matrix.
        mesh: its shape with the effect of the object's modifiers, which the copy then lacks; None for the
            object's own shape.
    """
    new = original.copy()
    new.name = name
    new.parent = None
    new.animation_data_clear()
    new.constraints.clear()
    if mesh:
        new.modifiers.clear()
        if new.type == "MESH":
            new.data = mesh
        else:  # curves and the like become meshes
            curve = new
            new = bpy.data.objects.new(new.name, mesh)
            bpy.data.objects.remove(curve)
    new.matrix_world = matrix
    return new


def named_objects(layer: Any) -> dict[str, Any]:
    """Return by name the objects that are rendered; with the library's name where two have one name."""
    objects: dict[str, Any] = {}
    for item in sorted(rendered_objects(layer.layer_collection), key=lambda item: item.name_full):
        if item.type in SHAPES:
            objects[item.name_full if item.name in objects else item.name] = item
    return objects


def vertices_of(instance: Any) -> NDArray[np.float64]:
    """Return the vertices (N, 3) of an evaluated object in the world, in units."""
    item = instance.object
    if item.type in MESHES:
        mesh = item.to_mesh()
        points = np.empty(3 * len(mesh.vertices) if mesh else 0, np.float32)
        if mesh:
            mesh.vertices.foreach_get("co", points)
        item.to_mesh_clear()
    else:
        points = np.array(item.bound_box, np.float32)
    matrix = np.array(instance.matrix_world)
    return np.asarray(points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
