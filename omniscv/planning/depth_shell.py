"""The depth that was captured from one optical centre, looked up in any direction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry import Array, cube_rotations
from omniscv.geometry.surfaces import Precision, discontinuities, surface_point
from omniscv.sources import codecs
from omniscv.sources.base import Capture

_SAME_FACE = 0.01
"""Entries of rotation matrices of a face that a source could not turn exactly differ by less."""


class DepthShell(NamedTuple):
    """The depth captured from a centre.

    Attributes:
        center_w: (3,) metres.
        depth: (V, h, w) float32 planar metres; +inf for the sky.
        nearest: (V, h, w) float32 of the nearest surface that shows within a pixel, where that is another one
            than the pixel's own; else the pixel's own.
        slot: (6,) int64, which of V each face of the world-aligned cube is; -1 for none.
        R_c_w: (6, 3, 3) world to each face.
        focal, half_width, half_height: px.
        least, most: of the finite distances.
        precision: of the depth.
    """

    center_w: Array
    depth: NDArray[np.float32]
    nearest: NDArray[np.float32]
    slot: NDArray[np.int64]
    R_c_w: Array
    focal: float
    half_width: float
    half_height: float
    least: float
    most: float
    precision: Precision


def depth_shell(center_w: Array, captures: Sequence[Capture]) -> DepthShell:
    """Return the shell of planar depths captured with the faces of a world-aligned cube.

    Args:
        center_w: (3,) the views' common centre.
        captures: depth, all of one size. Views that are no face of the cube are passed over.
    """
    view = captures[0].view
    R_c_w = np.array([R_w_c.T for _, R_w_c in cube_rotations()])
    slot = np.full(6, -1, np.int64)
    for i, capture in enumerate(captures):
        own = capture.view.pose.R_w_c.T
        off = np.abs(R_c_w - own).max(axis=(1, 2))
        if off.min() < _SAME_FACE:
            slot[off.argmin()], R_c_w[off.argmin()] = i, own
    depth, nearest = zip(
        *((capture.pixels, _nearest_around(capture.pixels)) for capture in captures), strict=True
    )
    least = min(float(face.min()) for face in depth)
    finite = [face[np.isfinite(face)] for face in depth]
    most = max((float(face.max()) for face in finite if face.size), default=0.0)
    corner = float(np.sqrt(1 + (view.width**2 + view.height**2) / (2 * view.focal_px) ** 2))
    precision = codecs.precision(captures[0].encoding)
    return DepthShell(
        center_w, np.stack(depth), np.stack(nearest), slot, R_c_w,
        view.focal_px, view.width / 2, view.height / 2, least, most * corner, precision,
    )  # fmt: skip


def _nearest_around(face: NDArray[np.float32]) -> NDArray[np.float32]:
    least = cv2.erode(face, np.ones((3, 3), np.uint8))
    beside = cv2.erode(discontinuities(face), np.ones((3, 3), np.uint8)) == 0
    return np.where(beside, least, face)


def distances(shell: DepthShell, directions_w: Array) -> Array:
    """Return (N,) captured distance in directions (N, 3) of any length, nearest pixel; 0 outside views, and
    for a direction of length 0."""
    out = np.zeros(len(directions_w))
    _distances(shell, directions_w, out)
    return out


@njit(cache=True, nogil=True)
def _distances(shell: Any, directions: Any, out: Any) -> None:
    for i in range(directions.shape[0]):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0:
            k, u, v, along = look_up(shell, x, y, z)
            out[i] = nearest_pixel(shell.depth[k], u, v) / along * length if k >= 0 else 0.0


@njit(cache=True, nogil=True)
def face_of(toward: Any) -> int:
    """Return which face of the world-aligned cube a direction hits."""
    x, y, z = toward
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        return 0 if x > 0 else 2
    if abs(y) >= abs(z):
        return 3 if y > 0 else 1
    return 4 if z > 0 else 5


@njit(cache=True, nogil=True)
def look_up(shell: Any, x: float, y: float, z: float) -> tuple[int, float, float, float]:
    """Return the view that a direction is in, the pixel there, and the part of the direction along its axis.

    -1 if that face was not captured.
    """
    face = face_of((x, y, z))
    if shell.slot[face] < 0:
        return -1, 0.0, 0.0, 1.0
    R = shell.R_c_w[face]
    depth = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
    u = shell.focal * (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z) / depth + shell.half_width
    v = shell.focal * (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z) / depth + shell.half_height
    return shell.slot[face], u, v, depth


@njit(cache=True, nogil=True)
def nearest_pixel(face: Any, u: float, v: float) -> float:
    """Return the value of the pixel at (u, v), or of the nearest one at the border."""
    c = min(max(int(np.floor(u)), 0), face.shape[1] - 1)
    r = min(max(int(np.floor(v)), 0), face.shape[0] - 1)
    return float(face[r, c])


@njit(cache=True, nogil=True)
def between_pixels(shell: Any, k: int, u: float, v: float) -> float:
    """Return planar depth between pixels; +inf where there is no surface."""
    point = surface_point(shell.depth[k], u, v, shell.focal, shell.precision)
    return 1.0 / point.inverse if point.inverse > 0.0 else np.inf
