"""Lines of one non-central image in three ways: free, with known gravity, and along a room's directions.

Lines are fitted in pixels. To first order, a pixel's distance from a line's image is the incidence of its ray
with the line over the length of that incidence's gradient in the image (Sampson's distance). This needs only
the camera's rays, and is the same for panoramas and mirrors.

With gravity a line is upright or level, whichever its image fits: the paper's soft Manhattan constraint. The
level lines then also give the directions of the room, those of a Manhattan world.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from omniscv.cameras import Camera
from omniscv.evaluate.lines import plucker
from omniscv.geometry.pose import Array

_STEP_PX = 0.05  # of the finite differences for the gradient
_ROBUST_PX = 0.3
_HEADINGS = 36
_UPRIGHT = 1.1  # an upright line is preferred up to this ratio of rms: it has fewer unknowns
_KNOWN = np.zeros((0, 3))
_FAR = np.radians(5.0)  # lines farther from the room's directions follow none of them


class ObservedLine:
    """Pixels that show a line.

    Args:
        camera: of the image.
        pixels: (N, 2) px; those without a ray, also half a step beside them, are left out.

    Attributes:
        pixels: those with rays.
        origins, directions: (N, 3) of their rays, camera frame.
        rows: (N, 6) of their rays: :func:`omniscv.evaluate.lines.plucker.incidence`.
        gradients: (N, 2, 6) the derivatives of the rows by the pixel.
    """

    def __init__(self, camera: Camera, pixels: Array) -> None:
        steps = _STEP_PX * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
        rays = camera.unproject(pixels[:, None] + steps)
        seen = rays.valid.all(axis=1)
        rows = plucker.incidence(rays.origins, rays.directions)[seen]
        self.pixels, self.rows = pixels[seen], rows[:, 0]
        self.origins, self.directions = rays.origins[seen, 0], rays.directions[seen, 0]
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
        middle = plucker.nearest_to_rays(line, self.origins, self.directions).mean(axis=0)
        moves = plucker.across(line[:3])

        def moved(x: Array) -> Array:
            return plucker.through(middle + x[:2] @ moves, line[:3] + x[2:] @ turns)

        def residuals(x: Array) -> Array:
            return self.distances_px(moved(x))

        solution = least_squares(
            residuals,
            np.zeros(2 + len(turns)),
            loss="soft_l1",
            f_scale=_ROBUST_PX,
            x_scale="jac",
            xtol=1e-12,
        )
        return moved(solution.x)


def free(observed: ObservedLine, axis: Array) -> Array:
    """Return a line (6,), camera frame; ``axis`` is (3,) unit, of the camera's revolution."""
    line = plucker.free_line(observed.rows, axis)
    return observed.refine(line, plucker.across(line[:3]))


def with_gravity(observed: ObservedLine, gravity: Array) -> Array:
    """Return an upright or level line (6,), camera frame; gravity is (3,) unit."""
    upright = along(observed, gravity)
    headings = np.arange(_HEADINGS) * np.pi / _HEADINGS
    directions = [_level_direction(gravity, heading) for heading in headings]
    starts = [plucker.line_along(observed.rows, direction) for direction in directions]
    start = min([plucker.level_line(observed.rows, gravity), *starts], key=observed.rms_px)
    turn = np.cross(gravity, start[:3])
    level = observed.refine(start, turn[None] / np.linalg.norm(turn))
    return upright if observed.rms_px(upright) <= _UPRIGHT * observed.rms_px(level) else level


def along(observed: ObservedLine, direction: Array) -> Array:
    """Return the line (6,) of a known direction (3,), unit, camera frame."""
    return observed.refine(plucker.line_along(observed.rows, direction), _KNOWN)


def manhattan(observed: Sequence[ObservedLine], lines: Sequence[Array], gravity: Array) -> list[Array]:
    """Return the lines along the room's three directions, camera frame.

    Args:
        observed: their pixels.
        lines: (6,) each, from :func:`with_gravity`.
        gravity: (3,) unit.
    """
    level = [i for i, line in enumerate(lines) if abs(line[:3] @ gravity) < 0.5]
    if not level:
        return list(lines)
    heading = _common_heading([(observed[i], lines[i]) for i in level], gravity)
    directions = [_level_direction(gravity, heading + turn) for turn in (0.0, np.pi / 2)]
    aligned = list(lines)
    for i in level:
        candidates = [along(observed[i], direction) for direction in directions]
        aligned[i] = min(candidates, key=observed[i].rms_px)
    return aligned


def _common_heading(level: Sequence[tuple[ObservedLine, Array]], gravity: Array) -> float:
    """Return the median heading of level lines, radians, modulo a quarter turn.

    A line's weight is its number of pixels times the square of its effective baseline.
    """
    x, y = plucker.across(gravity)
    headings = np.array([np.arctan2(line[:3] @ y, line[:3] @ x) for _, line in level])
    turns = headings[:, None] - headings
    apart = np.abs(turns - np.pi / 2 * np.round(turns / (np.pi / 2)))
    baselines = [plucker.effective_baseline(seen.origins, seen.directions) for seen, _ in level]
    weights = np.square(baselines) * [len(seen.pixels) for seen, _ in level]
    return float(headings[np.argmin(np.minimum(apart, _FAR) @ weights)])


def _level_direction(gravity: Array, heading: float) -> Array:
    """Return the unit direction (3,) across gravity at a heading, radians."""
    x, y = plucker.across(gravity)
    return np.asarray(np.cos(heading) * x + np.sin(heading) * y)
