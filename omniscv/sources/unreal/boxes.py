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
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.commands import BOUNDS, VERTICES
from omniscv.sources.unreal.replies import Reply

_QUERIES = {"vertex_location": VERTICES, "bounds": BOUNDS}
_BATCH = 8  # objects that are queried together
MOST_VERTICES = 2_000_000
"""Of all objects, about 80 MB; of one object, five times as many are read."""
_MAX_CM = 1e9
_TIGHTER = 0.99
"""A box that is turned in the object's own frame replaces one along its axes if its volume is below this
share."""
_SAME_AREA = 1 + 1e-6
"""Boxes of one shape differ by so much as the object moves, because vertices are rounded."""


def boxes(
    connection: Connection, names: Sequence[str], most_vertices: int = MOST_VERTICES
) -> dict[str, ObjectBox]:
    """Return the boxes of objects by name; objects without a shape have none.

    Vertices give a box along the object's own axes, or along turned ones where it is tighter; bounds give one
    along the world's axes. Meshes may have millions of vertices: after ``most_vertices``, bounds are used for
    the remaining objects.

    Raises:
        BadReplyError: a reply that is neither numbers nor an error.
    """
    known = [what for what, template in _QUERIES.items() if connection.supports(template)]
    if not known:
        return {}
    known.append("rotation")
    result: dict[str, ObjectBox] = {}
    vertices = 0
    for start in range(0, len(names), _BATCH):
        batch = names[start : start + _BATCH]
        if vertices > most_vertices and "bounds" in known:
            known = ["bounds"]
        commands = [f"vget /object/{name}/{what}" for name in batch for what in known]
        answers = iter(connection.read(commands, _numbers))
        for name in batch:
            row = {what: next(answers) for what in known}
            points = row.get("vertex_location")
            vertices += 0 if points is None else len(points)
            bounds, rotation = row.get("bounds"), row.get("rotation")
            if points is not None:
                result[name] = _around(points, np.zeros(3) if rotation is None else rotation)
            elif bounds is not None and (box := upright_box(bounds)):
                result[name] = box
    return result


def upright_box(bounds_cm: Array) -> ObjectBox | None:
    """Return the box of bounds (2, 3) along the world's axes; None if all are 0, without a shape."""
    if not bounds_cm.any():
        return None
    low, high = np.sort(_to_world(bounds_cm), axis=0)
    return ObjectBox((low + high) / 2, np.eye(3), high - low, "bounds")


def _numbers(command: str, reply: Reply) -> Array | None:
    """Return the numbers of a reply: (N, 3) vertices, (2, 3) bounds or a rotation (3,); None for an error."""
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
    if len(values) % 3 or not (np.abs(values) <= _MAX_CM).all():  # False for NaN, too
        expected = f"expected three numbers of at most {_MAX_CM:g} for each vertex from {shown(command)}"
        raise BadReplyError(f"{expected}, got {shown(reply[:100])}")
    return values.reshape(-1, 3)


def _to_world(points_cm: Array) -> Array:
    """Return points (N, 3) in the world frame, metres."""
    return position_from_unreal(points_cm.T).T


def _around(vertices_cm: Array, rotator_deg: Array) -> ObjectBox:
    """Return the box of vertices along the axes of their object, or along turned ones if it is tighter."""
    points, own = _to_world(vertices_cm), rotation_from_unreal(rotator_deg).T
    aligned, turned = _box(points, own), _box(points, _upright_axes(points @ own.T) @ own)
    return turned if np.prod(turned.size) < _TIGHTER * np.prod(aligned.size) else aligned


def _box(points: Array, axes: Array) -> ObjectBox:
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    return ObjectBox.of((low + high) / 2 @ axes, axes, high - low, "vertices")


def _upright_axes(points: Array) -> Array:
    """Return the axes, as rows, of the smallest upright box around points (N, 3), turned by 45 degrees at
    most.

    One of its sides is parallel to a side of the convex hull seen from above (Freeman and Shapira 1975).
    """
    try:
        hull = points[ConvexHull(points[:, :2]).vertices, :2]
    except (QhullError, ValueError):  # fewer than three points, or all in an upright plane
        hull = points[:2, :2]
    x, y = (np.roll(hull, -1, axis=0) - hull).T
    angles = (np.arctan2(y, x) + np.pi / 4) % (np.pi / 2) - np.pi / 4
    across, along = (
        np.ptp(np.outer(hull[:, 0], np.cos(a)) + np.outer(hull[:, 1], np.sin(a)), axis=0)
        for a in (angles, angles + np.pi / 2)
    )
    areas = across * along
    smallest = angles[areas <= areas.min() * _SAME_AREA]
    a = smallest[np.abs(smallest).argmin()]
    return np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
