"""The smallest boxes on the sphere around the pixels of objects, for every camera: from rays, not pixels."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from omniscv.cameras import Rays
from omniscv.geometry import Array
from omniscv.truth.spherical import SphericalBox, lon_lat

Labels = NDArray[np.uint16]
DirectionsAt = Callable[[NDArray[np.intp], NDArray[np.intp]], Array]
"""Gives (N, 3) unit directions of the centres of pixels by rows and columns (N,); NaN where not valid."""

_STEPS = 10  # of moving the centre to the middle of what is seen from it
_FRONT = np.cos(np.radians(85))
"""Directions further from the centre than 85 degrees are too wide for a perspective box."""
_SAMPLES = 1000
_SPREADS_DEG = (1.5, 0.2, 0.025)
"""Around the best rotation so far: 17 are tried, an eighth of each apart."""
_BINS = 7200  # of longitude
_AHEAD = 1e-6  # what is not ahead of a box counts as 90 degrees from its centre
_NEXT = 3.0
"""Neighbours are not so many times as far apart as others, but at an end of the image."""


def bfov(mask: NDArray[np.bool_], rays: Rays, *, rotated: bool = False) -> dict[str, Any]:
    """Return the smallest box on the sphere around a mask.

    Args:
        mask: (H, W), some of them set.
        rays: of all pixels, as ``camera.unproject()`` gives them.
        rotated: whether the box may be rotated.

    Returns:
        The record of a :class:`SphericalBox`: ``lon, lat, fov_h, fov_v, rot`` (degrees) and ``kind``.

    Raises:
        ArgumentError: an empty mask, or one of another shape.
    """
    from omniscv.errors import ArgumentError

    if mask.shape != rays.valid.shape or not mask[rays.valid].any():
        got = f"{int(np.count_nonzero(mask))} pixels of shape {mask.shape}"
        raise ArgumentError(f"mask: expected pixels set within the rays' {rays.valid.shape}, got {got}")
    labels = (mask & rays.valid).astype(np.uint16)
    upright, turned = bfovs(labels, lambda rows, columns: rays.directions[rows, columns], wraps(rays))[1]
    return (turned if rotated else upright).to_dict()


def bfovs(
    labels: Labels, directions_at: DirectionsAt, wrap: bool
) -> dict[int, tuple[SphericalBox, SphericalBox]]:
    """Return by id the upright and the rotated box around its pixels.

    Args:
        labels: (H, W) ids; 0 is none.
        directions_at: of the camera.
        wrap: whether the left and the right border are neighbours.
    """
    found, places = {}, ndimage.find_objects(labels)
    for instance, outline in outlines(labels, directions_at, wrap).items():
        place = places[instance - 1]
        rows, columns = np.nonzero(labels[place] == instance)
        rows, columns = rows + place[0].start, columns + place[1].start
        step = -(-len(rows) // _SAMPLES)
        inside = partial(directions_at, rows, columns)
        found[instance] = fit(outline, inside, directions_at(rows[::step], columns[::step]))
    return found


def wraps(rays: Rays) -> bool:
    """Whether the first and the last column of an image are neighbours."""
    if rays.valid.shape[1] < 3:
        return False
    first, second, last = (rays.directions[:, i] for i in (0, 1, -1))
    with np.errstate(invalid="ignore"):
        step, seam = np.linalg.norm(first - second, axis=-1), np.linalg.norm(first - last, axis=-1)
        return bool((seam <= _NEXT * step).any())


def outlines(labels: Labels, directions_at: DirectionsAt, wrap: bool) -> dict[int, Array]:
    """Return by id (N, 3) unit directions on the outline of its pixels.

    Half way between a pixel inside and its neighbour outside; where there is none, at an end of the image or
    of the field of view, the pixel's own.
    """
    height, width = labels.shape
    pairs = []
    for axis in (0, 1):
        border = labels != np.roll(labels, -1, axis)
        if axis == 0:
            border[-1] = False
        elif not wrap:
            border[:, -1] = False
        rows, columns = np.nonzero(border)
        pairs.append((rows, columns, (rows + (axis == 0)) % height, (columns + (axis == 1)) % width))
    r0, c0, r1, c1 = (np.concatenate(each) for each in zip(*pairs, strict=True))
    ends = np.zeros(labels.shape, bool)
    ends[[0, -1]] = True
    if not wrap:
        ends[:, [0, -1]] = True
    re, ce = np.nonzero(ends & (labels > 0))
    own_rows, own_columns = np.concatenate([r0, r1, re]), np.concatenate([c0, c1, ce])
    owners = labels[own_rows, own_columns]
    both = directions_at(np.concatenate([r0, r1]), np.concatenate([c0, c1]))
    a, b = both[: len(r0)], both[len(r0) :]
    at_ends = directions_at(re, ce)
    middle = np.where(np.isnan(a), b, np.where(np.isnan(b), a, a + b))
    points = np.concatenate([middle, middle, at_ends])
    kept = (owners > 0) & ~np.isnan(points[:, 0])
    owners, points = owners[kept], points[kept]
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    order = np.argsort(owners, kind="stable")
    found, starts = np.unique(owners[order], return_index=True)
    return dict(zip(found.tolist(), np.split(points[order], starts[1:]), strict=True))


def fit(outline: Array, inside: Callable[[], Array], samples: Array) -> tuple[SphericalBox, SphericalBox]:
    """Return the upright and the rotated box around an object.

    Args:
        outline: (N, 3) unit directions.
        inside: gives (M, 3) those of all its pixels.
        samples: (K, 3) some of these.
    """
    middle = samples.mean(axis=0) + outline.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    if min((outline @ middle).min(), (samples @ middle).min()) < _FRONT:
        wide = _lonlat(inside())
        return wide, wide
    hull = _hull(outline, middle)
    upright = _at(hull, middle, np.zeros(1))
    rotated = _at(hull, middle, np.radians(np.arange(-45.0, 45.0, 1.5)))
    for spread in _SPREADS_DEG:
        turns = np.radians(rotated.rot + spread * np.linspace(-1, 1, 17))
        rotated = _at(hull, middle, turns)
    return upright, (rotated if rotated.area < upright.area else upright)


def _hull(points: Array, middle: Array) -> Array:
    """Those of the directions (N, 3), all in front of ``middle``, that span the others."""
    right = np.cross(middle, np.eye(3)[np.abs(middle).argmin()])
    right /= np.linalg.norm(right)
    plane = points @ np.stack([right, np.cross(middle, right)], axis=1) / (points @ middle)[:, None]
    try:
        return points[ConvexHull(plane).vertices]
    except (QhullError, ValueError):  # all in a line
        return points


def _at(points: Array, middle: Array, turns: Array) -> SphericalBox:
    """Return the smallest of the boxes around directions (N, 3) with some rotations (T,), radians."""
    lon, lat, half_h, half_v = _around(points, middle, turns)
    best = int((np.sin(half_h) * np.sin(half_v)).argmin())
    angles = np.degrees([each[best] for each in (lon, lat, 2 * half_h, 2 * half_v, turns)])
    return SphericalBox(*angles.tolist())


@njit(cache=True, nogil=True)
def _around(points: Array, middle: Array, turns: Array) -> Array:
    """Return (4, T): longitude and latitude of a box's centre, half its width and height, for each rotation.

    The centre is moved to the middle of what is seen from it, ``_STEPS`` times.
    """
    found = np.empty((4, len(turns)))
    for i in range(len(turns)):
        center = middle.copy()
        for _ in range(_STEPS + 1):
            lon = np.arctan2(center[0], center[2])
            lat = np.arctan2(-center[1], np.hypot(center[0], center[2]))
            frame = _frame(lon, lat, turns[i])
            left, right, top, bottom = _extent(points, frame)
            across, down = np.tan((left + right) / 2), np.tan((top + bottom) / 2)
            center = across * frame[0] + down * frame[1] + frame[2]
        found[:, i] = lon, lat, max(-left, right), max(-top, bottom)
    return found


@njit(cache=True, nogil=True)
def _extent(points: Array, frame: Array) -> tuple[float, float, float, float]:
    """Return the least and the most angle across, and down, of directions (N, 3) in a frame, radians."""
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    for n in range(len(points)):
        x, y, z = points[n]
        ahead = max(frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z, _AHEAD)
        across = (frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z) / ahead
        down = (frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z) / ahead
        left, right = min(left, across), max(right, across)
        top, bottom = min(top, down), max(bottom, down)
    return np.arctan(left), np.arctan(right), np.arctan(top), np.arctan(bottom)


@njit(cache=True, nogil=True)
def _frame(lon: float, lat: float, rot: float) -> Array:
    """Return (3, 3) right, down and forward, row by row, of :func:`omniscv.truth.spherical.frames`."""
    sl, cl, sp, cp, sr, cr = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat), np.sin(rot), np.cos(rot)
    frame = np.empty((3, 3))
    frame[0] = cr * cl + sr * sp * sl, sr * cp, -cr * sl + sr * sp * cl
    frame[1] = cr * sp * sl - sr * cl, cr * cp, cr * sp * cl + sr * sl
    frame[2] = cp * sl, -sp, cp * cl
    return frame


def _lonlat(directions: Array) -> SphericalBox:
    """Return the smallest range of longitudes, and of latitudes, of directions (N, 3)."""
    lon, lat = (np.degrees(each) for each in lon_lat(directions))
    occupied = np.flatnonzero(np.bincount(((lon + 180) / 360 * _BINS).astype(int) % _BINS, minlength=_BINS))
    gaps = np.diff(occupied, append=occupied[0] + _BINS)
    widest = int(gaps.argmax())
    start, across = occupied[(widest + 1) % len(occupied)], _BINS - gaps[widest] + 1
    low, high = float(lat.min()), float(lat.max())
    if across >= _BINS * 0.99:
        start, across = 0, _BINS
    middle = (start + across / 2) / _BINS * 360 - 180
    return SphericalBox(
        float((middle + 180) % 360 - 180), (low + high) / 2, across / _BINS * 360, high - low, 0.0, "lonlat"
    )
