"""The truth ``bfov``: the smallest boxes on the sphere around objects, from the rays of their pixels."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from omniscv.cameras import Rays
from omniscv.compiled import njit
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array
from omniscv.records import NoOptions
from omniscv.truth.registry import Truth, register
from omniscv.truth.spherical import SphericalBox, lon_lat

Labels = NDArray[np.uint16]
DirectionsAt = Callable[[NDArray[np.intp], NDArray[np.intp]], Array]
"""Return (N, 3) unit directions of the centres of pixels by rows and columns (N,); NaN where not valid."""

_STEPS = 10  # iterations that move a box's centre to the middle of the directions as its frame sees them
_FRONT = np.cos(np.radians(85))  # of the angle to the centre from which on a perspective box is too wide
_SPREADS_DEG = (3.0, 0.4, 0.06)  # half ranges of the search for the rotation, of 15 rotations each
_LEAST_Z = 1e-6  # bound on z of directions beside or behind a frame, while its centre is moved
_BINS = 7200  # of longitude
_NEIGHBOURS = 3.0  # columns are neighbours if they are less than so many times as far apart as the first two


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
    if mask.shape != rays.valid.shape or not mask[rays.valid].any():
        pixels = f"{int(np.count_nonzero(mask))} pixels of shape {mask.shape}"
        raise ArgumentError(f"mask: expected pixels set within the rays' {rays.valid.shape}, got {pixels}")
    labels = (mask & rays.valid).astype(np.uint16)
    upright, turned = bfovs(labels, lambda rows, columns: rays.directions[rows, columns], _wraps(rays))[1]
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
    found = {}
    boxes = ndimage.find_objects(labels)
    for instance, outline in _outlines(labels, directions_at, wrap).items():
        box = boxes[instance - 1]
        down, across = np.nonzero(labels[box] == instance)  # from the box's first pixel
        rows = down + box[0].start
        columns = across + box[1].start
        step = max(1, math.isqrt(len(outline)) // 4)
        sampled = (down % step == 0) & (across % step == 0)
        sampled[0] |= not sampled.any()
        fitted = _fit(outline, directions_at(rows[sampled], columns[sampled]))
        if fitted is None:
            wide = _lonlat(directions_at(rows, columns))
            fitted = wide, wide
        found[instance] = fitted
    return found


def _wraps(rays: Rays) -> bool:
    """Whether the first and the last column of an image are neighbours."""
    if rays.valid.shape[1] < 3:
        return False
    first = rays.directions[:, 0]
    second = rays.directions[:, 1]
    last = rays.directions[:, -1]
    with np.errstate(invalid="ignore"):
        step = np.linalg.norm(first - second, axis=-1)
        seam = np.linalg.norm(first - last, axis=-1)
        return bool((seam <= _NEIGHBOURS * step).any())


def _outlines(labels: Labels, directions_at: DirectionsAt, wrap: bool) -> dict[int, Array]:
    """Return by id (N, 3) unit directions on the outline of its pixels: half way between a pixel inside and
    its neighbour outside; the pixel's own at an end of the image or of the view."""
    rows, columns, next_rows, next_columns = _borders(labels, wrap)
    ends = np.zeros(labels.shape, bool)
    ends[[0, -1]] = True
    if not wrap:
        ends[:, [0, -1]] = True
    end_rows, end_columns = np.nonzero(ends & (labels > 0))
    owner_rows = np.concatenate([rows, next_rows, end_rows])
    owners = labels[owner_rows, np.concatenate([columns, next_columns, end_columns])]
    both = directions_at(np.concatenate([rows, next_rows]), np.concatenate([columns, next_columns]))
    a = both[: len(rows)]
    b = both[len(rows) :]
    at_ends = directions_at(end_rows, end_columns)
    middle = np.where(np.isnan(a), b, np.where(np.isnan(b), a, a + b))
    points = np.concatenate([middle, middle, at_ends])
    usable = (owners > 0) & ~np.isnan(points[:, 0])
    owners = owners[usable]
    points = points[usable]
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    order = np.argsort(owners, kind="stable")
    instances, starts = np.unique(owners[order], return_index=True)
    return dict(zip(instances.tolist(), np.split(points[order], starts[1:]), strict=True))


def _borders(labels: Labels, wrap: bool) -> tuple[NDArray[np.intp], ...]:
    """Return rows and columns of pixels that differ from the next pixel below or right, and of that."""
    width = labels.shape[1]
    below = labels != np.roll(labels, -1, axis=0)
    below[-1] = False
    beside = labels != np.roll(labels, -1, axis=1)
    if not wrap:
        beside[:, -1] = False
    upper_rows, upper_columns = np.nonzero(below)
    left_rows, left_columns = np.nonzero(beside)
    return (
        np.concatenate([upper_rows, left_rows]),
        np.concatenate([upper_columns, left_columns]),
        np.concatenate([upper_rows + 1, left_rows]),
        np.concatenate([upper_columns, (left_columns + 1) % width]),
    )


def _fit(outline: Array, samples: Array) -> tuple[SphericalBox, SphericalBox] | None:
    """Return the upright and the rotated box around an object by directions on its outline and some inside;
    None if it is too wide for a perspective box."""
    middle = samples.mean(axis=0) + outline.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    if min((outline @ middle).min(), (samples @ middle).min()) < _FRONT:
        return None
    hull = _hull(outline, middle)
    upright = _smallest(hull, middle, np.zeros(1), _STEPS)
    rotated = _smallest(hull, upright.R_c_b[:, 2], np.arange(-45.0, 45.0, 3.0), 2)
    for spread in _SPREADS_DEG:
        turns = rotated.rot + spread * np.linspace(-1, 1, 15)
        rotated = _smallest(hull, rotated.R_c_b[:, 2], turns, 3)
    rotated = _smallest(hull, rotated.R_c_b[:, 2], np.array([rotated.rot]), _STEPS)
    return upright, (rotated if rotated.area < upright.area else upright)


def _hull(points: Array, middle: Array) -> Array:
    """The directions on the convex hull of directions (N, 3), all in front of ``middle``."""
    right = np.cross(middle, np.eye(3)[np.abs(middle).argmin()])
    right /= np.linalg.norm(right)
    plane = points @ np.stack([right, np.cross(middle, right)], axis=1) / (points @ middle)[:, None]
    try:
        return points[ConvexHull(plane).vertices]
    except (QhullError, ValueError):  # all on a line
        return points


def _smallest(points: Array, middle: Array, turns_deg: Array, steps: int) -> SphericalBox:
    """Return the smallest of the boxes around directions (N, 3) in front of where the search for the centre
    starts, by rotations (T,) that are tried, degrees, and so many iterations."""
    best = np.empty(5)
    _search(np.ascontiguousarray(points), np.array(middle), np.radians(turns_deg), steps, best)
    return SphericalBox(*np.degrees(best).tolist())


@njit("float64[:, ::1], float64[::1], float64[::1], int64, out float64[::1]", nogil=True)
def _search(points: Array, middle: Array, turns: Array, steps: int, best: Array) -> None:
    """Write longitude, latitude, both angles and the rotation, radians, of the smallest box into ``best``."""
    least = math.inf
    for turn in turns:
        x, y, z = middle
        sr, cr = math.sin(turn), math.cos(turn)
        for step in range(steps + 1):
            lon, lat = math.atan2(x, z), math.atan2(-y, math.hypot(x, z))
            sl, cl, sp, cp = math.sin(lon), math.cos(lon), math.sin(lat), math.cos(lat)
            rx, ry, rz = cr * cl + sr * sp * sl, sr * cp, sr * sp * cl - cr * sl
            dx, dy, dz = cr * sp * sl - sr * cl, cr * cp, cr * sp * cl + sr * sl
            fx, fy, fz = cp * sl, -sp, cp * cl
            left = top = math.inf
            right = bottom = -math.inf
            for i in range(points.shape[0]):
                px, py, pz = points[i, 0], points[i, 1], points[i, 2]
                ahead = max(px * fx + py * fy + pz * fz, _LEAST_Z)
                across, down = (px * rx + py * ry + pz * rz) / ahead, (px * dx + py * dy + pz * dz) / ahead
                left, right = min(left, across), max(right, across)
                top, bottom = min(top, down), max(bottom, down)
            left, right, top, bottom = math.atan(left), math.atan(right), math.atan(top), math.atan(bottom)
            if step < steps:
                a, b = math.tan((left + right) / 2), math.tan((top + bottom) / 2)
                x, y, z = fx + a * rx + b * dx, fy + a * ry + b * dy, fz + a * rz + b * dz
        half_h, half_v = max(-left, right), max(-top, bottom)
        if math.sin(half_h) * math.sin(half_v) < least:
            least = math.sin(half_h) * math.sin(half_v)
            best[0], best[1], best[2], best[3], best[4] = lon, lat, 2 * half_h, 2 * half_v, turn


def _lonlat(directions: Array) -> SphericalBox:
    """The smallest range of longitudes, and of latitudes, of directions (N, 3)."""
    lon, lat = np.degrees(lon_lat(directions))
    occupied = np.flatnonzero(np.bincount(((lon + 180) / 360 * _BINS).astype(int) % _BINS, minlength=_BINS))
    gaps = np.diff(occupied, append=occupied[0] + _BINS)
    widest = int(gaps.argmax())
    start = occupied[(widest + 1) % len(occupied)]
    across = _BINS - gaps[widest] + 1
    low = float(lat.min())
    high = float(lat.max())
    if across >= _BINS * 0.99:
        start = 0
        across = _BINS
    middle = (start + across / 2) / _BINS * 360 - 180
    return SphericalBox(
        float((middle + 180) % 360 - 180), (low + high) / 2, across / _BINS * 360, high - low, 0.0, "lonlat"
    )


# -- the truth ------------------------------------------------------------------------------------------


def _derive(frame: Frame, options: NoOptions) -> list[dict[str, Any]]:
    """Return by object ``instance_id``, ``name``, ``bfov`` and, rotated, ``rbfov``."""
    camera = frame.rendered().camera
    name_of = {instance: name for name, instance in frame.instances.items()}

    def directions(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
        """Return (N, 3) unit directions of the centres of pixels by ``rows`` and ``columns`` (N,)."""
        return camera.unproject(np.stack([columns + 0.5, rows + 0.5], axis=-1)).directions

    boxes = bfovs(frame.layer("labels"), directions, camera.wraps)
    records = []
    for instance, (upright, rotated) in boxes.items():
        if instance in name_of:
            both = {"bfov": upright.to_dict(), "rbfov": rotated.to_dict()}
            records.append({"instance_id": instance, "name": name_of[instance], **both})
    return records


register(Truth("bfov", _derive, needs=("object_mask",), options=NoOptions))
