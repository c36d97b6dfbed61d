"""March rays through depth that was captured from another centre.

A ray from o is seen from a centre c as an arc, from the direction of o to the ray's own. Along it, a pixel of
the capture at a time, its points Y are compared with the captured distance D: ``g = |Y - c| - D``.
While g < 0 they are in free space visible from c. Where g passes through zero on one surface, the ray
meets that surface, and visibility from the ray's origin is certified by c: all of the way is free.
Where g jumps above zero, the ray is occluded from c: what it meets there is unknown.

With h the distance of c from the ray and psi the angle between ``Y - c`` and the ray,
``|Y - c| = h / sin psi``, and steps of equal psi are steps of equal pixels.
"""

from typing import Any, NamedTuple

import numpy as np

from omniscv.compiled import njit
from omniscv.depth.depth_shell import (
    CAPTURED,
    CELL_PX,
    NEAREST,
    DepthShell,
    error_said,
    look_up,
    pixel_depth,
    planar_depth,
    surface_at,
)
from omniscv.depth.hits import HIT, Hits  # noqa: F401  # HIT stands in a signature
from omniscv.depth.surfaces import plane_of
from omniscv.geometry import Array
from omniscv.geometry.arrays import run

# Tuned by measurement:
_STEP_PX = 1.0  # step of a ray along its arc, px of the capture
_IN_A_CELL = 0.75  # of a cell: how far a ray goes at once where nothing is near
_REFINEMENTS = 12  # steps, at most, to find where a ray meets a surface
_MET = 1e-6  # of the distance: ends them; the plane through the surface gives the reach
_ON_SURFACE = 0.003  # distance of a refined crossing from its surface, relative to the centre's (half floats)
_MARGIN = 1.3  # by which a neighbouring surface may go on beyond the pixels that show it
_ROUNDED = 1.2  # by which errors grow because slopes come from rounded depth, too
_BEHIND = 1.0 + 1e-6  # relative depth beyond which a ray's origin counts as hidden from the centre
_DEEPER_PX = 2.0
_TOUCHING = 4.0
"""A ray grazes a surface if, ``_DEEPER_PX`` on, it is less than ``_TOUCHING`` depth errors behind it."""
# a nearer surface beside: so many px away, and relative depth below
_BESIDE_PX = 2.5
_BESIDE = 0.98
_LEAST_COSINE = 1e-3  # between a ray and a surface's normal: more grazing rays have no sharper error


class _Arc(NamedTuple):
    """A ray seen from the centre: at angle psi to it lies ``h (toward sin psi + direction cos psi)``."""

    origin: tuple[float, float, float]  # from the centre, world frame
    direction: tuple[float, float, float]
    toward: tuple[float, float, float]  # unit, from the centre to the ray's nearest point, the foot
    h: float  # metres from the centre to the foot
    foot: float  # metres along the ray to the foot


def march(shell: DepthShell, origins_w: Array, directions_w: Array) -> Hits:
    """Return the first hits of rays with the surfaces captured from a centre.

    Args:
        shell: what was captured from the centre.
        origins_w, directions_w: (N, 3), unit directions.
    """
    hits = Hits.unknown(len(origins_w))
    run(_march_block, (origins_w - shell.center_w, directions_w, hits.view(np.ndarray)), shell)
    behind = hits.reach <= 0  # a hit counts only in front of the ray's origin
    hits.reach[behind] = np.nan
    hits.distrust(behind)
    return hits


@njit("float64[:, ::1], float64[:, ::1], out HIT[::1], DepthShell", nogil=True, error_model="numpy")
def _march_block(origins: Any, directions: Any, hits: Any, shell: Any) -> None:
    """Write hits, of rays whose origins are relative to the centre."""
    for i in range(origins.shape[0]):
        ox, oy, oz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        foot = -(ox * dx + oy * dy + oz * dz)
        hx, hy, hz = ox + foot * dx, oy + foot * dy, oz + foot * dz
        h = np.sqrt(hx * hx + hy * hy + hz * hz)
        divisor = h if h > 0.0 else 1.0
        toward = hx / divisor, hy / divisor, hz / divisor
        arc = _Arc((ox, oy, oz), (dx, dy, dz), toward, h, foot)
        if h < 1e-9:
            _march_from_center(shell, arc, hits[i])
        else:
            _march(shell, arc, hits[i])


@njit(nogil=True, error_model="numpy", forceinline=True)
def _toward(arc: Any, psi: float) -> tuple[float, float, float]:
    """Return the direction from the centre to the point of the ray at angle psi."""
    s, c = np.sin(psi), np.cos(psi)
    (hx, hy, hz), (dx, dy, dz) = arc.toward, arc.direction
    return hx * s + dx * c, hy * s + dy * c, hz * s + dz * c


@njit(nogil=True, error_model="numpy")
def _march_from_center(shell: Any, arc: Any, hit: Any) -> None:
    """Write the hit of a ray that runs through the centre, or starts there."""
    k, u, v, along = look_up(shell, arc.direction)
    if k >= 0:
        hit.reach = planar_depth(shell, k, u, v) / along + arc.foot
        hit.sure = arc.foot <= 0.0 or _distance(shell, arc.origin) > arc.foot
        _, error, _, jump = _met_at(shell, arc, arc.direction)
        hit.error = error + _MARGIN * jump


@njit(nogil=True, error_model="numpy")
def _distance(shell: Any, direction: Any) -> float:
    """Return the captured distance of the nearest pixel; 0 in a direction that was not captured."""
    k, u, v, along = look_up(shell, direction)
    x, y, z = direction
    return pixel_depth(shell, CAPTURED, k, u, v) / along * np.sqrt(x * x + y * y + z * z) if k >= 0 else 0.0


@njit(nogil=True, error_model="numpy")
def _first_seen(shell: Any, arc: Any, end: float, start: float, step: float) -> float:
    """Return the angle up to which a ray is in the views without a gap, seen from its end."""
    psi = end
    while psi < start and look_up(shell, _toward(arc, min(psi + step, start)))[0] >= 0:
        psi = min(psi + step, start)
    return psi


@njit(nogil=True, error_model="numpy")
def _march(shell: Any, arc: Any, hit: Any) -> None:  # noqa: C901, PLR0912, PLR0915 - a kernel
    """Write the hit of a ray."""
    step, h, foot = _STEP_PX / shell.focal, arc.h, arc.foot
    start = psi = np.arctan2(h, -foot)
    end = h / (2.0 * shell.most + h) if shell.most > 0 else step
    if not shell.cube:
        psi = _first_seen(shell, arc, end, start, step)
    elif h * h + foot * foot < shell.least * shell.least:  # nothing is nearer to the centre than that
        psi = np.arcsin(h / shell.least)
    was_free, first, last_step = False, True, step
    if not shell.cube and psi < start:
        hit.hidden_from, hit.hidden_to = 0.0, foot + h / np.tan(psi)
        first = False
    met_at, ahead = -1.0, np.inf
    while True:
        psi = max(psi, end)
        was_free = was_free or first
        free = False
        k, u, v, along = look_up(shell, _toward(arc, psi))
        if k >= 0:
            step = _STEP_PX / shell.lenses[k, 9]
            if was_free and shell.cube and len(shell.lenses) == len(shell.clear):
                # Of what is farther than all that is near there, each step would find the same.
                steps = int(_IN_A_CELL * CELL_PX * along * along)  # a view's px are narrower off its axis
                farthest = h / min(np.sin(psi), np.sin(max(psi - steps * step, end)))
                clear_m = shell.clear[k, int(v) // CELL_PX, int(u) // CELL_PX]
                if farthest < clear_m and psi - steps * step > end:
                    for _ in range(steps):  # to the bit
                        psi -= step
                    was_free, first, last_step, ahead = True, False, step, clear_m
                    continue
            planar = h / np.sin(psi) * along
            captured = pixel_depth(shell, CAPTURED, k, u, v)
            if planar < captured:
                free = True
                if planar >= ahead * along:
                    _note(arc, hit, psi, last_step, _passed_beside(shell, arc, psi, ahead))
                beside = pixel_depth(shell, NEAREST, k, u, v)
                ahead = beside / along
                if planar >= beside:
                    _note(arc, hit, psi, last_step, _passing(arc, psi, ahead))
            elif was_free and not (first and planar > planar_depth(shell, k, u, v) * _BEHIND):
                # A step farther: between pixels a surface can lie behind its nearest pixel.
                behind, before = max(psi - step, 0.5 * end), min(psi + (last_step + step), np.pi)
                at, gap = _refined(shell, arc, behind, before)
                if abs(gap) <= _ON_SURFACE:
                    met_at = at
                    _note(arc, hit, at, last_step, _passed_beside(shell, arc, at, ahead))
                    break
        if not free:
            seen_m = foot + h / np.tan(min(psi + last_step, np.pi - 1e-9))
            hit.hidden_from = min(hit.hidden_from, seen_m)
            hit.hidden_to = foot + h / np.tan(max(psi - step, end)) if psi > end else np.inf
        was_free, first = free, False
        if psi <= end:
            break
        psi, last_step = psi - step, step
    if met_at < 0.0 and free:
        step = _STEP_PX / shell.focal
        psi = _hidden_beyond(shell, arc, end, step)
        if psi >= 0.0:
            hit.hidden_from = min(hit.hidden_from, foot + h / np.tan(psi + step))
            hit.hidden_to = np.inf
    hit.sure = hit.hidden_from > hit.hidden_to
    if met_at >= 0.0:
        _meet(shell, arc, hit, met_at)
    elif hit.sure:
        hit.reach = np.inf
        k, u, v, _ = look_up(shell, arc.direction)
        hit.error = np.inf if shell.precision.largest_m < np.inf else error_said(shell, k, u, v)


@njit(nogil=True, error_model="numpy")
def _hidden_beyond(shell: Any, arc: Any, end: float, step: float) -> float:
    """Return the first angle from ``end`` down to 0, farther than all captured surfaces, at which one hides
    the ray; -1 if there is none."""
    psi = end
    while psi > 0.0:
        psi = max(0.0, psi - step)
        if _distance(shell, _toward(arc, psi)) < np.inf:
            return float(psi)
    return -1.0


@njit(nogil=True, error_model="numpy")
def _note(arc: Any, hit: Any, psi: float, last_step: float, passed: float) -> None:
    """Note that a ray may have met a surface beside it at a reach, since the step before an angle."""
    if passed < np.inf:
        before = arc.foot + arc.h / np.tan(min(psi + last_step, np.pi - 1e-9))
        hit.beside_from = min(hit.beside_from, max(passed, before))
        hit.beside_to = max(hit.beside_to, arc.foot + arc.h / np.tan(psi))


@njit(nogil=True, error_model="numpy")
def _passing(arc: Any, psi: float, surface_m: float) -> float:
    """Return the reach at which a ray is as far from the centre as a surface that it may have met."""
    s, c = np.sin(psi), np.cos(psi)
    away = np.sqrt(max(0.0, surface_m**2 - arc.h * arc.h))
    return float(min(arc.foot + (away if c > 0 else -away), arc.foot + arc.h * c / s))


@njit(nogil=True, error_model="numpy")
def _passed_beside(shell: Any, arc: Any, psi: float, ahead: float) -> float:
    """Return the reach at which a ray before a surface may have met a nearer one beside it; +inf if none.

    A ray that leads almost away from the centre passes much in one step: ``ahead`` is the distance from the
    centre of what was beside it, and farther, a step ago.
    """
    k, u, v, along = look_up(shell, _toward(arc, psi))
    point = surface_at(shell, k, u, v)
    own = point.inverse + point.error + _BESIDE_PX * (abs(point.across) + abs(point.down))
    beside = min(pixel_depth(shell, NEAREST, k, u, v), ahead * along)
    return _passing(arc, psi, beside / along) if beside * own < _BESIDE else np.inf


@njit(nogil=True, error_model="numpy")
def _meet(shell: Any, arc: Any, hit: Any, psi: float) -> None:
    """Write the reach and its bounds of a ray that meets a surface at angle psi."""
    s, c = np.sin(psi), np.cos(psi)
    along_ray = arc.foot + arc.h * c / s
    hit.reach, hit.error, hit.direction_error, jump = _met_at(shell, arc, _toward(arc, psi))
    if jump > 0.0:  # it may pass the edge of that surface, and meet anything behind
        hit.error = np.inf
    if abs(hit.reach - along_ray) > _ON_SURFACE * arc.h / s:  # too grazing for a plane
        hit.reach, hit.error = along_ray, hit.error + abs(hit.reach - along_ray)
    focal = shell.lenses[look_up(shell, _toward(arc, psi))[0], 9]
    if _touches(shell, arc, psi - _DEEPER_PX * _STEP_PX / focal):
        hit.error, hit.grazes = np.inf, True


@njit(nogil=True, error_model="numpy")
def _met_at(shell: Any, arc: Any, toward: Any) -> tuple[float, float, float, float]:
    """Return where a ray meets the plane through the surface in a direction from the centre.

    An error of a part of the inverse depth moves ``t = (1 - m . o) / (m . d)`` by that part of
    ``1 / (m . d)``.

    Returns:
        The reach, the bound on its error on that plane, the bound on the direction's error from the centre,
        radians, and the distance to other surfaces beside it, metres along the ray; 0 if there are none.
    """
    k, u, v, along = look_up(shell, toward)
    point = surface_at(shell, k, u, v)
    if not point.inverse > 0.0:
        return np.inf, np.inf, np.inf, 0.0
    lens = shell.lenses[k]
    focal, dx, dy = lens[9], u - lens[10], v - lens[11]
    a, b, e = plane_of(point.inverse, point.across, point.down, dx, dy, focal, focal)
    slope = start = parallel = 0.0
    for j in range(3):
        m = a * lens[j] + b * lens[3 + j] + e * lens[6 + j]
        slope += m * arc.direction[j]
        start += m * arc.origin[j]
        parallel += toward[j] * arc.direction[j]
    distance = 1.0 / (point.inverse * along)
    cosine = max(abs(slope) * distance, _LEAST_COSINE)
    off = _ROUNDED * point.error / point.inverse * distance / cosine
    aside = np.sqrt(max(0.0, 1.0 - parallel * parallel))
    reach = (1.0 - start) / slope if slope != 0.0 else np.inf
    return reach, off, off * aside / distance, point.jump / along / cosine


@njit(nogil=True, error_model="numpy")
def _touches(shell: Any, arc: Any, psi: float) -> bool:
    """Return whether a ray that met a surface is hardly behind it at an angle a little farther on."""
    k, u, v, along = look_up(shell, _toward(arc, psi))
    if psi <= 0.0 or k < 0:
        return False
    point = surface_at(shell, k, u, v)
    error = point.error / max(point.inverse, 1e-12)
    return bool(arc.h / np.sin(psi) * along * point.inverse < 1.0 + _TOUCHING * error)


@njit(nogil=True, error_model="numpy")
def _refined(shell: Any, arc: Any, behind: float, before: float) -> tuple[float, float]:
    """Return the angle between two where g changes its sign, and g there relative to the reach.

    The secant is that of inverse distances: of a plane they are almost linear in the angle. Where it fails,
    the bracket is bisected.
    """
    middle, gap, gap_behind, gap_before, seen = behind, np.inf, np.inf, -np.inf, 0.0
    for n in range(_REFINEMENTS):
        if np.isinf(gap_behind) or np.isinf(gap_before):
            guess = np.arcsin(min(1.0, arc.h * seen))  # as far from the centre as the surface last seen
            guess = guess if middle <= 0.5 * np.pi else np.pi - guess
        else:
            guess = (behind * gap_before - before * gap_behind) / (gap_before - gap_behind)
        known = n % 3 > 0 and behind < guess < before
        middle = guess if known else 0.5 * (behind + before)
        k, u, v, along = look_up(shell, _toward(arc, middle))
        if k < 0:
            return middle, np.inf
        nearness, seen = np.sin(middle) / arc.h, surface_at(shell, k, u, v).inverse * along
        gap = seen - nearness
        if abs(gap) <= _MET * nearness:
            break
        if gap > 0:
            behind, gap_behind = middle, gap
        else:
            before, gap_before = middle, gap
    return middle, gap * arc.h / np.sin(middle)
