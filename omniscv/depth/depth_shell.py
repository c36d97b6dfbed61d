"""Depth that was captured from one centre: which view a direction is in, and what is there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from omniscv.compiled import fields, njit
from omniscv.depth.relief import planar_errors, planar_relief
from omniscv.depth.surfaces import Point, discontinuities, nearest_pixel, surface_point
from omniscv.geometry import Array, cube_rotations
from omniscv.geometry.arrays import Floats, Ints, stacked
from omniscv.geometry.precision import Precision
from omniscv.parallel import side_by_side
from omniscv.sources import codecs
from omniscv.sources.base import Capture

_SAME_FACE = 0.01
"""Largest difference of rotation matrices of a face and of the view that a source captured for it."""
CELL_PX = 8
CAPTURED = 0
NEAREST = 1
RELIEF = 2
OFF = 3
"""The ``pictures`` of a view."""
_BORDER_PX = 3.0
"""Of a finer view, where neighbours are missing from which surfaces are judged."""
_ROUNDED = 1e-6  # relative, of float32


@fields(
    "float64[::1], float32[:, ::1], float64[:, ::1], int64[::1], bool, float32[:, :, ::1], float64, "
    "float64, float64,"
    " Precision"
)
class DepthShell(NamedTuple):
    """The depth captured from one centre.

    Attributes:
        center_w: (3,) metres.
        pictures: (3 or 4, N) float32, the pictures of all views, one after the other: planar metres, +inf for
            the sky; the depth of the nearest surface within a pixel, where that is another surface than the
            pixel's own, else the pixel's own depth; by how much relief may change the depth; and how far
            captures say it is off, where they do.
        lenses: (V, 15) of each view: the rows of the rotation from the world to it, its focal length, half
            its width and height, where its picture starts, and how far from its middle, across and down, it
            is looked up; px. Finer views, the finest first, are behind the others, and looked up first.
        slot: (6,) int64, index of each face of a world-aligned cube among the views; -1 if not captured.
        cube: whether the views are faces of such a cube, which together show all directions that are ever
            looked up.
        clear: (V, R, C) float32 metres from the centre, by view that is no finer one, and cell of
            ``CELL_PX``: nothing is nearer within a cell of it; 0 at a view's edge. Of a cube only; else
            (V, 0, 0).
        focal: px, of the coarsest view.
        least, most: of the finite distances, metres.
        precision: of the depth.
    """

    center_w: Array
    pictures: Floats
    lenses: Array
    slot: Ints
    cube: bool
    clear: Floats
    focal: float
    least: float
    most: float
    precision: Precision

    def refined(self, captures: Sequence[Capture]) -> DepthShell:
        """Return the shell with further, finer views, which are looked up first.

        Args:
            captures: depth from the same centre, encoded as the shell's.
        """
        pictures, finer = _views(captures)
        finer[:, 12] += self.pictures.shape[1]
        finer[:, 13:] -= _BORDER_PX
        count = len(self.clear)
        lenses = np.concatenate([self.lenses[count:], finer])
        least, most = zip(*map(_range, captures), strict=True)
        return self._replace(
            pictures=stacked(np.concatenate([self.pictures, pictures], axis=1)),
            lenses=np.concatenate([self.lenses[:count], lenses[np.argsort(-lenses[:, 9], kind="stable")]]),
            least=min(self.least, *least),
            most=max(self.most, *most),
        )


def _views(captures: Sequence[Capture]) -> tuple[Floats, Array]:
    """Return the pictures and lenses of captures of depth, as :class:`DepthShell` has them."""
    pictures = [each.reshape(3, -1) for each in side_by_side(_pictures, list(captures))]
    starts = np.cumsum([0, *(picture.shape[1] for picture in pictures)])
    lenses = []
    for view, start in zip((capture.view for capture in captures), starts, strict=False):
        half = view.width / 2, view.height / 2
        lenses.append([*view.pose.R_w_c.T.ravel(), view.focal_px, *half, start, *half])
    whole = np.concatenate(pictures, axis=1)
    if off := planar_errors(captures):
        whole = np.concatenate([whole, np.concatenate([each.reshape(1, -1) for each in off], axis=1)])
    return whole, np.array(lenses)


def _range(capture: Capture) -> tuple[float, float]:
    """Return the least planar depth and the greatest distance of what a capture shows, metres."""
    view = capture.view
    depth = capture.pixels
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
    R_c_w = np.array([capture.view.pose.R_w_c.T for capture in captures])
    slot = np.full(6, -1, np.int64)
    for face, (_, R_w_f) in enumerate(cube_rotations()):
        off = np.abs(R_c_w - R_w_f.T).max(axis=(1, 2))
        if off.min() < _SAME_FACE:
            slot[face] = off.argmin()
    # Faces of a turned cube, or turned by quarters, are views of other orientations; those that a server
    # captures in addition to a face have its axis.
    axes_w = R_c_w[:, 2]
    matched = R_c_w[slot[slot >= 0], 2]
    cube = cube and len(matched) > 0 and bool(((axes_w @ matched.T).max(axis=1) > 1 - _SAME_FACE).all())
    pictures, lenses = _views(captures)
    least, most = zip(*map(_range, captures), strict=True)
    return DepthShell(
        stacked(center_w),
        stacked(pictures),
        lenses,
        slot=slot,
        cube=cube,
        clear=_clear(captures, pictures) if cube else np.zeros((len(captures), 0, 0), np.float32),
        focal=captures[0].view.focal_px,
        least=min(least),
        most=max(most),
        precision=codecs.precision(captures[0]),
    )


def _clear(captures: Sequence[Capture], pictures: Floats) -> Floats:
    """Return what :class:`DepthShell` has as ``clear``, of views of one size."""
    view = captures[0].view
    x, y = (np.arange(size) + 0.5 - size / 2 for size in (view.width, view.height))
    slant = (1 - _ROUNDED) * np.sqrt(1 + (x**2 + y[:, None] ** 2) / view.focal_px**2)
    rows, columns = (size // CELL_PX for size in slant.shape)
    whole = (slice(None), slice(rows * CELL_PX), slice(columns * CELL_PX))
    away = (pictures[NEAREST].reshape(-1, *slant.shape) * slant)[whole]
    cells = away.reshape(-1, rows, CELL_PX, columns, CELL_PX).min(axis=(2, 4))
    clear = np.zeros((len(captures), rows + 1, columns + 1), np.float32)  # a cell may be cut
    for each, least in zip(clear, cells, strict=True):
        each[1 : rows - 1, 1 : columns - 1] = cv2.erode(least, np.ones((3, 3), np.uint8))[1:-1, 1:-1]
    return clear


def _pictures(capture: Capture) -> Floats:
    """Return (3, h, w) a view's pictures, as :class:`DepthShell` has them, but for what captures say."""
    face = capture.pixels
    relief = planar_relief(capture)
    # Beyond its border a picture goes on: OpenCV's own border is a finite depth, in the sky the nearest.
    least = cv2.erode(face, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    beside = cv2.erode(discontinuities(face), np.ones((3, 3), np.uint8)) == 0
    return np.stack([face, np.where(beside, least, face), np.zeros_like(face) if relief is None else relief])


def distances(shell: DepthShell, directions_w: Array) -> tuple[Array, Array]:
    """Return (N,) the least and the greatest distances at which a direction may meet a surface, metres.

    0 and +inf in directions that were not captured, and for a direction of length 0.

    Args:
        shell: captured depth.
        directions_w: (N, 3), of any length.
    """
    least = np.zeros(len(directions_w))
    most = np.full(len(directions_w), np.inf)
    _distances(shell, directions_w, least, most)
    return least, most


@njit("DepthShell, float64[:, ::1], out float64[::1], out float64[::1]", nogil=True, error_model="numpy")
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
            near, far = 1.0 / (point.inverse + point.error), far + far * far * point.error
        beside = pixel_depth(shell, NEAREST, k, u, v)
        if beside < pixel_depth(shell, CAPTURED, k, u, v):
            near = min(near, beside)
        least[i], most[i] = near / along * length, far / along * length


@njit(nogil=True, error_model="numpy", forceinline=True)
def _face_of(direction: Any) -> int:
    """Return which face of the world-aligned cube a direction hits."""
    x, y, z = direction
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        return 0 if x > 0 else 2
    if abs(y) >= abs(z):
        return 3 if y > 0 else 1
    return 4 if z > 0 else 5


@njit(nogil=True, error_model="numpy", forceinline=True)
def look_up(shell: Any, direction: Any) -> tuple[int, float, float, float]:
    """Return the view that a direction is in, the pixel there, and the direction's component along its axis.

    -1 if it is in none.
    """
    k = _holding(shell, len(shell.clear), len(shell.lenses), direction)
    if k < 0:
        k = shell.slot[_face_of(direction)] if shell.cube else _holding(shell, 0, len(shell.clear), direction)
    if k < 0:
        return -1, 0.0, 0.0, 1.0
    a, b, along = _seen(shell, k, direction)
    return k, a / along + shell.lenses[k, 10], b / along + shell.lenses[k, 11], along


@njit(nogil=True, error_model="numpy", forceinline=True)
def _seen(shell: Any, k: int, direction: Any) -> tuple[float, float, float]:
    """Return a direction in a view's frame, its x and y times the focal length."""
    x, y, z = direction
    a = shell.lenses[k, 0] * x + shell.lenses[k, 1] * y + shell.lenses[k, 2] * z
    b = shell.lenses[k, 3] * x + shell.lenses[k, 4] * y + shell.lenses[k, 5] * z
    along = shell.lenses[k, 6] * x + shell.lenses[k, 7] * y + shell.lenses[k, 8] * z
    return a * shell.lenses[k, 9], b * shell.lenses[k, 9], along


@njit(nogil=True, error_model="numpy", forceinline=True)
def _holding(shell: Any, first: int, end: int, direction: Any) -> int:
    """Return the first of some views that a direction is in; -1 if it is in none."""
    for k in range(first, end):
        a, b, along = _seen(shell, k, direction)
        if along > 0.0 and abs(a) <= shell.lenses[k, 13] * along and abs(b) <= shell.lenses[k, 14] * along:
            return k
    return -1


@njit(nogil=True, error_model="numpy", forceinline=True)
def pixel_depth(shell: Any, which: int, k: int, u: float, v: float) -> float:
    """Return the nearest pixel of one of a view's ``pictures``, planar metres."""
    width = int(2.0 * shell.lenses[k, 10])
    r, c = nearest_pixel((int(2.0 * shell.lenses[k, 11]), width), u, v)
    return float(shell.pictures[which, int(shell.lenses[k, 12]) + r * width + c])


@njit(nogil=True, error_model="numpy", forceinline=True)
def error_said(shell: Any, k: int, u: float, v: float) -> float:
    """Return how far planar depth may be off as captures say, metres."""
    return float(pixel_depth(shell, OFF, k, u, v)) if shell.pictures.shape[0] > OFF else 0.0


@njit(nogil=True, error_model="numpy")
def surface_at(shell: Any, k: int, u: float, v: float) -> Point:
    """Return the surface at a continuous pixel of a view."""
    shape = int(2.0 * shell.lenses[k, 11]), int(2.0 * shell.lenses[k, 10])
    first, focal = int(shell.lenses[k, 12]), shell.lenses[k, 9]
    point = surface_point(shell.pictures[CAPTURED], first, shape, u, v, focal, shell.precision)
    relief = pixel_depth(shell, RELIEF, k, u, v) * point.inverse * point.inverse
    error = max(point.error, relief) + error_said(shell, k, u, v) * point.inverse * point.inverse
    return Point(point.inverse, point.across, point.down, error, point.jump)


@njit(nogil=True, error_model="numpy")
def planar_depth(shell: Any, k: int, u: float, v: float) -> float:
    """Return planar depth between pixels; +inf where there is no surface."""
    point = surface_at(shell, k, u, v)
    return 1.0 / point.inverse if point.inverse > 0.0 else np.inf
