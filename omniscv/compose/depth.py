"""Depth along rays from captures of planar depth, and how far it may be off.

Where pixels share an optical centre that is not their ray's own origin, a ray meets a plane elsewhere than
the ray from the centre does, and near the edge of an object it may meet something else. Both are part of
the error: the one by the plane's slope, the other by what lies within the parallax.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.compose import kernels
from omniscv.compose.kernels import Faces, Floats, Ints, Mask
from omniscv.compose.ray_lookup import RayLookup
from omniscv.geometry import Array
from omniscv.geometry.surfaces import (
    Cell,
    Precision,
    discontinuities,
    interpolated,
    inverse_depth,
    stored_length,
    surface_point,
)
from omniscv.sources.base import View

NEAR_PLANE_M = 0.1
"""Engines draw nothing that is nearer."""
_AHEAD_PX = 1.5
"""The parallax is measured from the nearest pixel, and an edge lies within one of what shows it."""
_SLOPE_ERRORS = 2.0
"""The slope between two pixels is off by both their errors."""
_MARGIN = 1.3
"""A neighbouring surface goes on between the pixels that show it."""
_BLOCK = 256
"""Rays that are gathered at a time: their buffers stay in the fastest cache."""
_CELL_PX = 4
"""Smaller pictures have no pixels around 2 x 2 of theirs."""


@dataclass(frozen=True, eq=False)
class SampledDepth:
    """Depth along N rays.

    Attributes:
        distance: (N,) float32 metres along the ray; +inf no surface, 0 where no view sees it.
        error: (N,) float32 metres, how far the distance along the pixel's own ray may be off it; +inf
            where nothing bounds it.
        parallax: (N,) float32 radians, how far from the ray its own surface may show; None for rays from
            their own origins.
    """

    distance: Floats
    error: Floats
    parallax: Floats | None = None
    beside_edge: Mask | None = None


def sample_depth(
    faces: Faces,
    lookup: RayLookup,
    views: Sequence[View],
    nearest: bool,
    precision: Precision,
    offsets_w: Array | None = None,
) -> SampledDepth:
    """Return depth along N rays.

    Args:
        faces: (h, w) planar metres of each view, +inf where there is no surface.
        lookup: of N rays.
        views: those of the faces.
        nearest: take the nearest pixel's depth everywhere.
        precision: of the faces.
        offsets_w: (N, 3) from the views' centre to the rays' own origins, metres; None: they are the same.
    """
    stack, distance, error = kernels.stacked(faces), np.empty_like(lookup.x), np.empty_like(lookup.x)
    focal = np.array([view.focal_px for view in views])
    sampled = lookup.view, lookup.x, lookup.y, distance, error
    kernels.run(_sample, sampled, stack, focal, nearest, precision)
    if offsets_w is None or not len(offsets_w):
        return SampledDepth(distance, error)
    parallax, beside = np.empty_like(lookup.x), np.empty(len(lookup.x), np.bool_)
    least = max(float(stack.min()), NEAR_PLANE_M)
    reach_px = int(np.ceil(np.linalg.norm(offsets_w, axis=-1).max() * focal.max() / least * _MARGIN)) + 2
    around = [np.stack(each) for each in zip(*(_surroundings(face, reach_px) for face in stack), strict=True)]
    R_c_w = np.array([view.pose.R_w_c.T for view in views])
    kernels.run(_displace, (*sampled, parallax, beside, offsets_w), stack, focal, precision, R_c_w, *around)
    return SampledDepth(distance, error, parallax, beside)


def _surroundings(face: Floats, reach_px: int) -> tuple[Floats, Floats, Floats]:
    """For each pixel: px to the next edge of a surface, and the least and greatest depth within reach."""
    size = 2 * min(reach_px, max(face.shape)) + 1
    window = np.ones((1, size), np.uint8)
    least, most = face, face
    for kernel in (window, window.T):
        least, most = cv2.erode(least, kernel), cv2.dilate(most, kernel)
    edges = discontinuities(face)
    far = np.full(face.shape, np.inf, np.float32)
    return (far if edges.all() else cv2.distanceTransform(edges, cv2.DIST_C, 3)), least, most


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(
    view: Ints, x: Floats, y: Floats, distance: Floats, error: Floats,
    stack: Floats, focal: Array, nearest: bool, precision: Precision,
) -> None:  # fmt: skip
    """Sample block by block: what all rays read is gathered, so that what is computed of it is vectorized."""
    height, width = stack.shape[1], stack.shape[2]
    around, at = np.empty((12, _BLOCK), np.float32), np.empty((5, _BLOCK))
    whole = not nearest and min(height, width) >= _CELL_PX
    for first in range(0, view.shape[0], _BLOCK):
        last = min(first + _BLOCK, view.shape[0])
        if whole:
            _gather(view[first:last], x[first:last], y[first:last], stack, focal, precision, around, at)
            _interpolate(around, at, max(height, width), precision, distance[first:last], error[first:last])
        for i in range(first, last):
            if view[i] < 0:
                distance[i] = error[i] = 0.0
            elif not whole or not distance[i] > 0.0:
                k = view[i]
                distance[i], error[i] = _sample_one(stack[k], x[i], y[i], focal[k], nearest, precision)


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(
    view: Ints, x: Floats, y: Floats, stack: Floats, focal: Array, precision: Precision,
    around: Floats, at: Array,
) -> None:  # fmt: skip
    """Write the depths around each point, as :class:`Cell` has them, and its a, b, u, v and stored length."""
    height, width, flat = stack.shape[1], stack.shape[2], stack.reshape(-1)
    row, one, two = np.uint64(width), np.uint64(1), np.uint64(2)  # unsigned: others cost a test each
    for j in range(view.shape[0]):
        k = max(view[j], 0)
        across, down = int(np.floor(x[j] - 0.5)), int(np.floor(y[j] - 0.5))
        c, r = min(max(across, 1), width - 3), min(max(down, 1), height - 3)
        o = np.uint64((k * height + r - 1) * width + c)
        around[0, j], around[1, j] = flat[o], flat[o + one]
        o += row
        around[2, j], around[3, j] = flat[o - one], flat[o]
        around[4, j], around[5, j] = flat[o + one], flat[o + two]
        o += row
        around[6, j], around[7, j] = flat[o - one], flat[o]
        around[8, j], around[9, j] = flat[o + one], flat[o + two]
        o += row
        around[10, j], around[11, j] = flat[o], flat[o + one]
        if c != across or r != down:
            around[3, j] = np.inf  # no cell around the point: its pixel's surface is continued
        at[0, j], at[1, j] = x[j] - 0.5 - c, y[j] - 0.5 - r
        at[2, j], at[3, j] = (x[j] - width / 2) / focal[k], (y[j] - height / 2) / focal[k]
        at[4, j] = stored_length(r, c, (height, width), focal[k], precision)


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(
    around: Floats, at: Array, size: int, precision: Precision, distance: Floats, error: Floats
) -> None:
    """Write depth along rays; 0 where no one surface lies around the point."""
    for j in range(distance.shape[0]):
        cell = Cell(
            inverse_depth(around[0, j]), inverse_depth(around[1, j]), inverse_depth(around[2, j]),
            inverse_depth(around[3, j]), inverse_depth(around[4, j]), inverse_depth(around[5, j]),
            inverse_depth(around[6, j]), inverse_depth(around[7, j]), inverse_depth(around[8, j]),
            inverse_depth(around[9, j]), inverse_depth(around[10, j]), inverse_depth(around[11, j]),
        )  # fmt: skip
        point = interpolated(cell, at[0, j], at[1, j], at[4, j], size, precision)
        z, length = 1.0 / point.inverse, np.sqrt(1.0 + at[2, j] * at[2, j] + at[3, j] * at[3, j])
        distance[j] = z * length if point.inverse > 0.0 else 0.0
        error[j] = z * z * point.error * length


@njit(cache=True, nogil=True)
def _sample_one(
    face: Floats, x: float, y: float, focal: float, nearest: bool, precision: Precision
) -> tuple[float, float]:
    """Return depth along one ray, and how far it may be off."""
    height, width = face.shape
    u, v = (x - width / 2) / focal, (y - height / 2) / focal
    length = np.sqrt(1.0 + u * u + v * v)
    point = surface_point(face, x, y, focal, precision)
    if point.inverse == 0.0:
        return np.inf, np.inf if point.jump > 0.0 or precision.largest_m < np.inf else 0.0
    z = 1.0 / point.inverse
    off = z * z * point.error + _MARGIN * point.jump
    if nearest:
        c = min(max(int(np.floor(x)), 0), width - 1)
        r = min(max(int(np.floor(y)), 0), height - 1)
        off += abs(face[r, c] - z)
        z = face[r, c]
    return z * length, off * length


@njit(cache=True, nogil=True)
def _displace(
    view: Ints, x: Floats, y: Floats, distance: Floats, error: Floats, parallax: Floats, beside: Mask,
    offsets_w: Array,
    stack: Floats, focal: Array, precision: Precision, R_c_w: Array,
    edge_px: Floats, least: Floats, most: Floats,
) -> None:  # fmt: skip
    """Add the error of rays that start elsewhere than at the centre."""
    height, width = stack.shape[1], stack.shape[2]
    for i in range(view.shape[0]):
        k, parallax[i], beside[i] = view[i], 0.0, False
        if k < 0:
            continue
        offset = R_c_w[k] @ offsets_w[i]
        u, v = (x[i] - width / 2) / focal[k], (y[i] - height / 2) / focal[k]
        length = np.sqrt(1.0 + u * u + v * v)
        along = (offset[0] * u + offset[1] * v + offset[2]) / length
        size = np.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
        aside = np.sqrt(max(0.0, size * size - along * along))
        c = min(max(int(np.floor(x[i])), 0), width - 1)
        r = min(max(int(np.floor(y[i])), 0), height - 1)
        near = max(least[k, r, c], NEAR_PLANE_M / length)
        parallax[i] = _MARGIN * aside / (near * length)
        point = surface_point(stack[k], x[i], y[i], focal[k], precision)
        if point.inverse > 0.0:
            a, b = point.across * focal[k], point.down * focal[k]
            e = point.inverse - a * u - b * v
            shift = abs(a * offset[0] + b * offset[1] + e * offset[2])
            error[i] += distance[i] * (shift + _SLOPE_ERRORS * point.error * focal[k] * aside)
        beside[i] = edge_px[k, r, c] <= parallax[i] * focal[k] * length * length + _AHEAD_PX
        if beside[i]:
            error[i] += _MARGIN * (most[k, r, c] - least[k, r, c]) * length + size
