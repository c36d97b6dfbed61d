"""Narrow views that capture given rays for the least price. Edges of rooms lie on great circles.

The rays where an image doubts itself crowd along edges, and a straight edge is a straight line in every view.
So a view a few pixels high and as long as the edge captures it as finely as wanted, at a small part of the
price of a face. Views are chosen one after the other, each for the most rays at its price (a greedy set
cover).
"""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from omniscv.compiled import njit
from omniscv.geometry import Array, Pose, pinhole
from omniscv.geometry.arrays import Floats, Ints, Mask
from omniscv.planning.rays import looking
from omniscv.planning.views import FACE_BORDER_PX, LEAST_HALF, holding_size
from omniscv.render_options import LARGEST_FACE_PX, Price
from omniscv.sources.base import Capabilities, View

_POINTS = 1000  # rays among which views are chosen
_CIRCLES = 400  # great circles that are tried
_NEARLY = 0.97  # of the best ratio: good enough
_NEAREST, _FARTHEST = np.cos(np.radians((3.0, 70.0)))  # two rays that define one
_STEPS = 720  # of a circle, at which windows start
_LENGTHS = np.array((6, 12, 24, 40, 60, 90, 120, 160, 200))  # of windows, steps
_SPANS = 2 * np.pi / _STEPS * _LENGTHS
_HIGHEST = np.radians(50.0)  # half the height of a view
_NOTHING = 1e-9  # worth at a price, ms: rounding
_ALL = -1  # circles
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


def patches(  # noqa: PLR0915 - one search, whose state every step changes
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
    directions = doubt.directions_w
    band = _BAND_PX / float(np.median(doubt.focal_px))
    stride = max(1, len(directions) // _POINTS)
    points = np.ascontiguousarray(directions[::stride])
    alive = worth[::stride].astype(np.float64)
    left = np.ones(len(directions), np.bool_)
    axes = _axes(points)
    heights = np.minimum(np.array(_HEIGHTS) * band / 2, _HIGHEST)
    # By height and length of a view; infinite where it would be too large.
    across = 2 * (focal_px * np.tan(_SPANS / 2) + FACE_BORDER_PX)
    down = 2 * (focal_px * np.tan(heights)[:, None] / np.cos(_SPANS / 2) + FACE_BORDER_PX)
    prices = modes * price.of(1, across * down)
    prices[(across > LARGEST_FACE_PX) | (down > LARGEST_FACE_PX)] = np.inf
    limits = np.sin(heights), prices, _LENGTHS
    ratios = np.zeros(len(axes))
    windows = np.zeros((len(axes), 3), np.int64)
    find_windows = _best_windows.prepare(points, alive, axes, *limits, ratios, windows)
    find_windows(_ALL)
    queue = list(zip(-ratios, range(len(axes)), strict=True))
    heapq.heapify(queue)
    while queue and queue[0][0] < -_NOTHING:
        _, k = heapq.heappop(queue)
        find_windows(k)
        ratio = ratios[k]
        step, height, span = windows[k]
        if ratio <= _NOTHING:
            continue
        heapq.heappush(queue, (-ratio, k))
        if ratio < -queue[0][0] * _NEARLY:
            continue
        start = 2 * np.pi / _STEPS * step
        window = axes[k], start, heights[height], _SPANS[span]
        alive[_inside(points, *window)] = 0
        rows = np.flatnonzero(left)
        rows = rows[_inside(directions[rows], *window)]
        if len(rows):
            normal, a, b = axes[k]
            azimuth = start + _SPANS[span] / 2
            middle = a * np.cos(azimuth) + b * np.sin(azimuth)
            R_w_c, (width, height) = _around(directions[rows], middle, normal, focal_px, capabilities)
            view = View(Pose(doubt.center_w, R_w_c), pinhole.fov_deg(width, focal_px), width, height)
            half = (np.array([width, height]) / 2 - FACE_BORDER_PX) / focal_px  # it may serve these
            waiting_rows = np.flatnonzero(left)
            rows = waiting_rows[held(directions[waiting_rows], R_w_c, half)]
            left[rows] = False
            alive[held(points, R_w_c, half)] = 0
            cost = modes * price.of(1, width * height)
            yield Patch(view, doubt.center, doubt.pixels[rows], float(worth[rows].sum()), cost)
        waiting = alive > 0
        if waiting.all():  # azimuths are approximate: at worst none of the window's rays lies in it
            queue = [entry for entry in queue if entry[1] != k]
            heapq.heapify(queue)
        points = points[waiting]
        alive = alive[waiting]
        find_windows = _best_windows.prepare(points, alive, axes, *limits, ratios, windows)


def _around(
    rays: Array, middle: Array, normal: Array, focal_px: float, capabilities: Capabilities
) -> tuple[Array, tuple[int, int]]:
    """Return R_w_c and the size of a view around rays near a great circle.

    Args:
        rays: (N, 3) unit.
        middle: (3,) of the window in which they lie.
        normal: (3,) of the circle's plane.
        focal_px: of the view.
        capabilities: of the source.
    """
    R_w_c, half = looking(rays, middle, normal)
    if not np.isfinite(half).all():  # a few rays are far off: centred on them, it loses others
        R_w_c, half = looking(rays, middle, normal, steps=1)
    half = np.maximum(half, (LEAST_HALF, 0.0))
    return R_w_c, holding_size(half, focal_px, FACE_BORDER_PX, capabilities)


def _axes(points: Array) -> Array:
    """Return (C, 3, 3) great circles through pairs of rays, the same for the same rays: the axis of each, and
    two unit vectors in its plane, from which azimuths count."""
    rng = np.random.default_rng(0)
    first, second = rng.integers(len(points), size=(2, 8 * _CIRCLES))
    a = points[first]
    b = points[second]
    cosine = (a * b).sum(axis=1)
    near = (cosine < _NEAREST) & (cosine > _FARTHEST)
    normals = np.cross(a[near], b[near])[:_CIRCLES]
    # A single ray, or rays all in one place: any circle through them.
    alone = points[rng.integers(len(points), size=16)]
    normals = np.concatenate([normals, np.cross(alone, rng.normal(size=(16, 3)))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    across = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([normals, across, np.cross(normals, across)], axis=1)


@njit(nogil=True, forceinline=True, error_model="numpy")
def _turns(a: float, b: float) -> float:
    """Return the azimuth of (a, b) in turns, 0 to 1, to 0.0007: half of a step."""
    steep = abs(b) > abs(a)
    ratio = a / b if steep else b / a
    eighth = ratio * (0.125 + 0.0434 * (1.0 - abs(ratio)))
    if steep:
        return (0.25 if b > 0.0 else 0.75) - eighth
    return 0.5 + eighth if a < 0.0 else (1.0 + eighth) % 1.0


@njit(
    "float64[:, ::1], float64[::1], float64[:, :, ::1], float64[::1], float64[:, ::1], int64[::1], "
    "out float64[::1], out int64[:, ::1], int64",
    nogil=True,
    error_model="numpy",
)
def _best_windows(  # noqa: C901, PLR0912, PLR0915 - a kernel
    points: Array,
    worth: Array,
    axes: Array,
    heights: Array,
    prices: Array,
    lengths: Ints,
    ratios: Array,
    windows: Ints,
    which: int,
) -> None:
    """Write (C,) the most worth at a price on each circle, and (C, 3) where: the step of its start, height,
    length. ``which`` is one circle, or :data:`_ALL`. Rays are (N, 3), their worth (N,), axes (C, 3, 3);
    heights (H,) are sines of half a window's, prices (H, S) and lengths (S,), in steps, those of windows."""
    before, by_step = np.empty(2 * _STEPS + 1), np.empty((len(heights), _STEPS))
    starts = np.empty(_STEPS, np.int64)
    first = max(which, 0)
    last = len(axes) if which == _ALL else which + 1
    for k in range(first, last):
        ratios[k] = 0.0
        windows[k, 0] = windows[k, 1] = windows[k, 2] = 0
        for h in range(len(heights)):
            for step in range(_STEPS):
                by_step[h, step] = 0.0
        for i in range(len(points)):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            off = abs(axes[k, 0, 0] * x + axes[k, 0, 1] * y + axes[k, 0, 2] * z)
            if off <= heights[-1] and worth[i] > 0.0:
                a = axes[k, 1, 0] * x + axes[k, 1, 1] * y + axes[k, 1, 2] * z
                b = axes[k, 2, 0] * x + axes[k, 2, 1] * y + axes[k, 2, 2] * z
                h = 0
                while off > heights[h]:
                    h += 1
                by_step[h, int(_turns(a, b) * _STEPS) % _STEPS] += worth[i]
        for h in range(len(heights)):
            count, before[0] = 0, 0.0  # a window is worth most where it starts at a ray
            for step in range(_STEPS):
                if h > 0:
                    by_step[h, step] += by_step[h - 1, step]
                before[step + 1] = before[step] + by_step[h, step]
                if by_step[h, step] > 0.0:
                    starts[count] = step
                    count += 1
            for step in range(_STEPS, 2 * _STEPS):
                before[step + 1] = before[step] + by_step[h, step - _STEPS]
            for s in range(len(lengths)):
                least = ratios[k] * prices[h, s]
                if before[_STEPS] <= least:  # not even all of the band is worth more
                    continue
                most, start = least, -1
                for j in range(count):
                    total = before[starts[j] + lengths[s]] - before[starts[j]]
                    if total > most:
                        most, start = total, starts[j]
                if start >= 0:
                    ratios[k] = most / prices[h, s]
                    windows[k, 0], windows[k, 1], windows[k, 2] = start, h, s
        if ratios[k] > 0.0:  # its rays are set in the middle: azimuths are approximate
            start, h, empty = windows[k, 0], windows[k, 1], 0
            end = start + lengths[windows[k, 2]] - 1
            while by_step[h, (end - empty) % _STEPS] == 0.0:
                empty += 1
            windows[k, 0] = (start - empty // 2) % _STEPS


def _inside(directions: Array, axes: Array, start: float, height: float, span: float) -> Mask:
    """Return (N,) whether rays are in a window of a circle's band."""
    off, x, y = axes @ directions.T
    apart = (np.arctan2(y, x) - start) % (2 * np.pi)
    along = (apart <= span + 1e-9) | (apart >= 2 * np.pi - 1e-9)
    return np.asarray(along & (np.abs(off) <= np.sin(height) + 1e-12))


def held(directions: Array, R_w_c: Array, half: Array) -> Mask:
    """Return (N,) whether a view holds rays.

    Args:
        directions: (N, 3) world frame, of any length.
        R_w_c: (3, 3) from the view's frame to the world.
        half: (2,) tangents from its axis to its sides.
    """
    inside = np.empty(len(directions), np.bool_)
    _hold(directions, R_w_c, half, inside)
    return inside


@njit("float64[:, ::1], float64[:, :], float64[::1], out bool[::1]", nogil=True)
def _hold(directions: Array, R_w_c: Array, half: Array, inside: Mask) -> None:
    R = R_w_c
    for i in range(len(directions)):
        a, b, c = directions[i, 0], directions[i, 1], directions[i, 2]
        x, y = a * R[0, 0] + b * R[1, 0] + c * R[2, 0], a * R[0, 1] + b * R[1, 1] + c * R[2, 1]
        z = a * R[0, 2] + b * R[1, 2] + c * R[2, 2]
        inside[i] = (z > 0.0) & (abs(x) <= half[0] * z) & (abs(y) <= half[1] * z)
