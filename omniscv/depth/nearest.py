"""Values that are never blended across objects: of the nearest pixels, where they change, and of planes."""

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.depth.ray_lookup import RayLookup
from omniscv.depth.relief import label_relief, lone_labels
from omniscv.depth.surfaces import fitted_plane, nearest_pixel, plane_of
from omniscv.geometry import Array
from omniscv.geometry.arrays import Faces, Floats, Ints, Mask, Pixels, reads_few, run, stacked
from omniscv.parallel import side_by_side
from omniscv.sources.base import View

_BESIDE = 1
_LONE = 32
_AROUND_PX = 3
"""Pixels on every side to which a plane is fitted: steps of half floats are larger than a pixel's slope."""
_ONE_SURFACE = 0.95
"""The cosine of the angle that two pixels' normals may make on one smooth surface, 18 degrees."""


def sample_nearest(faces: Faces, lookup: RayLookup) -> Pixels:
    """Return (N, ...) values of (h, w, ...) faces along the rays of ``lookup``; 0 where no view sees one."""
    if not isinstance(faces, np.ndarray) and reads_few(faces, len(lookup.view)):
        few = np.zeros((len(lookup.view), *faces[0].shape[2:]), faces[0].dtype)
        last = np.array(faces[0].shape[:2]) - 1
        for k, rays in lookup.by_view():
            at = np.stack([lookup.y[rays], lookup.x[rays]], axis=-1).astype(np.intp).clip(0, last)
            few[rays] = faces[k][at[:, 0], at[:, 1]]
        return few
    stack = stacked(faces)
    values = stack.reshape(math.prod(stack.shape[:3]), -1).view(np.uint8)  # one kernel for every type
    out = np.empty((len(lookup.view), values.shape[1]), np.uint8)
    run(_take, (lookup.nearest(stack.shape[:3]), out), values.reshape(-1))
    return out.view(stack.dtype).reshape(-1, *stack.shape[3:])


@njit("int32[::1], out uint8[:, ::1], uint8[::1]", "int64[::1], out uint8[:, ::1], uint8[::1]", nogil=True)
def _take(pixels: Ints, out: Pixels, values: Pixels) -> None:
    """Write the bytes of pixels, 0 for pixel -1; one and three bytes, of marks and masks, without a loop."""
    count = out.shape[1]
    if count == 1:
        for i in range(pixels.shape[0]):
            out[i, 0] = values[pixels[i]] if pixels[i] >= 0 else 0
    elif count == 3:
        for i in range(pixels.shape[0]):
            first = 3 * pixels[i]
            if first < 0:
                out[i, 0] = out[i, 1] = out[i, 2] = 0
            else:
                out[i, 0], out[i, 1], out[i, 2] = values[first], values[first + 1], values[first + 2]
    else:
        for i in range(pixels.shape[0]):
            for j in range(count):
                out[i, j] = values[count * pixels[i] + j] if pixels[i] >= 0 else 0


def boundaries(faces: Faces, lone: bool = False) -> Pixels:
    """Return (V, h, w) uint8 which neighbours of each pixel have another value.

    1: one of the four beside it; 2 to 16: those above left, above right, below left and below right; 32:
    :func:`lone_labels`.

    Args:
        faces: V masks.
        lone: whether lone labels are marked.
    """
    return stacked(side_by_side(lambda face: _boundary(face, lone), list(faces)))


def label_edges(
    boundaries: Pixels,
    lookup: RayLookup,
    views: Sequence[View],
    parallax: Floats | None = None,
    relief: Mask | None = None,
) -> Mask:
    """Return (N,) whether rays lie within a pixel of a label boundary: there the label may be the
    neighbour's. Of the pixels at the corners, only the nearest to a ray counts.

    Args:
        boundaries: (V, h, w) of masks, see :func:`boundaries`.
        lookup: of N rays.
        views: those of the masks.
        parallax: (N,) radians, how far from the ray its surface may show; None: nowhere else.
        relief: (N,) where relief makes lone labels doubtful, too; None for nowhere.
    """
    pixels = lookup.nearest(boundaries.shape)
    out = np.zeros(len(pixels), np.bool_) if relief is None else relief.copy()
    run(_at_edge, (pixels, lookup.x, lookup.y, out), boundaries.reshape(-1))
    if parallax is None:
        return out

    def px_to_boundary(boundary: Pixels) -> Floats:
        beside = boundary & np.uint8(_BESIDE)
        if not beside.any():
            return np.full(boundary.shape, np.inf, np.float32)
        return np.asarray(cv2.distanceTransform(1 - beside, cv2.DIST_C, 3))

    edge_px = np.stack(side_by_side(px_to_boundary, list(boundaries)))
    projections = np.array([view.projection for view in views])
    run(_near, (lookup.view, lookup.x, lookup.y, parallax, out), edge_px, projections)
    return out


@njit(
    "int32[::1], float32[::1], float32[::1], out bool[::1], uint8[::1]",
    "int64[::1], float32[::1], float32[::1], out bool[::1], uint8[::1]",
    nogil=True,
)
def _at_edge(pixels: Ints, x: Floats, y: Floats, out: Mask, marks: Pixels) -> None:
    """Write whether rays are at an edge, in place of whether they are in relief."""
    for i in range(pixels.shape[0]):
        corner = 2 * (y[i] - np.floor(y[i]) >= 0.5) + (x[i] - np.floor(x[i]) >= 0.5)
        out[i] = pixels[i] >= 0 and (marks[pixels[i]] & (1 | 2 << corner | _LONE * out[i])) != 0


def _boundary(face: Pixels, lone: bool) -> Pixels:
    """Return (h, w) what :func:`boundaries` returns of a face; where labels are relief, 1."""
    values = face.reshape(*face.shape[:2], -1)
    if face.dtype == np.uint8 and values.shape[2] == 3:  # as one number a pixel: five times as fast
        values = cv2.cvtColor(values, cv2.COLOR_RGB2RGBA).view(np.uint32)
    marks = np.zeros(face.shape[:2], np.uint8)

    def differ(here: Any, there: Any, mark: int, back: int) -> Mask:
        """Mark pixels that differ from others, and these."""
        differs = values[here] != values[there]
        other = differs.any(axis=2) if differs.shape[2] > 1 else differs[..., 0]
        marks[here] |= other * np.uint8(mark)
        marks[there] |= other * np.uint8(back)
        return np.asarray(other)

    first = slice(None, -1)
    last = slice(1, None)
    every = slice(None)
    across = differ((every, first), (every, last), _BESIDE, _BESIDE)
    down = differ((first, every), (last, every), _BESIDE, _BESIDE)
    differ((first, first), (last, last), 16, 2)
    differ((first, last), (last, first), 8, 4)
    if lone:
        marks |= lone_labels(across, down, face.shape[:2]) * np.uint8(_LONE)
    relief = label_relief(across, down, face.shape[:2])
    return marks if relief is None else marks | relief


@njit(
    "int16[::1], float32[::1], float32[::1], float32[::1], out bool[::1], float32[:, :, ::1], "
    "float64[:, ::1]",
    nogil=True,
)
def _near(
    view: Ints, x: Floats, y: Floats, parallax: Floats, out: Mask, edge_px: Floats, projections: Array
) -> None:
    height, width = edge_px.shape[1], edge_px.shape[2]
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            continue
        r, c = nearest_pixel((height, width), x[i], y[i])
        fx, fy = projections[k, 0], projections[k, 1]
        u, v = (x[i] - projections[k, 2]) / fx, (y[i] - projections[k, 3]) / fy
        border = min(min(c, r), min(width - 1 - c, height - 1 - r)) + 1.0  # labels beyond it may differ
        out[i] |= min(edge_px[k, r, c], border) <= parallax[i] * max(fx, fy) * (1.0 + u * u + v * v)


def sample_directions(faces: Faces, lookup: RayLookup, nearest: bool) -> Floats:
    """Return the unit vectors that N rays meet: blended on one smooth surface, never across an edge or a
    crease.

    Args:
        faces: (h, w, 3) unit vectors of each view, 0 where unknown.
        lookup: of N rays.
        nearest: take the nearest pixel's everywhere.

    Returns:
        (N, 3) float32, 0 where unknown or where no view sees the ray.
    """
    out = np.empty((len(lookup.x), 3), np.float32)
    run(_blend, (lookup.view, lookup.x, lookup.y, out), stacked(faces), nearest)
    return out


@njit("int16[::1], float32[::1], float32[::1], out float32[:, ::1], float32[:, :, :, ::1], bool", nogil=True)
def _blend(view: Ints, x: Floats, y: Floats, out: Floats, stack: Floats, nearest: bool) -> None:
    height, width = stack.shape[1], stack.shape[2]
    for i in range(view.shape[0]):
        k = view[i]
        out[i, 0] = out[i, 1] = out[i, 2] = 0.0
        if k < 0:
            continue
        face = stack[k]
        own_r, own_c = nearest_pixel((height, width), x[i], y[i])
        c, r = int(np.floor(x[i] - 0.5)), int(np.floor(y[i] - 0.5))
        inside = 0 <= c < width - 1 and 0 <= r < height - 1
        if nearest or not inside or not _one_surface(face, r, c, own_r, own_c):
            for j in range(3):
                out[i, j] = face[own_r, own_c, j]
            continue
        a, b = x[i] - 0.5 - c, y[i] - 0.5 - r
        square = 0.0
        for j in range(3):
            above = (1 - a) * face[r, c, j] + a * face[r, c + 1, j]
            below = (1 - a) * face[r + 1, c, j] + a * face[r + 1, c + 1, j]
            out[i, j] = (1 - b) * above + b * below
            square += out[i, j] * out[i, j]
        for j in range(3):
            out[i, j] /= np.sqrt(square)


@njit(nogil=True)
def _one_surface(face: Floats, r: int, c: int, own_r: int, own_c: int) -> bool:
    for j in range(r, r + 2):
        for k in range(c, c + 2):
            cosine = 0.0
            for n in range(3):
                cosine += face[j, k, n] * face[own_r, own_c, n]
            if cosine < _ONE_SURFACE:
                return False
    return True


def normals_from_depth(faces: Faces, lookup: RayLookup, views: Sequence[View]) -> Floats:
    """Return the normals of planes fitted to planar depth around the nearest pixels of N rays.

    Args:
        faces: (h, w) planar metres of each view, +inf where there is no surface.
        lookup: of N rays.
        views: those of the faces.

    Returns:
        (N, 3) float32 unit vectors toward the views' centre, world frame; 0 where there is no surface, or
        where too few pixels show it.
    """
    out = np.empty((len(lookup.x), 3), np.float32)
    projections = np.array([view.projection for view in views])
    R_w_c = np.array([view.pose.R_w_c for view in views])
    run(_fit, (lookup.view, lookup.x, lookup.y, out), stacked(faces), projections, R_w_c)
    return out


@njit(
    "int16[::1], float32[::1], float32[::1], out float32[:, ::1], float32[:, :, ::1], float64[:, ::1], "
    "float64[:, :, ::1]",
    nogil=True,
)
def _fit(
    view: Ints, x: Floats, y: Floats, out: Floats, stack: Floats, projections: Array, R_w_c: Array
) -> None:
    height, width = stack.shape[1], stack.shape[2]
    for i in range(view.shape[0]):
        k = view[i]
        out[i, 0] = out[i, 1] = out[i, 2] = 0.0
        if k < 0:
            continue
        r, c = nearest_pixel((height, width), x[i], y[i])
        if not stack[k, r, c] < np.inf:
            continue
        inverse, across, down, known = fitted_plane(stack[k], r, c, _AROUND_PX)
        if not known:
            continue
        dx, dy = c + 0.5 - projections[k, 2], r + 0.5 - projections[k, 3]
        a, b, e = plane_of(inverse, across, down, dx, dy, projections[k, 0], projections[k, 1])
        size = np.sqrt(a * a + b * b + e * e)
        for j in range(3):
            out[i, j] = -(R_w_c[k, j, 0] * a + R_w_c[k, j, 1] * b + R_w_c[k, j, 2] * e) / size
