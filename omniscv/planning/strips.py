"""Strips: narrow views that hold just the rays of one optical centre.

The rays of a panorama's column, or of a mirror's ring, lie on a circle of the sphere of directions: on a
plane or cone about an axis n, ``n . d = c``. A few views set around that circle, their rows along it,
hold it in a strip a few pixels high. All strips of a plan share one size, because changing the size is
slow on real servers; what differs is how many views a circle takes.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from omniscv.geometry import Array, Pose, pinhole
from omniscv.sources.base import Capabilities, View

_MOST_VIEWS = 12
_CENTERING_STEPS = 4
_GRAZING = 0.05  # z of a unit ray: nearer to 0 it is as good as behind the view
_ROUNDING = 1e-7
LEAST_HALF = np.tan(np.radians(0.5))  # engines take narrower views for 1 degree, in silence
STEEPEST = np.tan(np.radians(62.0))  # farther off a view's axis pixels are stretched more than four times
_SAMPLED_VIEWPOINTS = 24
_SAMPLED_RAYS = 192
PIXELS_PER_REQUEST = 300_000.0
"""How many pixels cost as much as one more request: a live engine answers once a tick, whatever the size."""

Size = tuple[int, int]


def straight(rays_w: Sequence[Array], focal_px: float) -> bool:
    """Return whether the rays of every viewpoint lie on a great circle, to half a pixel.

    Args:
        rays_w: for each viewpoint, (N, 3) unit directions.
        focal_px: px per radian.
    """
    sample = _thinned(rays_w, _SAMPLED_VIEWPOINTS)
    return all(np.abs(rays @ _circle(rays)[0]).max() * focal_px <= 0.5 for rays in sample)


def strip_size(
    rays_w: Sequence[Array],
    focal_px: float,
    border_px: int,
    capabilities: Capabilities,
    least_half: float = LEAST_HALF,
) -> Size:
    """Return the width and height that serve a plan's viewpoints for the least work.

    Args:
        rays_w: for each viewpoint, (N, 3) unit directions.
        focal_px: px per radian at a view's centre.
        border_px: what filters need around every ray.
        capabilities: of the source: its smallest views, and whether they may be higher than wide.
        least_half: tangent of half the narrowest field of view.
    """
    sample = [np.array(_thinned(rays, _SAMPLED_RAYS)) for rays in _thinned(rays_w, _SAMPLED_VIEWPOINTS)]
    circles = [(rays, *_circle(rays)) for rays in sample]
    best, least = (capabilities.min_size, capabilities.min_size), np.inf
    for count in range(1, _MOST_VIEWS + 1):
        strips = [strip for circle in circles for strip in _shares(*circle, count)]
        if len(strips) >= least:  # too many, whatever their size
            continue
        half = np.max([_strip(*strip)[1] for strip in strips], axis=0)
        if half[0] > STEEPEST:
            continue
        size = holding_size(np.maximum(half, (least_half, 0.0)), focal_px, border_px, capabilities)
        cost = len(strips) * (1 + size[0] * size[1] / PIXELS_PER_REQUEST)
        if cost < least:
            best, least = size, cost
    return best


def strip_views(
    center_w: Array, rays_w: Array, focal_px: float, border_px: int, size: Size
) -> tuple[View, ...] | None:
    """Return the fewest views of a size that hold a viewpoint's rays; None where they do not fit.

    Args:
        center_w: (3,) optical centre.
        rays_w: (N, 3) unit directions.
        focal_px, border_px, size: as :func:`strip_size`.
    """
    limit = (np.array(size) / 2 - border_px) / focal_px
    fov_deg = pinhole.fov_deg(size[0], focal_px)
    circle = _circle(rays_w)
    for count in range(1, _MOST_VIEWS + 1):
        strips = [_strip(*strip) for strip in _shares(rays_w, *circle, count)]
        if all((half <= limit + _ROUNDING).all() for _, half in strips):
            return tuple(View(Pose(center_w, R_w_c), fov_deg, *size) for R_w_c, _ in strips)
    return None


def holding_size(half: Array, focal_px: float, border_px: int, capabilities: Capabilities) -> Size:
    """Return the least width and height around extents in tangents: even wide, odd high, so that a straight
    strip of rays runs through the middle of a row of pixels."""
    width = 2 * int(np.ceil(focal_px * half[0] + border_px - _ROUNDING))
    height = 2 * int(np.ceil(focal_px * half[1] + border_px - 0.5 - _ROUNDING)) + 1
    height = max(height, capabilities.min_size)
    return max(width, 1 if capabilities.can_set_tall else height, capabilities.min_size), height


def _thinned(items: Any, count: int) -> Any:
    """Return about ``count`` of the items, the first and the last among them."""
    return [*items[:: max(1, len(items) // count)], items[-1]]


def _shares(rays: Array, axis: Array, azimuth: Array, count: int) -> list[tuple[Array, Array]]:
    """Return up to ``count`` arcs of the circle that rays lie on: the rays of each, and the circle's axis."""
    if count == 1:
        return [(rays, axis)]
    span = azimuth.max() * (1 + 1e-12) + 1e-12
    share = np.minimum((azimuth / span * count).astype(int), count - 1)
    return [(arc, axis) for k in range(count) if len(arc := rays[share == k])]


def _strip(rays: Array, axis: Array) -> tuple[Array, Array]:
    """Return the view of an arc: its R_w_c, and the tangents of its rays."""
    return looking(rays, rays.mean(axis=0), axis)


def _circle(rays: Array) -> tuple[Array, Array]:
    """Return the axis of the circle that rays lie on, and their azimuths about it, from its largest gap."""
    if len(rays) < 3:
        axis = _cross(rays[0], np.eye(3)[np.argmin(np.abs(rays[0]))])
    else:
        centered = rays - rays.mean(axis=0)
        axis = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    axis = axis / np.linalg.norm(axis)
    across = _cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    azimuth = np.arctan2(rays @ _cross(axis, across), rays @ across)
    ordered = np.sort(azimuth)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    start = ordered[(np.argmax(gaps) + 1) % len(ordered)]
    return axis, (azimuth - start) % (2 * np.pi)


def looking(rays: Array, toward: Array, axis: Array, steps: int = _CENTERING_STEPS) -> tuple[Array, Array]:
    """Return R_w_c of a view with rays in its middle, and the tangents that hold them; infinite if none does.

    Args:
        rays: (N, 3) unit.
        toward: (3,) about their middle.
        axis: (3,) the view's y axis, as near as its middle allows.
        steps: how often the middle is found again.
    """
    half = np.full(2, np.inf)
    R_w_c = np.eye(3)
    for _ in range(steps):
        if np.linalg.norm(toward) < 1e-9:  # rays all around: no direction is their middle
            break
        z = toward / np.linalg.norm(toward)
        x = _cross(axis, z)
        if np.linalg.norm(x) < 1e-9:  # looking along the axis: any row will do
            x = _cross(np.eye(3)[np.argmin(np.abs(z))], z)
        x /= np.linalg.norm(x)
        R_w_c = np.stack([x, _cross(z, x), z], axis=1)
        seen = rays @ R_w_c
        if (seen[:, 2] <= _GRAZING).any():
            return R_w_c, np.full(2, np.inf)
        xy = seen[:, :2] / seen[:, 2:]
        low, high = xy.min(axis=0), xy.max(axis=0)
        half = np.maximum(-low, high)
        toward = R_w_c @ np.append((low + high) / 2, 1.0)
    return R_w_c, half


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors; numpy.cross takes ten times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
