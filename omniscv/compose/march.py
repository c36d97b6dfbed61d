"""Where a ray meets what was captured from another centre.

A ray from o is seen from a centre c as an arc, from the direction of o to the ray's own. Along it, a pixel of
the capture at a time, its points Y are compared with the captured distance D: ``g = |Y - c| - D``.
While g < 0 they are in free space that c sees. Where g passes through zero on one surface, the ray
meets that surface, and c vouches for it: nothing stands between o and there, because c saw all of the way.
Where g jumps above zero, the ray goes behind something that c sees: what it meets there c cannot know.

With h the distance of c from the ray and psi the angle between ``Y - c`` and the ray,
``|Y - c| = h / sin psi``, and steps of equal psi are steps of equal pixels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omniscv.captures.view import View
from omniscv.compose.depth import interpolated, one_surface
from omniscv.geometry import Array, cube_rotations
from omniscv.parallel import blocks

_STEP_PX = 1.0
_REFINEMENTS = 12
_ON_SURFACE = 0.003
"""How far a refined crossing may be from the surface, metres and parts of the distance: half floats."""
_DEPTH_NOISE = 2.0**-12
"""Relative error of half floats, rounded."""


class Shell(NamedTuple):
    """All that was captured from a centre, as distances.

    Attributes:
        center_w: (3,) metres.
        distance: (V, h, w) float32 along the rays; +inf for the sky.
        slot: (6,) int64, which of V each face of the world-aligned cube is; -1 for none.
        R_c_w: (6, 3, 3) world to each face.
        focal, half_width, half_height: px.
        least, most: of the finite distances.
    """

    center_w: Array
    distance: NDArray[np.float32]
    slot: NDArray[np.int64]
    R_c_w: Array
    focal: float
    half_width: float
    half_height: float
    least: float
    most: float


_LEAN = 0.01
"""Entries of rotation matrices of faces that lean differ by less: 0.1 degrees are 0.0017."""


def shell(center_w: Array, views: tuple[View, ...], depth: list[NDArray[np.float32]]) -> Shell:
    """The shell of planar depths captured with world-aligned views.

    Args:
        center_w: (3,) the views' common centre.
        views: faces of the cube, all of one size. They may lean as far as plugin 0.3.10 lets them; others,
            such as its second ones of up and down, are passed over.
        depth: (h, w) planar metres of each.
    """
    R_c_w = np.array([R_w_c.T for _, R_w_c in cube_rotations()])
    slot = np.full(6, -1, np.int64)
    for i, view in enumerate(views):
        off = np.abs(R_c_w - view.pose.R_w_c.T).max(axis=(1, 2))
        if off.min() < _LEAN:
            slot[off.argmin()], R_c_w[off.argmin()] = i, view.pose.R_w_c.T
    lengths = views[0].ray_lengths().astype(np.float32)
    distance = np.stack([plane * lengths for plane in depth])
    finite = distance[np.isfinite(distance)]
    least, most = (float(finite.min()), float(finite.max())) if finite.size else (np.inf, 0.0)
    view = views[0]
    return Shell(center_w, distance, slot, R_c_w, view.focal_px, view.width / 2, view.height / 2, least, most)


def march(seen: Shell, origins_w: Array, directions_w: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """How far rays go before they meet what a centre saw.

    Args:
        seen: what was captured from the centre.
        origins_w, directions_w: (N, 3), unit directions.

    Returns:
        (N,) metres along each ray, +inf for the sky, NaN if the capture shows nothing there; (N,) whether
        the centre saw all of the way; (N,) the error that noise of the depth makes, radians as seen
        from the centre.
    """
    count = len(origins_w)
    reach, sure, error = np.full(count, np.nan), np.zeros(count, np.bool_), np.zeros(count)

    def part(rows: slice) -> None:
        _march(
            origins_w[rows] - seen.center_w,
            directions_w[rows],
            *seen[1:],
            reach[rows],
            sure[rows],
            error[rows],
        )

    blocks(part, count)
    return reach, sure, error


def distances(seen: Shell, directions_w: Array) -> Array:
    """(N,) captured distance in directions (N, 3), nearest pixel; 0 where no view looks."""
    out = np.zeros(len(directions_w))
    _distances(directions_w, *seen[1:7], out)
    return out


@njit(cache=True, nogil=True)
def _distances(
    directions: Any, distance: Any, slot: Any, R_c_w: Any, focal: float, cx: float, cy: float, out: Any
) -> None:
    for i in range(directions.shape[0]):
        k, u, v = _lookup(
            directions[i, 0], directions[i, 1], directions[i, 2], distance, slot, R_c_w, focal, cx, cy
        )
        out[i] = _nearest(distance[k], u, v) if k >= 0 else 0.0


@njit(cache=True, nogil=True)
def _lookup(
    x: float, y: float, z: float, distance: Any, slot: Any, R_c_w: Any, focal: float, cx: float, cy: float
) -> tuple[int, float, float]:
    """The view that a direction is in, and the place there; -1 if that face was not captured."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face = 0 if x > 0 else 2
    elif ay >= az:
        face = 3 if y > 0 else 1
    else:
        face = 4 if z > 0 else 5
    if slot[face] < 0:
        return -1, 0.0, 0.0
    R = R_c_w[face]
    depth = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
    u = focal * (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z) / depth + cx
    v = focal * (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z) / depth + cy
    return slot[face], u, v


@njit(cache=True, nogil=True)
def _nearest(face: Any, u: float, v: float) -> float:
    c = min(max(int(np.floor(u)), 0), face.shape[1] - 1)
    r = min(max(int(np.floor(v)), 0), face.shape[0] - 1)
    return float(face[r, c])


@njit(cache=True, nogil=True)
def _smooth(face: Any, u: float, v: float) -> float:
    """Between pixels of one surface, else the nearest pixel's."""
    c, r = int(np.floor(u - 0.5)), int(np.floor(v - 0.5))
    if 1 <= c < face.shape[1] - 2 and 1 <= r < face.shape[0] - 2 and one_surface(face, r, c):
        return float(interpolated(face, r, c, u - 0.5 - c, v - 0.5 - r))
    return float(_nearest(face, u, v))


@njit(cache=True, nogil=True)
def _march(
    offset: Any, direction: Any, distance: Any, slot: Any, R_c_w: Any, focal: float, cx: float, cy: float,
    least: float, most: float, reach: Any, sure: Any, error: Any,
) -> None:  # fmt: skip
    step = _STEP_PX / focal
    for i in range(offset.shape[0]):
        ox, oy, oz = offset[i, 0], offset[i, 1], offset[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        foot = -(ox * dx + oy * dy + oz * dz)
        hx, hy, hz = ox + foot * dx, oy + foot * dy, oz + foot * dz
        h = np.sqrt(hx * hx + hy * hy + hz * hz)
        if h < 1e-9:  # the ray runs through the centre, or starts there
            k, u, v = _lookup(dx, dy, dz, distance, slot, R_c_w, focal, cx, cy)
            if k >= 0:
                reach[i] = _smooth(distance[k], u, v) + foot
                sure[i] = foot >= -least
            continue
        hx, hy, hz = hx / h, hy / h, hz / h
        psi = np.arctan2(h, -foot)
        if h < least:  # nearer than everything that was captured there is nothing
            psi = min(psi, np.arcsin(h / least))
        end = h / (2.0 * most + h) if most > 0 else step
        certain, met, was_free = True, False, True
        while True:
            psi = max(psi, end)
            s, c = np.sin(psi), np.cos(psi)
            k, u, v = _lookup(
                hx * s + dx * c, hy * s + dy * c, hz * s + dz * c, distance, slot, R_c_w, focal, cx, cy
            )
            if k < 0:
                certain = was_free = False
            else:
                is_free = h / s < _nearest(distance[k], u, v)
                if is_free:
                    was_free = True
                elif was_free:
                    # A step farther: between pixels a surface can lie behind its nearest pixel.
                    at, gap = _refined(
                        max(psi - step, 0.5 * end), min(psi + 2 * step, np.pi), hx, hy, hz, dx, dy, dz, h,
                        distance, slot, R_c_w, focal, cx, cy,
                    )  # fmt: skip
                    length = h / np.sin(at)
                    if abs(gap) <= _ON_SURFACE * (1.0 + length):
                        reach[i] = foot + h / np.tan(at)
                        error[i] = np.sin(at) * _DEPTH_NOISE
                        met = True
                        break
                    certain = was_free = False
            if psi <= end:
                break
            psi -= step
        if not met and certain:
            reach[i] = np.inf
        sure[i] = certain and (met or was_free)


@njit(cache=True, nogil=True)
def _refined(
    behind: float, before: float, hx: float, hy: float, hz: float, dx: float, dy: float, dz: float, h: float,
    distance: Any, slot: Any, R_c_w: Any, focal: float, cx: float, cy: float,
) -> tuple[float, float]:  # fmt: skip
    """The angle between two where g changes its sign, by bisection, and g there."""
    gap = np.inf
    middle = behind
    for _ in range(_REFINEMENTS):
        middle = 0.5 * (behind + before)
        s, c = np.sin(middle), np.cos(middle)
        k, u, v = _lookup(
            hx * s + dx * c, hy * s + dy * c, hz * s + dz * c, distance, slot, R_c_w, focal, cx, cy
        )
        if k < 0:
            return middle, np.inf
        gap = h / s - _smooth(distance[k], u, v)
        if gap > 0:
            behind = middle
        else:
            before = middle
    return middle, gap
