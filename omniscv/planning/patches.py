"""Narrow views that capture given rays for the least price. Edges of rooms lie on great circles.

The rays where an image doubts itself crowd along edges, and a straight edge is a straight line in every view.
So a view a few pixels high and as long as the edge captures it as finely as wanted, at a small part of the
price of a face. Views are chosen one after the other, each for the most rays at its price (a greedy set
cover).
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from omniscv.compiled import njit
from omniscv.geometry import Array, Pose, pinhole
from omniscv.geometry.arrays import Floats, Ints, Mask
from omniscv.planning.cube_faces import FACE_BORDER_PX
from omniscv.planning.strips import LEAST_HALF, holding_size, looking
from omniscv.render_options import LARGEST_FACE_PX, Price
from omniscv.sources.base import Capabilities, View

_POINTS = 2000  # rays among which views are chosen
_CIRCLES = 400  # great circles that are tried
_NEARLY = 0.97  # of the best ratio: good enough
_NEAREST, _FARTHEST = np.cos(np.radians((3.0, 70.0)))  # two rays that define one
_SPANS = np.radians((3.0, 6.0, 12.0, 20.0, 30.0, 45.0, 60.0, 80.0, 100.0))
_NOTHING = 1e-9  # worth at a price, ms: rounding
_BAND_PX = 4.0  # of a capture: the width of the bands in which pixels in doubt crowd
_HEIGHTS = (1.0, 2.0, 4.0, 10.0, 25.0, 64.0)  # of the narrowest views


@dataclass(frozen=True)
class Doubt:
    """Pixels in doubt that are captured from one centre.

    Attributes:
        center: its number.
        center_w: (3,) world frame, metres.
        pixels: (N,) flat indices; a pixel may be there more than once.
        directions_w: (N, 3) unit, from the centre, where finer captures help.
        focal_px: (N,) of what is captured there.
    """

    center: int
    center_w: Array
    pixels: Ints
    directions_w: Array
    focal_px: Floats


@dataclass(frozen=True, eq=False)
class Patch:
    """A view, and the pixels in doubt that it captures finer.

    Attributes:
        view: with its border.
        center: its number.
        pixels: (N,) flat indices.
        worth: of these pixels.
        price: of its captures, ms.
    """

    view: View
    center: int
    pixels: Ints
    worth: float
    price: float


def patches(
    doubt: Doubt, worth: Array, focal_px: float, modes: int, price: Price, capabilities: Capabilities
) -> Iterator[Patch]:
    """Yield views and their pixels, those first that are worth the most at their price; each pixel at most
    once.

    Args:
        doubt: the pixels, and their rays.
        worth: (N,) of each, >= 0.
        focal_px: of the views, px per radian.
        modes: how many captures a view takes.
        price: of a capture.
        capabilities: of the source.
    """
    directions, band = doubt.directions_w, _BAND_PX / float(np.median(doubt.focal_px))
    stride = max(1, len(directions) // _POINTS)
    points = np.ascontiguousarray(directions[::stride])
    alive, left = worth[::stride].astype(np.float64), np.ones(len(directions), np.bool_)
    normals = _normals(points)
    heights = np.array(_HEIGHTS) * band / 2
    # By height and length of a view; infinite where it would be too large.
    across = 2 * (focal_px * np.tan(_SPANS / 2) + FACE_BORDER_PX)
    down = 2 * (focal_px * np.tan(heights)[:, None] / np.cos(_SPANS / 2) + FACE_BORDER_PX)
    prices = modes * price.of(1, across * down)
    prices[(across > LARGEST_FACE_PX) | (down > LARGEST_FACE_PX)] = np.inf
    windows = np.zeros((len(normals), 4))
    _best_windows(points, alive, normals, heights, prices, _SPANS, windows)
    queue = [(-windows[k, 0], k) for k in range(len(normals))]
    heapq.heapify(queue)
    while queue and queue[0][0] < -_NOTHING:
        _, k = heapq.heappop(queue)
        again = np.zeros((1, 4))
        _best_windows(points, alive, normals[k : k + 1], heights, prices, _SPANS, again)
        ratio, start, height, span = again[0]
        if ratio <= _NOTHING:
            continue
        heapq.heappush(queue, (-ratio, k))
        if ratio < -queue[0][0] * _NEARLY:
            continue
        window = normals[k], start, heights[int(height)], _SPANS[int(span)]
        alive[_inside(points, *window)] = 0
        rows = np.flatnonzero(left)
        rows = rows[_inside(directions[rows], *window)]
        if len(rows):
            azimuth, frame = start + _SPANS[int(span)] / 2, np.array(_frame(*normals[k]))
            middle = frame[:3] * np.cos(azimuth) + frame[3:] * np.sin(azimuth)
            R_w_c, half = looking(directions[rows], middle, normals[k])
            half = np.maximum(half, (LEAST_HALF, 0.0))
            width, height = holding_size(half, focal_px, FACE_BORDER_PX, capabilities)
            view = View(Pose(doubt.center_w, R_w_c), pinhole.fov_deg(width, focal_px), width, height)
            half = (np.array([width, height]) / 2 - FACE_BORDER_PX) / focal_px  # it may serve these
            rest = np.flatnonzero(left)
            rows = rest[held(directions[rest], R_w_c, half)]
            left[rows] = False
            alive[held(points, R_w_c, half)] = 0
            cost = modes * price.of(1, width * height)
            points, alive = points[alive > 0], alive[alive > 0]
            yield Patch(view, doubt.center, doubt.pixels[rows], float(worth[rows].sum()), cost)


def _normals(points: Array) -> Array:
    """Return (C, 3) the axes of great circles through pairs of rays, the same for the same rays."""
    rng = np.random.default_rng(0)
    first, second = rng.integers(len(points), size=(2, 8 * _CIRCLES))
    a, b = points[first], points[second]
    cosine = (a * b).sum(axis=1)
    near = (cosine < _NEAREST) & (cosine > _FARTHEST)
    axes = np.cross(a[near], b[near])[:_CIRCLES]
    # A single ray, or rays all in one place: any circle through them.
    some = points[rng.integers(len(points), size=16)]
    more = np.cross(some, rng.normal(size=(16, 3)))
    axes = np.concatenate([axes, more])
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


@njit(cache=True, nogil=True)
def _best_windows(
    points: Array, worth: Array, normals: Array, heights: Array, prices: Array, spans: Array, windows: Array
) -> None:
    """Write for each circle the most worth at a price, and where: azimuth of the start, height, length."""
    azimuths, worths = np.empty(len(points)), np.empty(len(points))
    for k in range(len(normals)):
        nx, ny, nz = normals[k]
        ax, ay, az, bx, by, bz = _frame(nx, ny, nz)
        windows[k] = 0.0
        for h in range(len(heights)):
            limit, count = np.sin(heights[h]), 0
            for i in range(len(points)):
                x, y, z = points[i]
                if worth[i] > 0 and abs(nx * x + ny * y + nz * z) <= limit:
                    azimuths[count] = np.arctan2(bx * x + by * y + bz * z, ax * x + ay * y + az * z)
                    worths[count] = worth[i]
                    count += 1
            order = np.argsort(azimuths[:count])
            ordered, weights = azimuths[order], worths[order]
            for s in range(len(spans)):
                end, total = 0, 0.0
                for start in range(count):
                    while end < count + start:
                        at = ordered[end] if end < count else ordered[end - count] + 2 * np.pi
                        if at > ordered[start] + spans[s]:
                            break
                        total += weights[end % count]
                        end += 1
                    ratio = total / prices[h, s]
                    if ratio > windows[k, 0]:
                        windows[k, 0], windows[k, 1] = ratio, ordered[start]
                        windows[k, 2], windows[k, 3] = h, s
                    total -= weights[start]


@njit(cache=True, nogil=True)
def _frame(nx: float, ny: float, nz: float) -> tuple[float, float, float, float, float, float]:
    """Return two unit vectors across an axis, from which azimuths count."""
    x, y, z = (1.0, 0.0, 0.0) if abs(nx) <= abs(ny) and abs(nx) <= abs(nz) else (
        (0.0, 1.0, 0.0) if abs(ny) <= abs(nz) else (0.0, 0.0, 1.0)
    )  # fmt: skip
    ax, ay, az = ny * z - nz * y, nz * x - nx * z, nx * y - ny * x
    size = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / size, ay / size, az / size
    return ax, ay, az, ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax


def _inside(directions: Array, normal: Array, start: float, height: float, span: float) -> Mask:
    """Return (N,) whether rays are in a window of a circle's band."""
    frame = _frame(*normal)
    azimuth = np.arctan2(directions @ frame[3:], directions @ frame[:3])
    off = (azimuth - start) % (2 * np.pi)
    along = (off <= span + 1e-9) | (off >= 2 * np.pi - 1e-9)
    return np.asarray(along & (np.abs(directions @ normal) <= np.sin(height) + 1e-12))


def held(directions: Array, R_w_c: Array, half: Array) -> Mask:
    """Return (N,) whether a view holds rays within tangents of its axis."""
    x, y, z = (directions @ R_w_c).T
    return np.asarray((z > 0) & (np.abs(x) <= half[0] * z) & (np.abs(y) <= half[1] * z))
