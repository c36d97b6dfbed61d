"""Straight lines in space by Pluecker coordinates, and their reconstruction from the rays of one image.

A line through the point p along the direction l is ``(l, m)``, ``m = p x l``: six numbers up to scale, with
``l . m = 0`` (Klein's quadric). A ray from o along d meets it where ``d . m + (o x d) . l = 0``. Each ray of
a line's image is one such linear equation. All rays of a panorama or of a mirror of revolution also meet the
axis, so that the axis is always a solution, which has to be left out.

Lines are then fitted in pixels: to first order, a pixel's distance from a line's image is the incidence of
its ray with the line over the length of that incidence's gradient in the image (Sampson's distance):

free         without further knowledge
gravity      a line is upright or level, whichever its image fits: the paper's soft Manhattan constraint
Manhattan    along the directions of the room, which the level lines give

Source: Bermudez-Cameo, Demonceaux, Lopez-Nicolas, Guerrero 2016, Line reconstruction using prior knowledge in
single non-central view; Gasparini and Caglioti 2011, Line localization from single catadioptric images.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from omniscv.cameras import Camera
from omniscv.geometry.pose import Array

_STEP_PX = 0.05  # of the finite differences for the gradient
_ROBUST_PX = 0.3
_HEADINGS = 36
_UPRIGHT = 1.1  # an upright line is preferred up to this ratio of rms: it has fewer unknowns
_KNOWN = np.zeros((0, 3))
_FAR = np.radians(5.0)  # lines farther from the room's directions follow none of them


def through(points: Array, directions: Array) -> Array:
    """Return lines (..., 6) through points (..., 3) along directions (..., 3), of unit direction."""
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.concatenate([unit, np.cross(points, unit)], axis=-1)


def incidence(origins: Array, directions: Array) -> Array:
    """Return rows (..., 6) whose product with a line is 0 where a ray meets it; metres if both are unit.

    Rays start at ``origins`` (..., 3), metres, along ``directions`` (..., 3).
    """
    return np.concatenate([np.cross(origins, directions), directions], axis=-1)


def nearest_to_rays(line: Array, origins: Array, directions: Array) -> Array:
    """Return (N, 3) the points of a ``line`` (6,) of unit direction that are nearest to rays.

    Rays start at ``origins`` (N, 3), metres, along ``directions`` (N, 3), unit.
    """
    middle = np.cross(line[:3], line[3:])  # nearest to the origin
    cosine = directions @ line[:3]
    offset = origins - middle
    along = (offset @ line[:3] - cosine * (offset * directions).sum(axis=-1)) / (1 - cosine**2)
    return np.asarray(middle + along[:, None] * line[:3])


def distance_to(line: Array, points: Array) -> Array:
    """Return (N,) the distances of points (N, 3) from a line (6,) of unit direction."""
    return np.asarray(np.linalg.norm(np.cross(points, line[:3]) - line[3:], axis=-1))


def angle_deg(a: Array, b: Array) -> float:
    """Return the angle between two lines along ``a`` and ``b``, (3,) each, 0 to 90 degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b))))


def across(direction: Array) -> Array:
    """Return (2, 3) two unit vectors across a direction (3,) and each other."""
    return np.asarray(np.linalg.svd(direction[None])[2][1:])


def free_line(rows: Array, axis: Array) -> Array:
    """Return the line (6,) that rays meet, other than the axis.

    Orthogonally to the axis A the last singular vector b is the line but for a share of the axis:
    ``L = b + t A``, and ``l . m = 0`` gives ``t = -(l_b . m_b) / (a . m_b)``.

    Args:
        rows: (N, 6), N >= 4, of rays: :func:`incidence`.
        axis: (3,) unit, through the origin: every ray meets it.
    """
    line = np.concatenate([axis, np.zeros(3)])
    basis = np.linalg.svd(line[None])[2][1:]  # (5, 6) of what is orthogonal to the axis
    b = _right_singular(rows @ basis.T)[-1] @ basis
    return _on_klein(b - line * (b[:3] @ b[3:]) / (axis @ b[3:]))


def line_along(rows: Array, direction: Array) -> Array:
    """Return the line (6,) of a known ``direction`` (3,), unit, that rays meet: two unknowns, linear.

    Its moment is orthogonal to the direction. ``rows`` are as of :func:`free_line`; N >= 2.
    """
    basis = across(direction)
    moment = np.linalg.lstsq(rows[:, 3:] @ basis.T, -rows[:, :3] @ direction, rcond=None)[0]
    return np.concatenate([direction, moment @ basis])


def level_line(rows: Array, gravity: Array) -> Array:
    """Return the line (6,) across ``gravity`` (3,), unit, that rays meet: five unknowns, and Klein's quadric.

    The two last singular vectors span what noise does not distinguish. Of the lines in this span, the one
    that the rays meet best is returned. ``rows`` are as of :func:`free_line`; N >= 4, because three rays have
    two such lines.
    """
    basis = np.zeros((5, 6))
    basis[:2, :3] = across(gravity)
    basis[2:, 3:] = np.eye(3)
    b, c = _right_singular(rows @ basis.T)[:-3:-1] @ basis
    quadric = [c[:3] @ c[3:], b[:3] @ c[3:] + c[:3] @ b[3:], b[:3] @ b[3:]]
    shares = np.roots(quadric)
    lines = [_on_klein(b + share * c) for share in shares[np.isreal(shares)].real]
    if not lines:
        return _on_klein(b)
    return min(lines, key=lambda line: float(np.linalg.norm(rows @ line)))


def effective_baseline(origins: Array, directions: Array) -> float:
    """Return the spread of the rays' origins out of the plane that fits the rays best, metres.

    Rays start at ``origins`` (N, 3), metres, along ``directions`` (N, 3). Those of a line in a central image
    lie in one plane, and do not depend on the line's distance.
    """
    normal = _right_singular(directions)[2]
    return float(np.ptp(origins @ normal))


def _on_klein(line: Array) -> Array:
    """Return the line (6,) of unit direction nearest to six numbers, with the same direction."""
    length = float(np.linalg.norm(line[:3]))
    along = line[:3] / length
    moment = line[3:] / length
    return np.concatenate([along, moment - along * (along @ moment)])


def _right_singular(rows: Array) -> Array:
    """Return the right singular vectors (K, K) of rows (N, K), completed by rows of zeros."""
    padded = np.concatenate([rows, np.zeros((rows.shape[1], rows.shape[1]))])
    return np.asarray(np.linalg.svd(padded, full_matrices=False)[2])


# -- from the pixels of an image -------------------------------------------------------------------------


class ObservedLine:
    """Pixels that show a line.

    Args:
        camera: of the image.
        pixels: (N, 2) px; those without a ray, also half a step beside them, are left out.

    Attributes:
        pixels: those with rays.
        origins: (N, 3) of their rays, metres, camera frame.
        directions: (N, 3) of their rays, unit, camera frame.
        rows: (N, 6) of their rays: :func:`incidence`.
        gradients: (N, 2, 6) the derivatives of the rows by the pixel.
    """

    def __init__(self, camera: Camera, pixels: Array) -> None:
        steps = _STEP_PX * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
        rays = camera.unproject(pixels[:, None] + steps)
        seen = rays.valid.all(axis=1)
        rows = incidence(rays.origins, rays.directions)[seen]
        self.pixels = pixels[seen]
        self.rows = rows[:, 0]
        self.origins = rays.origins[seen, 0]
        self.directions = rays.directions[seen, 0]
        self.gradients = (rows[:, 1::2] - rows[:, 2::2]) / (2 * _STEP_PX)

    def distances_px(self, line: Array) -> Array:
        """Return (N,) px, signed, of the pixels from the image of a line (6,)."""
        return np.asarray(self.rows @ line / np.linalg.norm(self.gradients @ line, axis=-1))

    def rms_px(self, line: Array) -> float:
        """Return the root mean square of :meth:`distances_px`."""
        return float(np.sqrt((self.distances_px(line) ** 2).mean()))

    def refine(self, line: Array, turns: Array) -> Array:
        """Return the line (6,) near another one whose image fits the pixels best.

        Unknown are two moves across it, metres, where the pixels see it, and tangents of its turns.

        Args:
            line: (6,) of unit direction.
            turns: (K, 3) orthonormal, across the direction: two for a free line, one for a level line, none
                for a known direction.
        """
        middle = nearest_to_rays(line, self.origins, self.directions).mean(axis=0)
        moves = across(line[:3])

        def moved(x: Array) -> Array:
            return through(middle + x[:2] @ moves, line[:3] + x[2:] @ turns)

        def residuals(x: Array) -> Array:
            return self.distances_px(moved(x))

        options: Any = {"loss": "soft_l1", "f_scale": _ROBUST_PX, "x_scale": "jac", "xtol": 1e-12}
        solution = least_squares(residuals, np.zeros(2 + len(turns)), **options)
        return moved(solution.x)


def free(observed: ObservedLine, axis: Array) -> Array:
    """Return the line (6,), camera frame, that fits the pixels of ``observed``.

    ``axis`` is (3,) unit, of the camera's revolution.
    """
    line = free_line(observed.rows, axis)
    return observed.refine(line, across(line[:3]))


def with_gravity(observed: ObservedLine, gravity: Array) -> Array:
    """Return the upright or level line (6,), camera frame, that fits the pixels of ``observed``.

    ``gravity`` is (3,) unit, camera frame.
    """
    upright = along(observed, gravity)
    starts = [level_line(observed.rows, gravity)]
    for heading in np.arange(_HEADINGS) * np.pi / _HEADINGS:
        starts.append(line_along(observed.rows, _level_direction(gravity, heading)))
    start = min(starts, key=observed.rms_px)
    turn = np.cross(gravity, start[:3])
    level = observed.refine(start, turn[None] / np.linalg.norm(turn))
    return upright if observed.rms_px(upright) <= _UPRIGHT * observed.rms_px(level) else level


def along(observed: ObservedLine, direction: Array) -> Array:
    """Return the line (6,) of a known ``direction`` (3,), unit, that fits the pixels of ``observed``; camera
    frame."""
    return observed.refine(line_along(observed.rows, direction), _KNOWN)


def manhattan(observed: Sequence[ObservedLine], lines: Sequence[Array], gravity: Array) -> list[Array]:
    """Return the lines along the room's three directions, (6,) each, camera frame.

    Args:
        observed: the pixels of each line.
        lines: of :func:`with_gravity`.
        gravity: (3,) unit, camera frame.
    """
    level = []
    for number, line in enumerate(lines):
        if abs(line[:3] @ gravity) < 0.5:
            level.append(number)
    if not level:
        return list(lines)
    heading = _common_heading([(observed[number], lines[number]) for number in level], gravity)
    first_direction = _level_direction(gravity, heading)
    second_direction = _level_direction(gravity, heading + np.pi / 2)
    aligned = list(lines)
    for number in level:
        seen = observed[number]
        candidates = [along(seen, first_direction), along(seen, second_direction)]
        aligned[number] = min(candidates, key=seen.rms_px)
    return aligned


def _common_heading(level: Sequence[tuple[ObservedLine, Array]], gravity: Array) -> float:
    """Return the median heading of level lines, radians, modulo a quarter turn, weighted by the number of
    pixels times the square of the effective baseline."""
    x, y = across(gravity)
    headings = np.empty(len(level))
    weights = np.empty(len(level))
    for number, (seen, line) in enumerate(level):
        headings[number] = np.arctan2(line[:3] @ y, line[:3] @ x)
        baseline = effective_baseline(seen.origins, seen.directions)
        weights[number] = np.square(baseline) * len(seen.pixels)
    turns = headings[:, None] - headings
    apart = np.abs(turns - np.pi / 2 * np.round(turns / (np.pi / 2)))
    return float(headings[np.argmin(np.minimum(apart, _FAR) @ weights)])


def _level_direction(gravity: Array, heading: float) -> Array:
    """Return the unit direction (3,) across gravity at a heading, radians."""
    x, y = across(gravity)
    return np.asarray(np.cos(heading) * x + np.sin(heading) * y)
