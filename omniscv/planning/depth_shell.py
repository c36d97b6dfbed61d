"""Depth that was captured from one centre: which view a direction is in, and what is there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.geometry import Array, cube_rotations
from omniscv.geometry.arrays import Floats, Ints, stacked
from omniscv.geometry.surfaces import Point, Precision, discontinuities, nearest_pixel, surface_point
from omniscv.sources import codecs
from omniscv.sources.base import Capture

_SAME_FACE = 0.01
"""Largest difference of rotation matrices of a face and of the view that a source captured for it."""
CAPTURED, NEAREST = 0, 1
"""The two ``pictures`` of a view."""
_BORDER_PX = 3.0
"""Of a finer view, where neighbours are missing from which surfaces are judged."""


class FinerViews(NamedTuple):
    """Views that show parts of a shell more finely, each in a size of its own, the finest first.

    Attributes:
        pictures: (2, N) float32, those of the views as :class:`DepthShell` has them, one after the other.
        lenses: (P, 13) as :class:`DepthShell` has them, and where each view's picture starts.
    """

    pictures: Floats
    lenses: Array


class DepthShell(NamedTuple):
    """The depth captured from one centre.

    Attributes:
        center_w: (3,) metres.
        pictures: (2, V, h, w) float32, planar metres, +inf for the sky; and the depth of the nearest surface
            within a pixel, where that is another surface than the pixel's own, else the pixel's own depth.
        slot: (6,) int64, index of each face of a world-aligned cube in ``pictures``; -1 if not captured.
        cube: whether only the faces of the cube are looked up; else any view that holds a direction.
        focal, half_width, half_height: px.
        lenses: (V, 12) of each view, the rows of the rotation from the world to it, its focal length, and
            half its width and height, px.
        least, most: of the finite distances, metres.
        precision: of the depth.
        finer: views that are looked up first, and counted after the others; None if there are none, for
            which kernels are compiled without them.
    """

    center_w: Array
    pictures: Floats
    slot: Ints
    cube: bool
    focal: float
    half_width: float
    half_height: float
    least: float
    most: float
    precision: Precision
    lenses: Array
    finer: FinerViews | None = None

    def refined(self, captures: Sequence[Capture]) -> DepthShell:
        """Return the shell with finer views in place of those that it has.

        Args:
            captures: depth from the same centre, encoded as the shell's.
        """
        captures = sorted(captures, key=lambda capture: -capture.view.focal_px)
        pictures = [_with_nearest(capture.pixels).reshape(2, -1) for capture in captures]
        starts = np.cumsum([0, *(picture.shape[1] for picture in pictures)])[:-1]
        lenses = np.column_stack([[*map(_lens, captures)], starts])
        least, most = zip(*map(_range, captures), strict=True)
        return self._replace(
            finer=FinerViews(np.concatenate(pictures, axis=1), lenses),
            least=min(self.least, *least),
            most=max(self.most, *most),
        )


def _lens(capture: Capture) -> Array:
    view = capture.view
    return np.array([*view.pose.R_w_c.T.ravel(), view.focal_px, view.width / 2, view.height / 2])


def _range(capture: Capture) -> tuple[float, float]:
    """Return the least planar depth and the greatest distance of what a capture shows, metres."""
    view, depth = capture.view, capture.pixels
    corner = float(np.sqrt(1 + (view.width**2 + view.height**2) / (2 * view.focal_px) ** 2))
    return float(depth.min()), float(depth[np.isfinite(depth)].max(initial=0.0)) * corner


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
    depth = [capture.pixels for capture in captures]
    least, most = zip(*map(_range, captures), strict=True)
    return DepthShell(
        stacked(center_w),
        stacked(np.stack([_with_nearest(face) for face in depth], axis=1)),
        slot,
        cube,
        view.focal_px,
        view.width / 2,
        view.height / 2,
        least=min(least),
        most=max(most),
        precision=codecs.precision(captures[0].encoding),
        lenses=np.array([*map(_lens, captures)]),
    )


def _with_nearest(face: Floats) -> Floats:
    """Return (2, h, w) depth, and that of the nearest surface within a pixel, where that is another one."""
    least = cv2.erode(face, np.ones((3, 3), np.uint8))
    beside = cv2.erode(discontinuities(face), np.ones((3, 3), np.uint8)) == 0
    return np.stack([face, np.where(beside, least, face)])


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


@njit(cache=True, nogil=True, error_model="numpy")
def _distances(shell: Any, directions: Any, least: Any, most: Any) -> None:
    for i in range(directions.shape[0]):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        length = np.sqrt(x * x + y * y + z * z)
        k, u, v, along = look_up(shell, (x, y, z)) if length > 0 else (-1, 0.0, 0.0, 1.0)
        if k < 0:
            continue
        point = surface_at(shell, k, u, v)
        far = near = 1.0 / point.inverse if point.inverse > 0.0 else np.inf
        if point.inverse > 0.0:
            off = far * far * point.error
            near, far = near - off, far + off
        beside = pixel_depth(shell, NEAREST, k, u, v)
        if beside < pixel_depth(shell, CAPTURED, k, u, v):
            near = min(near, beside)
        least[i], most[i] = near / along * length, far / along * length


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _face_of(direction: Any) -> int:
    """Return which face of the world-aligned cube a direction hits."""
    x, y, z = direction
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        return 0 if x > 0 else 2
    if abs(y) >= abs(z):
        return 3 if y > 0 else 1
    return 4 if z > 0 else 5


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _finer_look_up(finer: Any, direction: Any) -> tuple[int, float, float, float]:
    """Return what :func:`look_up` returns, among the finer views."""
    if finer is None:
        return -1, 0.0, 0.0, 1.0
    for k in range(len(finer.lenses)):
        lens = finer.lenses[k]
        u, v, along = _seen_by(lens, direction)
        if min(min(u, 2.0 * lens[10] - u), min(v, 2.0 * lens[11] - v)) >= _BORDER_PX:
            return k, u, v, along
    return -1, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def look_up(shell: Any, direction: Any) -> tuple[int, float, float, float]:
    """Return the view that a direction is in, the pixel there, and the direction's component along its axis.

    -1 if it is in none.
    """
    k, u, v, along = _finer_look_up(shell.finer, direction)
    if k >= 0:
        return len(shell.lenses) + k, u, v, along
    if shell.cube:
        k = shell.slot[_face_of(direction)]
        if k < 0:
            return -1, 0.0, 0.0, 1.0
        u, v, along = _seen_by(shell.lenses[k], direction)
        return k, u, v, along
    for k in range(len(shell.lenses)):
        u, v, along = _seen_by(shell.lenses[k], direction)
        if 0.0 <= u <= 2.0 * shell.half_width and 0.0 <= v <= 2.0 * shell.half_height:
            return k, u, v, along
    return -1, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _seen_by(lens: Any, direction: Any) -> tuple[float, float, float]:
    """Return the pixel of a view in which a direction is, and its component along the view's axis.

    The pixel is (-1, -1) behind the view.
    """
    x, y, z = direction
    along = lens[6] * x + lens[7] * y + lens[8] * z
    if along <= 0.0:
        return -1.0, -1.0, along
    u = lens[9] * (lens[0] * x + lens[1] * y + lens[2] * z) / along + lens[10]
    v = lens[9] * (lens[3] * x + lens[4] * y + lens[5] * z) / along + lens[11]
    return u, v, along


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def lens_of(lenses: Any, finer: Any, k: int) -> Array:
    """Return the lens of a view of a shell with these lenses and finer views."""
    if finer is None:
        return lenses[k]  # type: ignore[no-any-return]
    return finer.lenses[k - len(lenses)] if k >= len(lenses) else lenses[k]  # type: ignore[no-any-return]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _finer_depth(finer: Any, which: int, k: int, u: float, v: float) -> float:
    """Return the nearest pixel of a finer view's picture, of either kind."""
    if finer is None:
        return 0.0
    lens = finer.lenses[k]
    width = int(2.0 * lens[10])
    r, c = nearest_pixel((int(2.0 * lens[11]), width), u, v)
    return float(finer.pictures[which, int(lens[12]) + r * width + c])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def pixel_depth(shell: Any, which: int, k: int, u: float, v: float) -> float:
    """Return the nearest pixel of one of a view's ``pictures``, planar metres."""
    if k >= len(shell.lenses):
        return _finer_depth(shell.finer, which, k - len(shell.lenses), u, v)  # type: ignore[no-any-return]
    r, c = nearest_pixel(shell.pictures.shape[2:], u, v)
    return float(shell.pictures[which, k, r, c])


@njit(cache=True, nogil=True, error_model="numpy")
def _finer_surface(finer: Any, k: int, u: float, v: float, precision: Precision) -> Point:
    """Return the surface at a continuous pixel of a finer view."""
    if finer is None:
        return Point(0.0, 0.0, 0.0, 0.0, 0.0)
    lens = finer.lenses[k]
    first, height, width = int(lens[12]), int(2.0 * lens[11]), int(2.0 * lens[10])
    face = finer.pictures[0, first : first + height * width].reshape((height, width))
    return surface_point(face, u, v, lens[9], precision)  # type: ignore[no-any-return]


@njit(cache=True, nogil=True, error_model="numpy")
def surface_at(shell: Any, k: int, u: float, v: float) -> Point:
    """Return the surface at a continuous pixel of a view."""
    if k >= len(shell.lenses):
        return _finer_surface(shell.finer, k - len(shell.lenses), u, v, shell.precision)  # type: ignore[no-any-return]
    return surface_point(shell.pictures[0, k], u, v, shell.focal, shell.precision)  # type: ignore[no-any-return]


@njit(cache=True, nogil=True, error_model="numpy")
def planar_depth(shell: Any, k: int, u: float, v: float) -> float:
    """Return planar depth between pixels; +inf where there is no surface."""
    point = surface_at(shell, k, u, v)
    return 1.0 / point.inverse if point.inverse > 0.0 else np.inf
