"""The lines of one non-central image in three ways: free, with known gravity, and along a room's directions.

With gravity a line is upright or level, whichever its image fits: the paper's soft Manhattan constraint. The
level lines then also give the directions of the room, which are those of a Manhattan world.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from omniscv.evaluate.lines.noncentral import effective_baseline, free_line, level_line, line_along
from omniscv.evaluate.lines.refinement import ObservedLine
from omniscv.geometry.pose import Array

_HEADINGS = 36
_UPRIGHT = 1.1  # times the rms of the best level line: so far an upright one, with less unknowns, is taken
_KNOWN = np.zeros((0, 3))
_FAR = np.radians(5.0)  # a line so far off the room's directions has none of them


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
    pairs = list(zip(observed, lines, strict=True))
    level = [(each, line) for each, line in pairs if _is_level(line, gravity)]
    if not level:
        return list(lines)
    heading = _heading(level, gravity)
    x, y = np.linalg.svd(gravity[None])[2][1:]
    directions = [np.cos(a) * x + np.sin(a) * y for a in (heading, heading + np.pi / 2)]
    return [
        min((along(each, direction) for direction in directions), key=each.rms_px)
        if _is_level(line, gravity)
        else line
        for each, line in pairs
    ]


def along(observed: ObservedLine, direction: Array) -> Array:
    """Return the line (6,) of a known direction (3,), unit, camera frame."""
    return observed.refined(line_along(observed.rows, direction), _KNOWN)


def _is_level(line: Array, gravity: Array) -> bool:
    return bool(abs(line[:3] @ gravity) < 0.5)


def _heading(level: Sequence[tuple[ObservedLine, Array]], gravity: Array) -> float:
    """The heading, modulo a quarter-turn, of the level line that the others are nearest to: their median,
    weighted by pixels and the square of the effective baseline."""
    x, y = np.linalg.svd(gravity[None])[2][1:]
    headings = np.array([np.arctan2(line[:3] @ y, line[:3] @ x) for _, line in level])
    turns = headings[:, None] - headings
    apart = np.abs(turns - np.pi / 2 * np.round(turns / (np.pi / 2)))
    baselines = np.array([effective_baseline(each.origins, each.directions) for each, _ in level])
    weights = baselines**2 * [len(each.pixels) for each, _ in level]
    return float(headings[np.argmin(np.minimum(apart, _FAR) @ weights)])


def _level_directions(gravity: Array, count: int) -> list[Array]:
    """Directions across gravity, all around a half-turn."""
    x, y = np.linalg.svd(gravity[None])[2][1:]
    return [np.cos(a) * x + np.sin(a) * y for a in np.arange(count) * np.pi / count]
