"""The straight edges of a scene, and the pixels where the exact labels of an image show them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from omniscv.cameras import Camera
from omniscv.evaluate.lines.reconstruction import ObservedLine, through
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import BOX_EDGES, ObjectBox, Room

_LEAST_POINTS = 40
_SAMPLES = 400
_NEAR_PX = 1.0  # distance within which an outline follows a box's edge
_APART_PX = 4.0  # from the box's other edges; nearer points are ambiguous
_LEAST_SHARE = 0.5  # of a box's edge that the outline follows: many objects do not fill their box
_LEVEL = 1e-6

Labels = NDArray[np.uint16]
Owner = Literal["room", "object"]
Kind = Literal["vertical", "horizontal", "oblique"]


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge of a room or of an object's box.

    Attributes:
        kind: ``vertical``, ``horizontal`` or ``oblique``.
        of: ``room`` or ``object``.
        name: of the two surfaces that meet there, or of the object and the edge.
        ends_w: (2, 3) metres, world frame.
    """

    kind: Kind
    of: Owner
    name: str
    ends_w: Array

    def line_c(self, pose: Pose) -> Array:
        """Return the line (6,), camera frame."""
        start, end = pose.to_camera(self.ends_w)
        return through(start, end - start)

    def points_c(self, pose: Pose, count: int) -> Array:
        """Return (count, 3) points along the edge, camera frame, metres."""
        start, end = pose.to_camera(self.ends_w)
        return np.linspace(start, end, count)


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
    room: Room,
    boxes: Mapping[str, ObjectBox],
    camera: Camera,
    pose: Pose,
    labels: Labels,
    names: Sequence[str],
) -> Seen:
    """Return the edges that an image shows, and the pixels where it does.

    Args:
        room: of the scene.
        boxes: of its objects, by name.
        camera, pose: of the image.
        labels: (H, W) of the image.
        names: of the labels from 1 on.
    """
    label = {name: i for i, name in enumerate(names, start=1)}
    edges_seen: Seen = []
    for edge, (a, b) in room_edges(room):
        if a in label and b in label and len(pixels := boundary(labels, label[a], label[b])) >= _LEAST_POINTS:
            edges_seen.append((edge, ObservedLine(camera, pixels)))
    for name in sorted(set(boxes) & set(label) - set(room.surfaces)):
        corners = boxes[name].corners_w()
        edges = [_edge("object", f"{name} {i}", corners[pair]) for i, pair in enumerate(BOX_EDGES)]
        edges_seen += _seen_of_box(edges, camera, pose, boundary(labels, label[name]))
    return edges_seen


def boundary(labels: Labels, a: int, b: int | None = None) -> Array:
    """Return (N, 2) px the midpoints of neighbouring pixels, one with label ``a``, the other with ``b``.

    Without ``b``: with any other label, which gives the outline of ``a``.
    """
    is_a = labels == a
    is_b = ~is_a if b is None else labels == b
    beside = is_a[:, :-1] & is_b[:, 1:] | is_b[:, :-1] & is_a[:, 1:]
    below = is_a[:-1] & is_b[1:] | is_b[:-1] & is_a[1:]
    points = np.argwhere(beside) + np.array([0.5, 1.0]), np.argwhere(below) + np.array([1.0, 0.5])
    return np.concatenate(points)[:, ::-1]


def _seen_of_box(edges: Sequence[Edge], camera: Camera, pose: Pose, pixels: Array) -> Seen:
    """Return the edges of a box that an object's outline (N, 2) px follows, with their pixels."""
    curves = [camera.project(edge.points_c(pose, _SAMPLES)) for edge in edges]
    if not all(valid.any() for _, valid in curves) or not len(pixels):
        return []
    away = np.array([cKDTree(curve[valid]).query(pixels)[0] for curve, valid in curves])
    nearest, second = np.sort(away, axis=0)[:2]
    clear = (nearest <= _NEAR_PX) & (second >= _APART_PX)
    edges_seen: Seen = []
    for i, (edge, (curve, valid)) in enumerate(zip(edges, curves, strict=True)):
        own = pixels[clear & (away.argmin(axis=0) == i)]
        if len(own) >= _LEAST_POINTS:
            gaps = np.asarray(cKDTree(own).query(curve[valid])[0])
            if (gaps <= 2 * _NEAR_PX).mean() >= _LEAST_SHARE:
                edges_seen.append((edge, ObservedLine(camera, own)))
    return edges_seen


def _edge(of: Owner, name: str, ends_w: Array) -> Edge:
    rise, run = abs(ends_w[1, 2] - ends_w[0, 2]), np.linalg.norm(ends_w[1, :2] - ends_w[0, :2])
    kind: Kind = "horizontal" if rise <= _LEVEL else "vertical" if run <= _LEVEL else "oblique"
    return Edge(kind, of, name, ends_w)
