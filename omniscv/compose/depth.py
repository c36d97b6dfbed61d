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
from omniscv.geometry.surfaces import Precision, discontinuities, surface_point
from omniscv.sources.base import View

NEAR_PLANE_M = 0.1
"""Engines draw nothing that is nearer."""
_AHEAD_PX = 1.5
"""The parallax is measured from the nearest pixel, and an edge lies within one of what shows it."""
_SLOPE_ERRORS = 2.0
"""The slope between two pixels is off by both their errors."""
_MARGIN = 1.3
"""A neighbouring surface goes on between the pixels that show it."""


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


@njit(cache=True, nogil=True)
def _sample(
    view: Ints, x: Floats, y: Floats, distance: Floats, error: Floats,
    stack: Floats, focal: Array, nearest: bool, precision: Precision,
) -> None:  # fmt: skip
    height, width = stack.shape[1], stack.shape[2]
    face, last = stack[0], 0
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            distance[i] = error[i] = 0.0
            continue
        if k != last:  # a slice counts its references, which takes longer than what it is sliced for
            face, last = stack[k], k
        u, v = (x[i] - width / 2) / focal[k], (y[i] - height / 2) / focal[k]
        length = np.sqrt(1.0 + u * u + v * v)
        point = surface_point(face, x[i], y[i], focal[k], precision)
        if point.inverse == 0.0:
            distance[i] = np.inf
            error[i] = np.inf if point.jump > 0.0 or precision.largest_m < np.inf else 0.0
            continue
        z = 1.0 / point.inverse
        off = z * z * point.error + _MARGIN * point.jump
        if nearest:
            c = min(max(int(np.floor(x[i])), 0), width - 1)
            r = min(max(int(np.floor(y[i])), 0), height - 1)
            off += abs(face[r, c] - z)
            z = face[r, c]
        distance[i], error[i] = z * length, off * length


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
