"""The straight edges of a scene, and where the exact labels of an image show them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from omniscv.cameras import Camera
from omniscv.evaluate.lines import plucker
from omniscv.evaluate.lines.boundaries import Labels, boundary, outline
from omniscv.evaluate.lines.refinement import ObservedLine
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import BOX_EDGES, Room, SceneGeometry

_LEAST_POINTS = 40
_SAMPLES = 400
_NEAR_PX = 1.0  # an outline so near to a box's edge is the edge's
_APART_PX = 4.0  # where another edge of the box is nearer than that, neither is known
_LEAST_SHARE = 0.5  # of a box's edge, for it to be one of the object: many objects do not fill their box
_LEVEL = 1e-6


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge of a room or of an object's box.

    Attributes:
        kind: ``vertical``, ``horizontal`` or ``oblique``.
        of: ``room`` or ``object``.
        name: of the two surfaces that meet there, or of the object and the edge.
        ends_w: (2, 3) metres, world frame.
    """

    kind: Literal["vertical", "horizontal", "oblique"]
    of: Literal["room", "object"]
    name: str
    ends_w: Array

    def line_c(self, pose: Pose) -> Array:
        """Return the line (6,), camera frame."""
        start, end = pose.to_camera(self.ends_w)
        return plucker.through(start, end - start)

    def points_c(self, pose: Pose, count: int) -> Array:
        """Return (count, 3) points along the edge, camera frame, metres."""
        start, end = pose.to_camera(self.ends_w)
        return np.asarray(start + np.linspace(0, 1, count)[:, None] * (end - start))


Seen = list[tuple[Edge, ObservedLine]]


def room_edges(room: Room) -> Iterator[tuple[Edge, tuple[str, str]]]:
    """Yield where walls meet each other, the floor and the ceiling, and the names of the two."""
    count = len(room.corners_w)
    low, high = (np.column_stack([room.corners_w, np.full(count, z)]) for z in (room.floor_z, room.ceiling_z))
    for i, wall in enumerate(room.walls):
        after = (i + 1) % count
        for names, start, end in (
            ((room.walls[i - 1], wall), low[i], high[i]),
            ((wall, room.floor), low[i], low[after]),
            ((wall, room.ceiling), high[i], high[after]),
        ):
            yield _edge("room", " | ".join(names), np.array([start, end])), names


def seen_edges(
    geometry: SceneGeometry, camera: Camera, pose: Pose, labels: Labels, names: Sequence[str]
) -> Seen:
    """Return the edges that an image shows, and the pixels where it does.

    Args:
        geometry: of the scene, with a room.
        camera, pose: of the image.
        labels: (H, W) the image's.
        names: of the labels from 1 on.
    """
    label = {name: 1 + i for i, name in enumerate(names)}
    found: Seen = []
    if geometry.room is not None:
        for edge, (one, other) in room_edges(geometry.room):
            pixels = boundary(labels, label.get(one, 0), label.get(other, 0))
            if one in label and other in label and len(pixels) >= _LEAST_POINTS:
                found.append((edge, ObservedLine(camera, pixels)))
    surfaces = geometry.room.surfaces if geometry.room is not None else ()
    for name in sorted(set(geometry.boxes) & set(label) - set(surfaces)):
        corners = geometry.boxes[name].corners_w()
        edges = [_edge("object", f"{name} {i}", corners[pair]) for i, pair in enumerate(BOX_EDGES)]
        found += _seen_of_box(edges, camera, pose, outline(labels, label[name]))
    return found


def _seen_of_box(edges: Sequence[Edge], camera: Camera, pose: Pose, pixels: Array) -> Seen:
    """What an object's outline (N, 2) px shows of its box's edges: where it follows one, and no other."""
    curves = [camera.project(edge.points_c(pose, _SAMPLES)) for edge in edges]
    if not all(valid.any() for _, valid in curves) or not len(pixels):
        return []
    away = np.array([cKDTree(curve[valid]).query(pixels)[0] for curve, valid in curves])
    order = np.sort(away, axis=0)
    clear = (order[0] <= _NEAR_PX) & (order[1] >= _APART_PX)
    found: Seen = []
    for i, (edge, (curve, valid)) in enumerate(zip(edges, curves, strict=True)):
        mine = pixels[clear & (away.argmin(axis=0) == i)]
        if len(mine) >= _LEAST_POINTS:
            shown = np.asarray(cKDTree(mine).query(curve[valid])[0])
            if (shown <= 2 * _NEAR_PX).mean() >= _LEAST_SHARE:
                found.append((edge, ObservedLine(camera, mine)))
    return found


def _edge(of: Literal["room", "object"], name: str, ends_w: Array) -> Edge:
    rise, run = abs(ends_w[1, 2] - ends_w[0, 2]), np.linalg.norm(ends_w[1, :2] - ends_w[0, :2])
    upright: Literal["vertical", "oblique"] = "vertical" if run <= _LEVEL else "oblique"
    return Edge("horizontal" if rise <= _LEVEL else upright, of, name, ends_w)
