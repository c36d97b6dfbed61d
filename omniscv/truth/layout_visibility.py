"""Which points of a room's edges an image shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import number, shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.truth.room_surfaces import first_hits

Flags = NDArray[np.bool_]

_ROUNDING = 1e-9  # of a distance
_OFF_GRID = 1e-6  # a weight that decides only where none of the nearer pixels is in the image


@dataclass(frozen=True)
class Tolerance:
    """How far a surface may be off the room's own, along a ray, and still be taken for it.

    Attributes:
        abs_m: metres.
        rel: of the distance; the larger of both counts.

    Raises:
        ArgumentError: a negative number.
    """

    abs_m: float = 0.02
    rel: float = 0.01

    def __post_init__(self) -> None:
        number("tolerance.abs_m", self.abs_m, least=0)
        number("tolerance.rel", self.rel, least=0)


def seen_in_room(room: Room, pose: Pose, points_c: Array, origins_c: Array) -> Flags:
    """(S,) whether points on a room's edges are seen past its own walls.

    Args:
        room, pose: the room, and the camera's pose.
        points_c: (S, 3) metres, camera frame.
        origins_c: (S, 3) metres, camera frame, from where each is seen.
    """
    offset = points_c - origins_c
    distance = np.linalg.norm(offset, axis=-1)
    hits = first_hits(room, pose.to_world(origins_c), (offset / distance[:, None]) @ pose.R_w_c.T)
    return np.asarray(hits.distance >= distance * (1 - _ROUNDING) - _ROUNDING)


def seen_in_depth(
    room: Room, camera: Camera, pose: Pose, pixels: Array, depth: ArrayLike, tolerance: Tolerance
) -> Flags:
    """(S,) whether nothing stands before a room's surfaces where an image has pixels.

    Each pixel around a point is judged along its own ray, from its own origin: its depth is that of the
    room's surface there, or of something else. Of the 3 x 3 pixels, weighted by their distance, the larger
    share decides. So a silhouette is found to a part of a pixel, and a surface that the rays graze is no
    obstacle.

    Args:
        room, camera, pose: the room, and what sees it.
        pixels: (S, 2) px.
        depth: (H, W) metres along each pixel's ray; 0 outside the image.
        tolerance: see :class:`Tolerance`.

    Raises:
        ArgumentError: a depth of another size than the image.
    """
    image = np.asarray(depth)
    if image.shape != (camera.height, camera.width):
        wanted = f"({camera.height}, {camera.width}), the image's"
        raise ArgumentError(f"depth: expected the shape {wanted}, got {shown(image.shape)}")
    column, row = _neighbours(pixels, camera)
    weight = _weights(pixels, column, row)
    flat, of = np.unique(row * camera.width + column, return_inverse=True)
    centers = np.column_stack([flat % camera.width, flat // camera.width]) + 0.5
    rays = camera.unproject(centers)
    hits = first_hits(room, pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)
    found = image.reshape(-1)[flat].astype(np.float64)
    with np.errstate(invalid="ignore"):
        allowed = np.maximum(tolerance.abs_m, tolerance.rel * hits.distance)
        is_room = np.abs(found - hits.distance) <= allowed
    weight *= (rays.valid & (found > 0))[of].reshape(weight.shape)
    share = (weight * is_room[of].reshape(weight.shape)).sum(axis=1)
    return np.asarray((2 * share >= weight.sum(axis=1)) & (share > 0))


def _neighbours(pixels: Array, camera: Camera) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(S, 9) columns and rows of the 3 x 3 pixels around points; those of the border twice."""
    shift = np.arange(9)
    column = np.floor(pixels[:, :1]).astype(np.intp) + shift % 3 - 1
    row = np.floor(pixels[:, 1:]).astype(np.intp) + shift // 3 - 1
    return np.clip(column, 0, camera.width - 1), np.clip(row, 0, camera.height - 1)


def _weights(pixels: Array, column: NDArray[np.intp], row: NDArray[np.intp]) -> Array:
    """(S, 9) of the 3 x 3 pixels: a quadratic B-spline, and a little more for points outside the grid."""
    across, down = np.abs(pixels[:, :1] - column - 0.5), np.abs(pixels[:, 1:] - row - 0.5)
    return _spline(across) * _spline(down) + _OFF_GRID


def _spline(x: Array) -> Array:
    return np.where(x <= 0.5, 0.75 - x**2, 0.5 * np.maximum(1.5 - x, 0) ** 2)
