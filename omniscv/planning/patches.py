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
from omniscv.geometry.arrays import Ints, Mask
from omniscv.planning.strips import LEAST_HALF, holding_size, looking
from omniscv.render_options import LARGEST_FACE_PX, Price
from omniscv.sources.base import Capabilities, View

_POINTS = 2000  # rays among which views are chosen
_CIRCLES = 400  # great circles that are tried
_NEARLY = 0.97  # of the best ratio: good enough
_NEAREST, _FARTHEST = np.cos(np.radians((3.0, 70.0)))  # two rays that define one
_SPANS = np.radians((3.0, 6.0, 12.0, 20.0, 30.0, 45.0, 60.0, 80.0, 100.0))
_NOTHING = 1e-9  # worth at a price, ms: rounding
_HEIGHTS = (1.0, 2.0, 4.0, 10.0, 25.0, 64.0)  # of the narrowest views


@dataclass(frozen=True, eq=False)
class Patch:
    """A view, and the rays that it serves.

    Attributes:
        view: with its border.
        rows: (N,) indices of the rays.
        worth: of these rays.
        price: of its captures, ms.
    """

    view: View
    rows: Ints
    worth: float
    price: float


@dataclass(frozen=True)
class Precision:
    """How finely patches are captured.

    Attributes:
        focal_px: px per radian.
        border_px: around every ray.
        band: radians, about how wide the bands are in which rays crowd.
        modes: how many captures a view takes.
    """

    focal_px: float
    border_px: int
    band: float
    modes: int


def patches(
    center_w: Array,
    directions: Array,
    worth: Array,
    fine: Precision,
    price: Price,
    capabilities: Capabilities,
) -> Iterator[Patch]:
    """Yield views and their rays, those first that are worth the most at their price; each ray at most once.

    Args:
        center_w: (3,) the views' centre, metres.
        directions: (N, 3) unit, world frame.
        worth: (N,) of a ray, >= 0.
        fine: how finely they are captured.
        price: of a capture.
        capabilities: of the source.
    """
    stride = max(1, len(directions) // _POINTS)
    points = np.ascontiguousarray(directions[::stride])
    alive, left = worth[::stride].astype(np.float64), np.ones(len(directions), np.bool_)
    normals = _normals(points)
    heights = np.array(_HEIGHTS) * fine.band / 2
    prices = _prices(heights, fine, price)
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
            middle = _along(normals[k], start + _SPANS[int(span)] / 2)
            view, R_w_c, half = _view(center_w, directions[rows], middle, normals[k], fine, capabilities)
            rest = np.flatnonzero(left)
            rows = rest[held(directions[rest], R_w_c, half)]
            left[rows] = False
            alive[held(points, R_w_c, half)] = 0
            cost = fine.modes * price.of(1, view.width * view.height)
            points, alive = points[alive > 0], alive[alive > 0]
            yield Patch(view, rows, float(worth[rows].sum()), cost)


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


def _prices(heights: Array, fine: Precision, price: Price) -> Array:
    """Return (H, S) the price of a view by its height and length; infinite where it would be too large."""
    half = _SPANS / 2
    width = 2 * (fine.focal_px * np.tan(half) + fine.border_px)
    height = 2 * (fine.focal_px * np.tan(heights)[:, None] / np.cos(half) + fine.border_px)
    prices = fine.modes * price.of(1, width * height)
    return np.where((width > LARGEST_FACE_PX) | (height > LARGEST_FACE_PX), np.inf, prices)


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


def _along(normal: Array, azimuth: float) -> Array:
    """Return the direction of a circle at an azimuth."""
    frame = np.array(_frame(*normal))
    return np.asarray(frame[:3] * np.cos(azimuth) + frame[3:] * np.sin(azimuth))


def _view(
    center_w: Array, rays: Array, middle: Array, normal: Array, fine: Precision, capabilities: Capabilities
) -> tuple[View, Array, Array]:
    """Return the view of rays, its orientation, and the tangents within which it may serve rays."""
    R_w_c, half = looking(rays, middle, normal)
    half = np.maximum(half, (LEAST_HALF, 0.0))
    width, height = holding_size(half, fine.focal_px, fine.border_px, capabilities)
    view = View(Pose(center_w, R_w_c), pinhole.fov_deg(width, fine.focal_px), width, height)
    return view, R_w_c, (np.array([width, height]) / 2 - fine.border_px) / fine.focal_px


def held(directions: Array, R_w_c: Array, half: Array) -> Mask:
    """Return (N,) whether a view holds rays within tangents of its axis."""
    x, y, z = (directions @ R_w_c).T
    return np.asarray((z > 0) & (np.abs(x) <= half[0] * z) & (np.abs(y) <= half[1] * z))
