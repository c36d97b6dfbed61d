"""The boxes of objects, from their vertices or bounds, where the plugin has these commands."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from omniscv.arguments import shown
from omniscv.errors import BadReplyError
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.geometry.unreal_frame import position_from_unreal, rotation_from_unreal
from omniscv.sources.unreal import replies
from omniscv.sources.unreal.client import Reply
from omniscv.sources.unreal.connection import Connection

_QUERIES = ("vertex_location", "bounds", "rotation")
_BATCH = 8  # objects that are asked for together
MOST_VERTICES = 2_000_000
"""Of all objects, about 80 MB; and of one, five times as many are read."""
_MAX_CM = 1e9
_TIGHTER = 0.99
"""Of the volume in the object's own frame: a box in another frame is worth it if it is below."""


def boxes(
    connection: Connection, names: Sequence[str], most_vertices: int = MOST_VERTICES
) -> dict[str, ObjectBox]:
    """Return the boxes of objects by name; objects without a shape have none.

    The plugin is probed with the first object. Vertices give a box in the object's own frame, or an upright
    one that is tighter; bounds give one along the world's axes. Once more than ``most_vertices`` have come,
    bounds serve for the other objects: meshes may have millions.

    Raises:
        BadReplyError: a reply that is neither numbers nor an error.
    """
    known = [what for what in _QUERIES if names and _knows(connection, names[0], what)]
    if not {"vertex_location", "bounds"} & set(known):
        return {}
    found: dict[str, ObjectBox] = {}
    vertices = 0
    for start in range(0, len(names), _BATCH):
        some = names[start : start + _BATCH]
        if vertices > most_vertices and "bounds" in known:
            known = ["bounds"]
        replies = iter(
            connection.read([f"vget /object/{n}/{what}" for n in some for what in known], _numbers)
        )
        for name in some:
            told = {what: next(replies) for what in known}
            points = told.get("vertex_location")
            vertices += 0 if points is None else len(points)
            if box := _box_of(points, told.get("bounds"), told.get("rotation")):
                found[name] = box
    return found


def _box_of(vertices: Array | None, bounds: Array | None, rotation: Array | None) -> ObjectBox | None:
    if vertices is not None:
        return _around(vertices, np.zeros(3) if rotation is None else rotation)
    return None if bounds is None else upright_box(bounds)


def upright_box(bounds_cm: Array) -> ObjectBox | None:
    """Return the box of bounds (2, 3) along the world's axes; None for empty ones, as of no shape."""
    if not bounds_cm.any():
        return None
    low, high = np.sort(_to_world(bounds_cm), axis=0)
    return ObjectBox((low + high) / 2, np.eye(3), high - low, "bounds")


def _knows(connection: Connection, name: str, what: str) -> bool:
    """Whether a server has a command; it may still refuse it for some objects."""
    (reply,) = connection.texts([f"vget /object/{name}/{what}"])
    return not reply.startswith(("error Can not find a handler", "error No handler found"))


def _numbers(command: str, reply: Reply) -> Array | None:
    """Return the numbers of a reply: (N, 3) vertices, (2, 3) bounds or a rotation (3,); None for none."""
    if isinstance(reply, str) and (reply == "ok" or reply.startswith("error")):
        return None
    if command.endswith("/vertex_location"):
        return _vertices(command, reply)
    count = 6 if command.endswith("/bounds") else 3
    values = np.array(replies.numbers(reply, count))
    return values.reshape(2, 3) if count == 6 else values


def _vertices(command: str, reply: Reply) -> Array:
    words = reply.split(maxsplit=15 * MOST_VERTICES)
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        values = np.array([math.nan])
    if len(values) % 3 or not (np.abs(values) <= _MAX_CM).all():  # NaN is not
        expected = f"expected three numbers of at most {_MAX_CM:g} for each vertex from {shown(command)}"
        raise BadReplyError(f"{expected}, got {shown(reply[:100])}")
    return values.reshape(-1, 3)


def _to_world(points_cm: Array) -> Array:
    """(N, 3) metres in the world."""
    return position_from_unreal(points_cm.T).T


def _around(vertices_cm: Array, rotator_deg: Array) -> ObjectBox:
    """Return the box of vertices in the frame of their object, or an upright one that is tighter."""
    points = _to_world(vertices_cm)
    own, upright = _box(points, rotation_from_unreal(rotator_deg).T), _box(points, _upright_axes(points))
    return upright if np.prod(upright.size) < _TIGHTER * np.prod(own.size) else own


def _box(points: Array, axes: Array) -> ObjectBox:
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    return ObjectBox.of((low + high) / 2 @ axes, axes, high - low, "vertices")


def _upright_axes(points: Array) -> Array:
    """Return the axes, as rows, of the smallest upright box around points (N, 3).

    It has a side along one of the hull's, seen from above (Freeman and Shapira 1975).
    """
    try:
        hull = points[ConvexHull(points[:, :2]).vertices, :2]
    except (QhullError, ValueError):  # fewer than three points, or all in an upright plane
        hull = points[:2, :2]
    x, y = (np.roll(hull, -1, axis=0) - hull).T
    angles = np.arctan2(y, x)
    across, along = (
        np.ptp(np.outer(hull[:, 0], np.cos(a)) + np.outer(hull[:, 1], np.sin(a)), axis=0)
        for a in (angles, angles + np.pi / 2)
    )
    a = angles[(across * along).argmin()]
    return np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
