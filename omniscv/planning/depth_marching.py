"""Where a ray meets what was captured from another centre.

A ray from o is seen from a centre c as an arc, from the direction of o to the ray's own. Along it, a pixel of
the capture at a time, its points Y are compared with the captured distance D: ``g = |Y - c| - D``.
While g < 0 they are in free space visible from c. Where g passes through zero on one surface, the ray
meets that surface, and visibility from the ray's origin is certified by c: all of the way is free.
Where g jumps above zero, the ray is occluded from c: what it meets there is unknown.

With h the distance of c from the ray and psi the angle between ``Y - c`` and the ray,
``|Y - c| = h / sin psi``, and steps of equal psi are steps of equal pixels.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omniscv.geometry import Array, cube_rotations
from omniscv.geometry.surfaces import interpolated, one_surface
from omniscv.parallel import blocks
from omniscv.sources.base import Capture

_STEP_PX = 1.0
_REFINEMENTS = 12
_ON_SURFACE = 0.003
"""How far a refined crossing may be from the surface, metres and parts of the distance: half floats."""
_DEPTH_NOISE = 2.0**-12  # relative error of half floats, rounded
_SAME_FACE = 0.01
"""Entries of rotation matrices of a face that a source could not turn exactly differ by less."""


class DepthShell(NamedTuple):
    """The depth captured from a centre, as distances.

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


def depth_shell(center_w: Array, captures: Sequence[Capture]) -> DepthShell:
    """Return the shell of planar depths captured with the faces of a world-aligned cube.

    Args:
        center_w: (3,) the views' common centre.
        captures: depth, all of one size. Views that are no face of the cube are passed over.
    """
    view = captures[0].view
    R_c_w = np.array([R_w_c.T for _, R_w_c in cube_rotations()])
    slot = np.full(6, -1, np.int64)
    for i, capture in enumerate(captures):
        own = capture.view.pose.R_w_c.T
        off = np.abs(R_c_w - own).max(axis=(1, 2))
        if off.min() < _SAME_FACE:
            slot[off.argmin()], R_c_w[off.argmin()] = i, own
    lengths = view.ray_lengths().astype(np.float32)
    distance = np.stack([capture.pixels * lengths for capture in captures])
    finite = distance[np.isfinite(distance)]
    least, most = (float(finite.min()), float(finite.max())) if finite.size else (np.inf, 0.0)
    return DepthShell(
        center_w, distance, slot, R_c_w, view.focal_px, view.width / 2, view.height / 2, least, most
    )


def march(shell: DepthShell, origins_w: Array, directions_w: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return how far rays go before they meet a surface captured from a centre.

    Args:
        shell: what was captured from the centre.
        origins_w, directions_w: (N, 3), unit directions.

    Returns:
        (N,) metres along each ray, +inf for the sky, NaN if the capture shows nothing there; (N,) whether
        all of the way is visible from the centre; (N,) the error that noise of the depth makes, radians
        from the centre.
    """
    count = len(origins_w)
    reach, sure, error = np.full(count, np.nan), np.zeros(count, np.bool_), np.zeros(count)
    each = (origins_w, directions_w, reach, sure, error)
    blocks(lambda rows: _march(shell, *(array[rows] for array in each)), count)
    return reach, sure, error


def distances(shell: DepthShell, directions_w: Array) -> Array:
    """Return (N,) captured distance in directions (N, 3), nearest pixel; 0 outside all views."""
    out = np.zeros(len(directions_w))
    _distances(shell, directions_w, out)
    return out


@njit(cache=True, nogil=True)
def _distances(shell: Any, directions: Any, out: Any) -> None:
    for i in range(directions.shape[0]):
        k, u, v = _lookup(shell, directions[i, 0], directions[i, 1], directions[i, 2])
        out[i] = _nearest(shell.distance[k], u, v) if k >= 0 else 0.0


@njit(cache=True, nogil=True)
def _lookup(shell: Any, x: float, y: float, z: float) -> tuple[int, float, float]:
    """The view that a direction is in, and the place there; -1 if that face was not captured."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face = 0 if x > 0 else 2
    elif ay >= az:
        face = 3 if y > 0 else 1
    else:
        face = 4 if z > 0 else 5
    if shell.slot[face] < 0:
        return -1, 0.0, 0.0
    R = shell.R_c_w[face]
    depth = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
    u = shell.focal * (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z) / depth + shell.half_width
    v = shell.focal * (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z) / depth + shell.half_height
    return shell.slot[face], u, v


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
def _march(shell: Any, origin: Any, direction: Any, reach: Any, sure: Any, error: Any) -> None:
    step = _STEP_PX / shell.focal
    cx, cy, cz = shell.center_w[0], shell.center_w[1], shell.center_w[2]
    for i in range(origin.shape[0]):
        ox, oy, oz = origin[i, 0] - cx, origin[i, 1] - cy, origin[i, 2] - cz
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        foot = -(ox * dx + oy * dy + oz * dz)
        hx, hy, hz = ox + foot * dx, oy + foot * dy, oz + foot * dz
        h = np.sqrt(hx * hx + hy * hy + hz * hz)
        if h < 1e-9:  # the ray runs through the centre, or starts there
            k, u, v = _lookup(shell, dx, dy, dz)
            if k >= 0:
                reach[i] = _smooth(shell.distance[k], u, v) + foot
                sure[i] = foot >= -shell.least
            continue
        hx, hy, hz = hx / h, hy / h, hz / h
        psi = np.arctan2(h, -foot)
        if h < shell.least:  # nearer than everything that was captured there is nothing
            psi = min(psi, np.arcsin(h / shell.least))
        end = h / (2.0 * shell.most + h) if shell.most > 0 else step
        certain, met, was_free = True, False, True
        while True:
            psi = max(psi, end)
            s, c = np.sin(psi), np.cos(psi)
            k, u, v = _lookup(shell, hx * s + dx * c, hy * s + dy * c, hz * s + dz * c)
            if k < 0:
                certain = was_free = False
            else:
                if h / s < _nearest(shell.distance[k], u, v):
                    was_free = True
                elif was_free:
                    # A step farther: between pixels a surface can lie behind its nearest pixel.
                    behind, before = max(psi - step, 0.5 * end), min(psi + 2 * step, np.pi)
                    at, gap = _refined(shell, behind, before, (hx, hy, hz), (dx, dy, dz), h)
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
    shell: Any, behind: float, before: float, toward_ray: Any, direction: Any, h: float
) -> tuple[float, float]:
    """The angle between two where g changes its sign, by bisection, and g there."""
    (hx, hy, hz), (dx, dy, dz) = toward_ray, direction
    middle, gap = behind, np.inf
    for _ in range(_REFINEMENTS):
        middle = 0.5 * (behind + before)
        s, c = np.sin(middle), np.cos(middle)
        k, u, v = _lookup(shell, hx * s + dx * c, hy * s + dy * c, hz * s + dz * c)
        if k < 0:
            return middle, np.inf
        gap = h / s - _smooth(shell.distance[k], u, v)
        if gap > 0:
            behind = middle
        else:
            before = middle
    return middle, gap
