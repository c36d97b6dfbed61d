"""Depth and normals along rays from captures of planar depth, and how far depth may be off.

Surfaces between pixels, and the planes through them, are those of :mod:`omniscv.geometry.surfaces`. Pixels
may share an optical centre that is not the origin of their rays. Then a ray meets a plane elsewhere than the
ray from the centre does, and near the edge of an object it may meet another surface. Both add to the error:
the first by the plane's slope, the second by the depths within the parallax.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from omniscv.compiled import inner, njit
from omniscv.compose.ray_lookup import RayLookup
from omniscv.geometry import Array
from omniscv.geometry.arrays import Faces, Floats, Ints, run, stacked
from omniscv.geometry.surfaces import (
    LEAST_M,
    Cell,
    Precision,
    Shape,
    continued,
    discontinuities,
    fitted_plane,
    interpolated,
    inverse_depth,
    nearest_pixel,
    plane_of,
    stored_length,
    surface_point,
)
from omniscv.sources.base import View

_AHEAD_PX = 1.5
"""The parallax is measured from the nearest pixel, and an edge lies within one of the pixel that shows it."""
_SLOPE_ERRORS = 2.0
"""The slope between two pixels is off by both their errors."""
_CURVED = 1.1
"""A surface that bends away from its plane shifts by more."""
_MARGIN = 1.3
"""A neighbouring surface goes on between the pixels that show it."""
_AROUND_PX = 3
"""Pixels on every side to which a plane is fitted: steps of half floats are larger than a pixel's slope."""
_BLOCK = 256
"""Rays whose depths are gathered at a time; their buffers fit into the fastest cache."""
_CELL_PX = 4
"""Least width and height of a picture in which a :class:`Cell` fits."""


class SampledDepth(NamedTuple):
    """Depth along N rays.

    Attributes:
        distance: (N,) float32 metres along the ray; +inf no surface, 0 where no view sees it.
        error: (N,) float32 metres, bound on the error of the distance along the pixel's own ray; +inf
            where nothing bounds it.
        parallax: (N,) float32 radians, how far from the ray its own surface may show; None for rays from
            their own origins.
    """

    distance: Floats
    error: Floats
    parallax: Floats | None = None


class _Pictures(NamedTuple):
    """Pictures of planar depth.

    Attributes:
        depth: (V h w,) float32 metres, picture by picture, row by row.
        shape: h and w.
        projections: (V, 4) fx, fy, cx, cy, px.
        precision: of the depth.
    """

    depth: Floats
    shape: Shape
    projections: Array
    precision: Precision


class _Surroundings(NamedTuple):
    """What surrounds each pixel, (V, h, w) float32: px to the next edge of a surface, and the least and
    greatest depth within reach."""

    edge_px: Floats
    least: Floats
    most: Floats


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
    distance, error = np.empty_like(lookup.x), np.empty_like(lookup.x)
    stack, projections = stacked(faces), np.array([view.projection for view in views])
    pictures = _Pictures(stack.reshape(-1), stack.shape[1:], projections, precision)
    run(_sample, (lookup.view, lookup.x, lookup.y, distance, error), pictures, nearest)
    if offsets_w is None or not len(offsets_w):
        return SampledDepth(distance, error)
    parallax = np.empty_like(lookup.x)
    least = max(float(stack.min()), LEAST_M)
    farthest_m = np.linalg.norm(offsets_w, axis=-1).max()
    reach_px = int(np.ceil(farthest_m * projections[:, :2].max() / least * _MARGIN)) + 2
    around = [_surroundings(face, reach_px) for face in stack]
    R_c_w = np.array([view.pose.R_w_c.T for view in views])
    run(
        _displace,
        (lookup.view, lookup.x, lookup.y, distance, error, parallax, offsets_w),
        pictures,
        _Surroundings(*map(np.stack, zip(*around, strict=True))),
        R_c_w,
    )
    return SampledDepth(distance, error, parallax)


def _surroundings(face: Floats, reach_px: int) -> tuple[Floats, Floats, Floats]:
    """Return the surroundings of the pixels of one face, as :class:`_Surroundings` has them."""
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
    view: Ints, x: Floats, y: Floats, distance: Floats, error: Floats, pictures: _Pictures, nearest: bool
) -> None:
    """Sample block by block: depths that all rays read are gathered, so that interpolation is vectorized."""
    height, width = pictures.shape
    around, at, start = np.empty((12, _BLOCK), np.float32), np.empty((5, _BLOCK)), np.empty(_BLOCK, np.uint64)
    has_cells = min(height, width) >= _CELL_PX
    for first in range(0, view.shape[0], _BLOCK):
        last = min(first + _BLOCK, view.shape[0])
        if has_cells:
            _gather(view[first:last], x[first:last], y[first:last], pictures, around, at, start)
            size, precision = max(height, width), pictures.precision
            _interpolate(around, at, size, precision, distance[first:last], error[first:last])
        for i in range(first, last):
            if view[i] < 0:
                distance[i] = error[i] = 0.0
                continue
            # As float64: functions that others call with float64 are compiled once.
            px, py = np.float64(x[i]), np.float64(y[i])
            if not has_cells or not distance[i] > 0.0:
                distance[i], error[i] = _beside_a_surface(pictures, view[i], px, py)
            if nearest:
                stored = _nearest_distance(pictures, view[i], px, py)
                error[i] += abs(stored - distance[i]) if distance[i] < np.inf else 0.0
                distance[i] = stored


@inner(cache=True, nogil=True, error_model="numpy")
def _gather(
    view: Ints, x: Floats, y: Floats, pictures: _Pictures, around: Floats, at: Array, start: Ints
) -> None:
    """Write the depths around each point, as :class:`Cell` has them, and its a, b, u, v and stored length.

    Row by row of the pictures, with few numbers at a time: twice as fast as point by point. ``start`` is
    overwritten; indices without a sign are not checked for one.
    """
    depth, projections, (height, width) = pictures.depth, pictures.projections, pictures.shape
    for j in range(view.shape[0]):
        k, px, py = max(view[j], 0), np.float64(x[j]), np.float64(y[j])
        c = min(max(np.floor(px - 0.5), 1.0), width - 3.0)
        r = min(max(np.floor(py - 0.5), 1.0), height - 3.0)
        start[j] = (k * height + np.int64(r) - 1) * width + np.int64(c)
        at[0, j], at[1, j] = px - 0.5 - c, py - 0.5 - r
        at[2, j], at[3, j] = (
            (px - projections[k, 2]) / projections[k, 0],
            (py - projections[k, 3]) / projections[k, 1],
        )
        at[4, j] = stored_length(
            np.int64(r), np.int64(c), pictures.shape, projections[k, 0], pictures.precision
        )
    one, row = np.uint64(1), np.uint64(width)
    for j in range(view.shape[0]):
        o = start[j]
        around[0, j], around[1, j] = depth[o], depth[o + one]
    for n in range(2, 7, 4):
        for j in range(view.shape[0]):
            start[j] += row
            o = start[j]
            around[n, j], around[n + 1, j] = depth[o - one], depth[o]
            around[n + 2, j], around[n + 3, j] = depth[o + one], depth[o + one + one]
    for j in range(view.shape[0]):
        o = start[j] + row
        around[10, j], around[11, j] = depth[o], depth[o + one]
        if not (0.0 <= at[0, j] < 1.0 and 0.0 <= at[1, j] < 1.0):
            around[3, j] = np.inf  # no cell around the point: its pixel's surface is continued


@inner(cache=True, nogil=True, error_model="numpy")
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


@inner(cache=True, nogil=True)
def _beside_a_surface(pictures: _Pictures, k: int, x: float, y: float) -> tuple[float, float]:
    """Return depth along a ray that has no surface all around it, and the bound on its error."""
    precision, shape, focal = pictures.precision, pictures.shape, pictures.projections[k, 0]
    point = continued(pictures.depth, k * shape[0] * shape[1], shape, x, y, focal, precision)
    if point.inverse == 0.0:
        return np.inf, np.inf if point.jump > 0.0 or precision.largest_m < np.inf else 0.0
    z, length = 1.0 / point.inverse, _ray_length(pictures, k, x, y)
    return z * length, (z * z * point.error + _MARGIN * point.jump) * length


@inner(cache=True, nogil=True)
def _nearest_distance(pictures: _Pictures, k: int, x: float, y: float) -> float:
    """Return the nearest pixel's planar depth as a distance along the ray; +inf no surface."""
    height, width = pictures.shape
    r, c = nearest_pixel(pictures.shape, x, y)
    return float(pictures.depth[(k * height + r) * width + c] * _ray_length(pictures, k, x, y))


@inner(cache=True, nogil=True)
def _ray_length(pictures: _Pictures, k: int, x: float, y: float) -> float:
    """Return the length of the ray through a point of a picture to a planar depth of 1 m, metres."""
    of = pictures.projections[k]
    u, v = (x - of[2]) / of[0], (y - of[3]) / of[1]
    return float(np.sqrt(1.0 + u * u + v * v))


@njit(cache=True, nogil=True)
def _displace(
    view: Ints, x: Floats, y: Floats, distance: Floats, error: Floats, parallax: Floats, offsets_w: Array,
    pictures: _Pictures, around: _Surroundings, R_c_w: Array,
) -> None:  # fmt: skip
    """Add the error of rays that start elsewhere than at the centre; write their parallax."""
    shape, depth, offset = pictures.shape, pictures.depth, np.empty(3)
    for i in range(view.shape[0]):
        k, parallax[i] = view[i], 0.0
        if k < 0:
            continue
        fx, fy = pictures.projections[k, 0], pictures.projections[k, 1]
        focal = max(fx, fy)
        for j in range(3):  # by hand: a product of matrices takes a second to compile
            R, at = R_c_w[k, j], offsets_w[i]
            offset[j] = R[0] * at[0] + R[1] * at[1] + R[2] * at[2]
        px, py = np.float64(x[i]), np.float64(y[i])
        dx, dy = px - pictures.projections[k, 2], py - pictures.projections[k, 3]
        u, v = dx / fx, dy / fy
        length = np.sqrt(1.0 + u * u + v * v)
        along = (offset[0] * u + offset[1] * v + offset[2]) / length
        size = np.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
        aside = np.sqrt(max(0.0, size * size - along * along))
        r, c = nearest_pixel(shape, px, py)
        near = max(around.least[k, r, c], LEAST_M)
        parallax[i] = _MARGIN * aside / (near * length)
        first = k * shape[0] * shape[1]
        point = surface_point(depth, first, shape, px, py, fx, pictures.precision)
        if point.inverse > 0.0:
            a, b, e = plane_of(point.inverse, point.across, point.down, dx, dy, fx, fy)
            shift = abs(a * offset[0] + b * offset[1] + e * offset[2])
            right = fx * (offset[0] - u * offset[2]) * point.inverse  # px to where the pixel's own ray passes
            below = fy * (offset[1] - v * offset[2]) * point.inverse
            there = surface_point(depth, first, shape, px + right, py + below, fx, pictures.precision)
            if there.inverse > 0.0:  # a curved surface has another slope there
                a, b, e = plane_of(there.inverse, there.across, there.down, dx + right, dy + below, fx, fy)
                shift = max(shift, abs(a * offset[0] + b * offset[1] + e * offset[2]))
            error[i] += distance[i] * (_CURVED * shift + _SLOPE_ERRORS * point.error * focal * aside)
        if around.edge_px[k, r, c] <= parallax[i] * focal * length * length + _AHEAD_PX:
            error[i] += _MARGIN * (around.most[k, r, c] - around.least[k, r, c]) * length + size


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


@njit(cache=True, nogil=True)
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
