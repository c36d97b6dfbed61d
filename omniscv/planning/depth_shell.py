"""Depth that was captured from one centre: which view a direction is in, and what is there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.geometry import Array, cube_rotations
from omniscv.geometry.arrays import Floats, Ints, stacked
from omniscv.geometry.surfaces import Precision, discontinuities, nearest_pixel, surface_point
from omniscv.sources import codecs
from omniscv.sources.base import Capture

_SAME_FACE = 0.01
"""Largest difference of rotation matrices of a face and of the view that a source captured for it."""


class DepthShell(NamedTuple):
    """The depth captured from one centre.

    Attributes:
        center_w: (3,) metres.
        depth: (V, h, w) float32 planar metres; +inf for the sky.
        nearest: (V, h, w) float32, depth of the nearest surface within a pixel, where that is another surface
            than the pixel's own; else the pixel's own depth.
        slot: (6,) int64, index of each face of a world-aligned cube in ``depth``; -1 if it was not captured.
        cube: whether only the faces of the cube are looked up; else any view that holds a direction.
        R_c_w: (V, 3, 3) world to each view.
        focal, half_width, half_height: px.
        least, most: of the finite distances, metres.
        precision: of the depth.
    """

    center_w: Array
    depth: Floats
    nearest: Floats
    slot: Ints
    cube: bool
    R_c_w: Array
    focal: float
    half_width: float
    half_height: float
    least: float
    most: float
    precision: Precision


def depth_shell(center_w: Array, captures: Sequence[Capture], cube: bool = True) -> DepthShell:
    """Return the shell of planar depths captured from a centre.

    Args:
        center_w: (3,) the views' common centre.
        captures: depth, all of one size and focal length.
        cube: whether they are the faces of a world-aligned cube, which together see all that is near; other
            views are then passed over. False: views of any orientation.
    """
    view = captures[0].view
    R_c_w = np.array([capture.view.pose.R_w_c.T for capture in captures])
    slot = np.full(6, -1, np.int64)
    for face, (_, R_w_f) in enumerate(cube_rotations()):
        off = np.abs(R_c_w - R_w_f.T).max(axis=(1, 2))
        if off.min() < _SAME_FACE:
            slot[face] = off.argmin()
    # Faces of a turned cube, or turned by quarters, are views of other orientations; those that a server
    # captures in addition to a face have its axis.
    axes_w, matched = R_c_w[:, 2], R_c_w[slot[slot >= 0], 2]
    cube = cube and len(matched) > 0 and bool(((axes_w @ matched.T).max(axis=1) > 1 - _SAME_FACE).all())
    depth = stacked([capture.pixels for capture in captures])
    finite = [face[np.isfinite(face)] for face in depth]
    most = max((float(face.max()) for face in finite if face.size), default=0.0)
    corner = float(np.sqrt(1 + (view.width**2 + view.height**2) / (2 * view.focal_px) ** 2))
    return DepthShell(
        stacked(center_w),
        depth,
        stacked([_nearest_around(face) for face in depth]),
        slot,
        cube,
        R_c_w,
        view.focal_px,
        view.width / 2,
        view.height / 2,
        least=min(float(face.min()) for face in depth),
        most=most * corner,
        precision=codecs.precision(captures[0].encoding),
    )


def _nearest_around(face: Floats) -> Floats:
    least = cv2.erode(face, np.ones((3, 3), np.uint8))
    beside = cv2.erode(discontinuities(face), np.ones((3, 3), np.uint8)) == 0
    return np.where(beside, least, face)


def distances(shell: DepthShell, directions_w: Array) -> tuple[Array, Array]:
    """Return (N,) the least and the greatest distances at which a direction may meet a surface, metres.

    0 and +inf in directions that were not captured, and for a direction of length 0.

    Args:
        shell: captured depth.
        directions_w: (N, 3), of any length.
    """
    least, most = np.zeros(len(directions_w)), np.full(len(directions_w), np.inf)
    _distances(shell, directions_w, least, most)
    return least, most


@njit(cache=True, nogil=True)
def _distances(shell: Any, directions: Any, least: Any, most: Any) -> None:
    for i in range(directions.shape[0]):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        length = np.sqrt(x * x + y * y + z * z)
        k, u, v, along = look_up(shell, (x, y, z)) if length > 0 else (-1, 0.0, 0.0, 1.0)
        if k < 0:
            continue
        point = surface_point(shell.depth[k], u, v, shell.focal, shell.precision)
        far = near = 1.0 / point.inverse if point.inverse > 0.0 else np.inf
        if point.inverse > 0.0:
            off = far * far * point.error
            near, far = near - off, far + off
        beside = pixel_depth(shell.nearest[k], u, v)
        if beside < pixel_depth(shell.depth[k], u, v):
            near = min(near, beside)
        least[i], most[i] = near / along * length, far / along * length


@njit(cache=True, nogil=True)
def _face_of(direction: Any) -> int:
    """Return which face of the world-aligned cube a direction hits."""
    x, y, z = direction
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        return 0 if x > 0 else 2
    if abs(y) >= abs(z):
        return 3 if y > 0 else 1
    return 4 if z > 0 else 5


@njit(cache=True, nogil=True)
def look_up(shell: Any, direction: Any) -> tuple[int, float, float, float]:
    """Return the view that a direction is in, the pixel there, and the direction's component along its axis.

    -1 if it is in none.
    """
    if shell.cube:
        k = shell.slot[_face_of(direction)]
        if k < 0:
            return -1, 0.0, 0.0, 1.0
        u, v, along = seen_by(shell, k, direction)
        return k, u, v, along
    for k in range(shell.R_c_w.shape[0]):
        u, v, along = seen_by(shell, k, direction)
        if 0.0 <= u <= 2.0 * shell.half_width and 0.0 <= v <= 2.0 * shell.half_height:
            return k, u, v, along
    return -1, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True)
def seen_by(shell: Any, k: int, direction: Any) -> tuple[float, float, float]:
    """Return the pixel of a view in which a direction is, and its component along the view's axis.

    The pixel is (-1, -1) behind the view.
    """
    x, y, z = direction
    R = shell.R_c_w[k]
    along = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
    if along <= 0.0:
        return -1.0, -1.0, along
    u = shell.focal * (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z) / along + shell.half_width
    v = shell.focal * (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z) / along + shell.half_height
    return u, v, along


@njit(cache=True, nogil=True)
def pixel_depth(face: Any, u: float, v: float) -> float:
    r, c = nearest_pixel(face.shape, u, v)
    return float(face[r, c])


@njit(cache=True, nogil=True)
def planar_depth(shell: Any, k: int, u: float, v: float) -> float:
    """Return planar depth between pixels; +inf where there is no surface."""
    point = surface_point(shell.depth[k], u, v, shell.focal, shell.precision)
    return 1.0 / point.inverse if point.inverse > 0.0 else np.inf
