"""The lines of one non-central image in three ways: free, with known gravity, and along a room's directions.

With gravity a line is upright or level, whichever its image fits: the paper's soft Manhattan constraint. The
level lines then also give the directions of the room, which are those of a Manhattan world.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from omniscv.evaluate.line_refinement import ObservedLine
from omniscv.evaluate.noncentral_lines import effective_baseline, free_line, level_line, line_along
from omniscv.geometry.pose import Array

_HEADINGS = 36
_UPRIGHT = 1.1  # times the rms of the best level line: so far an upright one, with less unknowns, is taken
_KNOWN = np.zeros((0, 3))


def free(observed: ObservedLine, axis: Array) -> Array:
    """Return a line (6,), camera frame.

    Args:
        observed: its pixels.
        axis: (3,) unit, of the camera's revolution.
    """
    line = free_line(observed.rows, axis)
    return observed.refined(line, np.linalg.svd(line[None, :3])[2][1:])


def with_gravity(observed: ObservedLine, gravity: Array) -> Array:
    """Return an upright or level line (6,), camera frame; gravity is (3,) unit."""
    upright = observed.refined(line_along(observed.rows, gravity), _KNOWN)
    starts = [level_line(observed.rows, gravity)]
    starts += [line_along(observed.rows, each) for each in _level_directions(gravity, _HEADINGS)]
    start = min(starts, key=observed.rms_px)
    turn = np.cross(gravity, start[:3])
    level = observed.refined(start, turn[None] / np.linalg.norm(turn))
    return upright if observed.rms_px(upright) <= _UPRIGHT * observed.rms_px(level) else level


def manhattan(observed: Sequence[ObservedLine], lines: Sequence[Array], gravity: Array) -> list[Array]:
    """Return the lines along the room's three directions, camera frame.

    Args:
        observed: their pixels.
        lines: (6,) each, as :func:`with_gravity` finds them.
        gravity: (3,) unit.
    """
    level = [abs(line[:3] @ gravity) < 0.5 for line in lines]
    if not any(level):
        return list(lines)
    x, y = np.linalg.svd(gravity[None])[2][1:]
    fourfold = 0j
    for each, line, is_level in zip(observed, lines, level, strict=True):
        if is_level:
            weight = effective_baseline(each.origins, each.directions) ** 2
            fourfold += weight * np.exp(4j * np.arctan2(line[:3] @ y, line[:3] @ x))
    heading = np.angle(fourfold) / 4
    directions = [np.cos(a) * x + np.sin(a) * y for a in (heading, heading + np.pi / 2)]
    return [
        min((along(each, direction) for direction in directions), key=each.rms_px) if is_level else line
        for each, line, is_level in zip(observed, lines, level, strict=True)
    ]


def along(observed: ObservedLine, direction: Array) -> Array:
    """Return the line (6,) of a known direction (3,), unit, camera frame."""
    return observed.refined(line_along(observed.rows, direction), _KNOWN)


def _level_directions(gravity: Array, count: int) -> list[Array]:
    """Directions across gravity, all around a half-turn."""
    x, y = np.linalg.svd(gravity[None])[2][1:]
    return [np.cos(a) * x + np.sin(a) * y for a in np.arange(count) * np.pi / count]
