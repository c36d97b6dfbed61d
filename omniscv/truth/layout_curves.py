"""Straight edges as the curves that a camera, central or not, sees of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.geometry.pose import Array

SPACING_PX = 0.5
"""Neighbouring samples of a curve are at most so far apart."""

RESOLVED_M = 5e-7
"""The ray of a sample's pixel passes the sample at most so far away."""

_AIM_PX = 0.42  # less, so that most curves need one round
_COARSE_PX = 8  # what shows of a curve for less than this at the image's middle may be missed
_COARSE = np.radians([0.01, 1.0])  # but no less, and no more
_FINEST = 1e-9  # rad: where a curve breaks off is found to this
_MOST_PARTS = 16
_PARALLEL = 1e-9  # rad between the rays of neighbouring pixels
_DECIMALS = 8  # of pixels in px, as files have them
_THINNEST_PX = 0.04  # of samples that crowd where a curve breaks off, one in so much is kept
_LEAST_DISTANCE = 1e-2  # of an edge's length: an edge through the camera has no steps of equal angle


@dataclass(frozen=True, eq=False)
class Samples:
    """Points of edges that a camera sees, edge by edge, along each.

    Attributes:
        edge: (S,) which edge.
        points_c: (S, 3) metres, camera frame.
        pixels: (S, 2) px, rounded as files have them.
        origins_c: (S, 3) metres, camera frame, of the pixels' rays.
        joined: (S,) bool, the next sample continues the curve: it lies within ``SPACING_PX``.
    """

    edge: NDArray[np.intp]
    points_c: Array
    pixels: Array
    origins_c: Array
    joined: NDArray[np.bool_]


def sample_edges(camera: Camera, starts_c: Array, ends_c: Array) -> Samples:
    """Return samples of straight edges, so near to each other that the curves between them are known.

    Curves break off where the camera no longer sees the edge, and where neighbours stay apart however near
    they are on the edge: at the seam of a panorama.

    Args:
        camera: what sees them.
        starts_c, ends_c: (E, 3) metres, camera frame.
    """
    edges = _Edges(starts_c, ends_c)
    edge, angle = edges.coarse(float(np.clip(_COARSE_PX * radians_per_pixel(camera), *_COARSE)))
    pixels, valid = camera.project(edges.points(edge, angle))
    while True:
        parts = _parts(edge, angle, pixels, valid)
        wide = np.flatnonzero(parts > 1)
        if not wide.size:
            break
        more_edge, more_angle = _between(edge, angle, wide, parts[wide])
        more_pixels, more_valid = camera.project(edges.points(more_edge, more_angle))
        edge, angle = np.concatenate([edge, more_edge]), np.concatenate([angle, more_angle])
        pixels, valid = np.concatenate([pixels, more_pixels]), np.concatenate([valid, more_valid])
        order = np.lexsort((angle, edge))
        edge, angle, pixels, valid = edge[order], angle[order], pixels[order], valid[order]
    return _samples(camera, edge, edges.points(edge, angle), pixels)


def resolved(camera: Camera, points_c: Array, pixels: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return what of projected points the pixels resolve; at the tip of a cone, they do not.

    Args:
        camera: what sees them.
        points_c: (S, 3) metres, camera frame.
        pixels: (S, 2) px, as the camera projects the points.

    Returns:
        (S, 2) the pixels as files have them, (S, 3) the origins of their rays, metres, camera frame, and (S,)
        whether those rays pass the points within ``RESOLVED_M``.
    """
    rounded = np.round(pixels, _DECIMALS)
    rays = camera.unproject(rounded)
    with np.errstate(invalid="ignore"):
        off = np.linalg.norm(np.cross(points_c - rays.origins, rays.directions), axis=-1)
    return rounded, rays.origins, np.asarray(off <= RESOLVED_M)


def _samples(camera: Camera, edge: NDArray[np.intp], points_c: Array, pixels: Array) -> Samples:
    """The samples that are seen, without those that crowd where a curve breaks off."""
    pixels, origins_c, seen = resolved(camera, points_c, pixels)
    gaps = _gaps(pixels)
    near = seen[1:] & seen[:-1] & (edge[1:] == edge[:-1]) & (gaps <= SPACING_PX)
    joined, continued = np.append(near, False), np.append(False, near)
    step = np.floor(np.cumsum(np.append(0.0, np.where(near, gaps, 0.0))) / _THINNEST_PX)
    kept = seen & (~joined | ~continued | (np.diff(step, prepend=-1) > 0))
    return Samples(edge[kept], points_c[kept], pixels[kept], origins_c[kept], joined[kept])


class _Edges:
    """Edges in steps of equal angle, as the camera's origin sees them."""

    def __init__(self, starts_c: Array, ends_c: Array) -> None:
        self._start, along = starts_c, ends_c - starts_c
        self._length = np.linalg.norm(along, axis=-1)
        self._direction = along / self._length[:, None]
        self._nearest = -(starts_c * self._direction).sum(axis=-1)
        away = np.linalg.norm(starts_c + self._nearest[:, None] * self._direction, axis=-1)
        self._away = np.maximum(away, _LEAST_DISTANCE * self._length)

    def coarse(self, step: float) -> tuple[NDArray[np.intp], Array]:
        """Edge and angle of the first samples: both ends, and steps of so many radians or less."""
        first = np.arctan2(-self._nearest, self._away)
        last = np.arctan2(self._length - self._nearest, self._away)
        counts = np.ceil((last - first) / step).astype(int) + 1
        angles = [np.linspace(*ends) for ends in zip(first, last, counts, strict=True)]
        return np.repeat(np.arange(len(counts)), counts), np.concatenate(angles)

    def points(self, edge: NDArray[np.intp], angle: Array) -> Array:
        """(S, 3) metres, camera frame."""
        along = np.clip(self._nearest[edge] + self._away[edge] * np.tan(angle), 0, self._length[edge])
        return np.asarray(self._start[edge] + along[:, None] * self._direction[edge])


def radians_per_pixel(camera: Camera) -> float:
    """Return what a pixel takes at the image's middle, to the right of it; of a panorama, 2 pi / width.

    Not across the middle itself: the tip of a cone has no ray, and opposite ones on its sides. A camera whose
    rays are parallel is given a panorama's pixels.
    """
    center = camera.center if camera.valid(camera.center) else [camera.width / 2, camera.height / 2]
    steps = np.column_stack([np.arange(camera.width // 2 + 1) + 0.5, np.zeros(camera.width // 2 + 1)])
    rays = camera.unproject(np.asarray(center) + steps)
    first = int(np.argmax(rays.valid[1:] & rays.valid[:-1]))
    a, b = rays.directions[first : first + 2]
    turn = float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
    return turn if turn > _PARALLEL else 2 * np.pi / camera.width


def _gaps(pixels: Array) -> Array:
    """(S - 1,) px between neighbours; NaN where one has no pixel."""
    return np.asarray(np.linalg.norm(np.diff(pixels, axis=0), axis=-1))


def _parts(edge: NDArray[np.intp], angle: Array, pixels: Array, valid: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(S - 1,) into how many parts to cut the intervals between neighbours; 1 for those to keep."""
    gaps, both = _gaps(pixels), valid[1:] & valid[:-1]
    parts = np.where(both, np.clip(np.ceil(gaps / _AIM_PX), 2, _MOST_PARTS), _MOST_PARTS)
    fine = np.where(both, gaps <= SPACING_PX - _THINNEST_PX, valid[1:] == valid[:-1])
    fine |= (edge[1:] != edge[:-1]) | (np.diff(angle) <= _FINEST)
    parts[fine] = 1
    return parts.astype(np.intp)


def _between(
    edge: NDArray[np.intp], angle: Array, wide: NDArray[np.intp], parts: NDArray[np.intp]
) -> tuple[NDArray[np.intp], Array]:
    """Edge and angle of new samples that cut intervals ``wide`` into equal parts."""
    count = parts - 1
    step = np.arange(1, count.sum() + 1) - np.repeat(np.cumsum(count) - count, count)
    which = np.repeat(wide, count)
    share = step / np.repeat(parts, count)
    return edge[which], angle[which] + share * (angle[which + 1] - angle[which])
