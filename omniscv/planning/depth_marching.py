"""Where a ray meets what was captured from another centre.

A ray from o is seen from a centre c as an arc, from the direction of o to the ray's own. Along it, a pixel of
the capture at a time, its points Y are compared with the captured distance D: ``g = |Y - c| - D``.
While g < 0 they are in free space visible from c. Where g passes through zero on one surface, the ray
meets that surface, and visibility from the ray's origin is certified by c: all of the way is free.
Where g jumps above zero, the ray is occluded from c: what it meets there is unknown.

With h the distance of c from the ray and psi the angle between ``Y - c`` and the ray,
``|Y - c| = h / sin psi``, and steps of equal psi are steps of equal pixels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry import Array
from omniscv.geometry.surfaces import surface_point
from omniscv.parallel import blocks
from omniscv.planning.base import FoundDepth
from omniscv.planning.depth_shell import DepthShell, between_pixels, face_of, look_up, nearest_pixel

_STEP_PX = 1.0
_REFINEMENTS = 12
_ON_SURFACE = 0.003
"""How far a refined crossing may be from the surface, metres and parts of the distance: half floats."""
_MARGIN = 1.3
"""A neighbouring surface goes on between the pixels that show it."""
_ROUNDED = 1.2
"""The slope, and so the crossing, is found from rounded values too."""
_BEHIND = 1.01
"""A ray that starts farther behind what the centre sees starts where the centre sees nothing."""
_DEEPER_PX = 2.0
_TOUCHING = 4.0
"""A ray that is not deeper behind a surface than so many of its errors, so many pixels on, touches it."""
_SHORT = 0.25
"""Of the reach: a longer hidden part of a ray's way may hold anything."""
_LEAST_COSINE = 1e-3
"""Between a ray and the normal of a surface: what is more grazing is met anywhere."""


class Met(NamedTuple):
    """What N rays meet.

    Attributes:
        reach: (N,) metres along each ray, +inf for the sky, NaN if the capture shows nothing there.
        sure: (N,) whether all of the way is visible from the centre.
        error: (N,) how far the reach may be off, metres, +inf where nothing bounds it.
        direction_error: (N,) radians, how far the direction to what is met may be off for it.
        grazes: (N,) whether the ray passes within a pixel of another surface on its way.
        hidden_from, hidden_to: (N,) metres along the ray, the part of it that the centre does not see;
            +inf and -inf if it sees all.
    """

    reach: Array
    sure: NDArray[np.bool_]
    error: Array
    direction_error: Array
    grazes: NDArray[np.bool_]
    hidden_from: Array
    hidden_to: Array

    def of(self, rows: NDArray[np.int64]) -> Met:
        """Return what some of the rays meet."""
        return Met(
            self.reach[rows],
            self.sure[rows],
            self.error[rows],
            self.direction_error[rows],
            self.grazes[rows],
            self.hidden_from[rows],
            self.hidden_to[rows],
        )

    def found(self) -> FoundDepth:
        """Return what is known of the depth: a short part of the way that is hidden adds to its error."""
        with np.errstate(invalid="ignore"):
            may_be_nearer = np.where(self.sure, 0.0, self.reach - self.hidden_from)
            long = ~(self.hidden_to - self.hidden_from <= _SHORT * self.reach)
        return FoundDepth(
            self.reach.astype(np.float32),
            np.fmax(self.error, may_be_nearer).astype(np.float32),
            self.direction_error.astype(np.float32),
            self.grazes | ~self.sure,
            ~self.sure & long,
        )

    @classmethod
    def nothing(cls, count: int) -> Met:
        """Return that nothing is known of so many rays."""
        no = np.zeros(count, np.bool_)
        endless = np.full(count, np.inf)
        return cls(
            np.full(count, np.nan), no, endless, np.zeros(count), no.copy(), endless.copy(), -endless
        )  # fmt: skip


def march(shell: DepthShell, origins_w: Array, directions_w: Array) -> Met:
    """Return what rays meet first of what was captured from a centre.

    Args:
        shell: what was captured from the centre.
        origins_w, directions_w: (N, 3), unit directions.
    """
    count = len(origins_w)
    met = Met.nothing(count)
    each = origins_w, directions_w, *met
    blocks(lambda rows: _march(shell, *(array[rows] for array in each)), count)
    return met


@njit(cache=True, nogil=True)
def _met_at(shell: Any, origin: Any, direction: Any, at: Any) -> tuple[float, float, float]:
    """Where a ray meets the surface that lies in a direction from the centre: the reach, how far that may be
    off, and how far, in radians from the centre, what it meets.

    On the plane ``m . p = 1`` through the surface's point the ray ``o + t d`` has
    ``t = (1 - m . o) / (m . d)``: an error of a part of the inverse depth moves it by that part of
    ``1 / (m . d)``.
    """
    k, u, v, along = look_up(shell, at[0], at[1], at[2])
    point = surface_point(shell.depth[k], u, v, shell.focal, shell.precision)
    if not point.inverse > 0.0:
        return np.inf, np.inf, np.inf
    R = shell.R_c_w[face_of(at)]
    a, b = point.across * shell.focal, point.down * shell.focal
    e = point.inverse - point.across * (u - shell.half_width) - point.down * (v - shell.half_height)
    slope = start = parallel = 0.0
    for j in range(3):
        m = a * R[0, j] + b * R[1, j] + e * R[2, j]
        slope, start, parallel = (
            slope + m * direction[j],
            start + m * origin[j],
            parallel + at[j] * direction[j],
        )
    distance = 1.0 / (point.inverse * along)
    cosine = max(abs(slope) * distance, _LEAST_COSINE)
    off = _ROUNDED * point.error / point.inverse * distance / cosine
    aside = np.sqrt(max(0.0, 1.0 - parallel * parallel))
    reach = (1.0 - start) / slope if slope != 0.0 else np.inf
    return reach, off + _MARGIN * point.jump / along / cosine, off * aside / distance


@njit(cache=True, nogil=True)
def _march(
    shell: Any,
    origin: Any,
    direction: Any,
    reach: Any,
    sure: Any,
    error: Any,
    direction_error: Any,
    grazes: Any,
    hidden_from: Any,
    hidden_to: Any,
) -> None:
    step = _STEP_PX / shell.focal
    cx, cy, cz = shell.center_w[0], shell.center_w[1], shell.center_w[2]
    for i in range(origin.shape[0]):
        ox, oy, oz = origin[i, 0] - cx, origin[i, 1] - cy, origin[i, 2] - cz
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        foot = -(ox * dx + oy * dy + oz * dz)
        hx, hy, hz = ox + foot * dx, oy + foot * dy, oz + foot * dz
        h = np.sqrt(hx * hx + hy * hy + hz * hz)
        if h < 1e-9:  # the ray runs through the centre, or starts there
            k, u, v, along = look_up(shell, dx, dy, dz)
            if k >= 0:
                reach[i] = between_pixels(shell, k, u, v) / along + foot
                sure[i] = foot >= -shell.least
                error[i] = _met_at(shell, (ox, oy, oz), (dx, dy, dz), (dx, dy, dz))[1]
            continue
        hx, hy, hz = hx / h, hy / h, hz / h
        psi = np.arctan2(h, -foot)
        if h < shell.least:  # nearer than everything that was captured there is nothing
            psi = min(psi, np.arcsin(h / shell.least))
        end = h / (2.0 * shell.most + h) if shell.most > 0 else step
        met, was_free, first = False, False, True
        passed, at = np.inf, psi
        while True:
            psi = max(psi, end)
            s, c = np.sin(psi), np.cos(psi)
            was_free = was_free or first
            free = False
            k, u, v, along = look_up(shell, hx * s + dx * c, hy * s + dy * c, hz * s + dz * c)
            if k >= 0:
                planar = h / s * along
                near = nearest_pixel(shell.depth[k], u, v)
                if planar < near:
                    free = True
                    beside = nearest_pixel(shell.nearest[k], u, v)
                    if planar >= beside:
                        # Where the ray is as far from the centre as the surface that it may have met.
                        away = np.sqrt(max(0.0, (beside / along) ** 2 - h * h))
                        passed = min(passed, foot + (away if c > 0 else -away), foot + h * c / s)
                elif was_free and not (first and planar > near * _BEHIND):
                    # A step farther: between pixels a surface can lie behind its nearest pixel.
                    behind, before = max(psi - step, 0.5 * end), min(psi + 2 * step, np.pi)
                    at, gap = _refined(shell, behind, before, (hx, hy, hz), (dx, dy, dz), h)
                    length = h / np.sin(at)
                    if abs(gap) <= _ON_SURFACE * (1.0 + length):
                        met = True
                        break
            if not free:
                hidden_from[i] = min(hidden_from[i], foot + h / np.tan(min(psi + step, np.pi - 1e-9)))
                hidden_to[i] = foot + h / np.tan(psi - step) if psi > end else np.inf
            was_free, first = free, False
            if psi <= end:
                break
            psi -= step
        seen = hidden_from[i] > hidden_to[i]
        if met:
            s, c = np.sin(at), np.cos(at)
            toward = (hx * s + dx * c, hy * s + dy * c, hz * s + dz * c)
            along_ray = foot + h * c / s
            reach[i], error[i], direction_error[i] = _met_at(shell, (ox, oy, oz), (dx, dy, dz), toward)
            if abs(reach[i] - along_ray) > _ON_SURFACE * (1.0 + h / s):  # too grazing for a plane
                reach[i], error[i] = along_ray, error[i] + abs(reach[i] - along_ray)
            if _touches(shell, at - _DEEPER_PX * step, (hx, hy, hz), (dx, dy, dz), h):
                error[i], grazes[i] = np.inf, True
        elif seen:
            reach[i] = np.inf
            error[i] = np.inf if shell.precision.largest_m < np.inf else 0.0
        sure[i] = seen
        if passed < np.inf:
            grazes[i] = True
            error[i] = max(error[i], _MARGIN * (reach[i] - passed))


@njit(cache=True, nogil=True)
def _touches(shell: Any, psi: float, toward_ray: Any, direction: Any, h: float) -> bool:
    """Whether a ray that met a surface is hardly behind it a little farther on: it may as well miss it."""
    (hx, hy, hz), (dx, dy, dz) = toward_ray, direction
    s, c = np.sin(psi), np.cos(psi)
    k, u, v, along = look_up(shell, hx * s + dx * c, hy * s + dy * c, hz * s + dz * c)
    if psi <= 0.0 or k < 0:
        return False
    point = surface_point(shell.depth[k], u, v, shell.focal, shell.precision)
    error = point.error / max(point.inverse, 1e-12)
    return bool(h / s * along * point.inverse < 1.0 + _TOUCHING * error)


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
        k, u, v, along = look_up(shell, hx * s + dx * c, hy * s + dy * c, hz * s + dz * c)
        if k < 0:
            return middle, np.inf
        gap = h / s - between_pixels(shell, k, u, v) / along
        if gap > 0:
            behind = middle
        else:
            before = middle
    return middle, gap
