"""Rooms that a panorama may show, of 4 or 6 walls in Manhattan directions, and the score of one.

Lengths are in heights of the camera above the floor. A hypothesis is in the frame of the heading: the first
axis along it, the second to its right; wall directions 0 to 3 are those two axes and their opposites, to the
right in turn, and so are azimuths.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry.pose import Array

AXES = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
LARGEST_INNER = 0.86
"""Of the distance of an L's outer walls: a smaller step in a wall is not told from furniture at a wall."""
_SAME = 1e-9
_ON_WALL = 1.02  # of a wall's distance: a corner so far away is not behind it


class Support(NamedTuple):
    """What speaks for a layout, by row and column of the turned panorama; all float64.

    Attributes:
        upper, lower: (4, H, W) for the upper and the lower edge of a wall of a direction to be at a pixel.
        upright: (H + 1, W) sum of what speaks for upright edges, from the top row to before each.
        per_corner: weight of an upright edge whose every pixel is a line, in columns.
        chance: share of pixels of an upright edge that are lines by chance: an edge needs more.
    """

    upper: Array
    lower: Array
    upright: Array
    per_corner: float
    chance: float


class Hypothesis(NamedTuple):
    """A room around the camera.

    Attributes:
        quadrant: which corner, from direction ``quadrant`` to the next, is cut out of an L; None of 4 walls.
        walls: (4,) distances of the walls of each direction; then, of an L, (2,) coordinates of the inner
            corner along the axes of the quadrant.
        height: of the ceiling above the camera.
    """

    quadrant: int | None
    walls: tuple[float, ...]
    height: float

    def corners(self) -> Array:
        """(N, 2) the plan, clockwise from above."""
        a, b, c, d = self.walls[:4]
        if self.quadrant is None:
            return np.array([[a, b], [-c, b], [-c, -d], [a, -d]])
        order = [(self.quadrant + i) % 4 for i in range(4)]
        a, b, c, d = (self.walls[i] for i in order)
        inner_a, inner_b = self.walls[4:]
        plan = np.array([[a, inner_b], [inner_a, inner_b], [inner_a, b], [-c, b], [-c, -d], [a, -d]])
        return np.asarray(plan @ AXES[order[:2]])

    def is_room(self) -> bool:
        """Whether the camera is inside, and an L's inner corner between it and the outer one."""
        if min(self.walls[:4]) <= 0 or self.height <= 0:
            return False
        if self.quadrant is None:
            return True
        a, b, c, d = (self.walls[(self.quadrant + i) % 4] for i in range(4))
        inner_a, inner_b = self.walls[4:]
        return (
            -c < inner_a < LARGEST_INNER * a
            and -d < inner_b < LARGEST_INNER * b
            and max(inner_a, inner_b) > 0
        )


def visible_walls(corners: Array, azimuths: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the direction of the wall that is seen at azimuths (W,), and how far it is on the plan; (W,)."""
    ahead = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    nearest, direction = np.full(len(azimuths), np.inf), np.zeros(len(azimuths), np.intp)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - start
        axis = int(np.abs(along[0]) > np.abs(along[1]))  # that the wall is square to
        if np.abs(start[axis]) < _SAME:
            continue
        with np.errstate(divide="ignore"):
            away = start[axis] / ahead[:, axis]
        at = away * ahead[:, 1 - axis]
        low, high = sorted((start[1 - axis], end[1 - axis]))
        hit = (away > 0) & (at >= low) & (at <= high) & (away < nearest)
        nearest[hit], direction[hit] = away[hit], axis + 2 * (start[axis] < 0)
    return direction, nearest


def score(hypothesis: Hypothesis, support: Support) -> float:
    """Return how much speaks for a room: a sum over columns and over the upright edges that are seen."""
    _, rows, columns = support.upper.shape
    azimuths = (np.arange(columns) + 0.5) * 2 * np.pi / columns
    corners = hypothesis.corners()
    direction, away = visible_walls(corners, azimuths)
    if not np.isfinite(away).all():
        return -np.inf
    at = np.arange(columns)
    above = row_of(hypothesis.height / away, rows).astype(np.intp)
    below = row_of(-1 / away, rows).astype(np.intp)
    total = support.upper[direction, above, at].sum() + support.lower[direction, below, at].sum()
    distance, azimuth = np.hypot(*corners.T), np.arctan2(corners[:, 1], corners[:, 0])
    column = (azimuth / (2 * np.pi) * columns).astype(np.intp) % columns
    seen = distance <= np.maximum(away[column - 1], away[(column + 1) % columns]) * _ON_WALL
    return float(total + upright_score(support, distance, column, hypothesis.height)[seen].sum())


def upright_score(support: Support, distance: Array, column: NDArray[np.intp], height: float) -> Array:
    """(...) what speaks for upright edges at distances, in columns."""
    rows = len(support.upright) - 1
    above = row_of(height / distance, rows).astype(np.intp)
    below = row_of(-1 / distance, rows).astype(np.intp)
    share = (support.upright[below, column] - support.upright[above, column]) / np.maximum(below - above, 1)
    return np.asarray(support.per_corner * (share - support.chance))


def row_of(slope: Array, rows: int) -> Array:
    """Return v, px, of rays that rise by ``slope``; less than ``rows``."""
    return np.minimum((0.5 - np.arctan(slope) / np.pi) * rows, rows - 1e-6)
