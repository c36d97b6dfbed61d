"""The best room of 4 or 6 walls, over all distances of a grid: exact, by dynamic programming.

Going around the room, what speaks for a wall depends on its distance and on where it begins and ends, which
is where it meets its neighbours. So the score is a sum of terms of neighbours, and its maximum over all rooms
of a grid is had wall by wall (as in Flint, Murray and Reid, Manhattan scene understanding, 2011).
"""

from __future__ import annotations

from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.evaluate.room_hypotheses import Hypothesis, Support, row_of, upright_score
from omniscv.geometry.pose import Array

_STEP = 0.08
"""Distances, and heights, of the grid differ by this share."""
DISTANCES = np.exp(np.arange(np.log(0.3), np.log(7.0), _STEP))
HEIGHTS = np.exp(np.arange(np.log(0.45), np.log(2.0), _STEP))

_APART = 2  # steps that an L's inner corner is nearer than the outer one along both axes: see LARGEST_INNER
_NEAR = 3  # steps of height that the best L is off the best room of 4 walls, whose ceiling is the same
_EVERY = 4  # columns from one where an L's wall may hide the one behind it to the next


class _Ring(NamedTuple):
    """The terms of the score for one height of the ceiling.

    Attributes:
        sums: (4, A, W / 2 + 1) what speaks for a wall from its leftmost column to before each.
        meets: (4, A, A) of a wall and the next one to the right that meet in a corner of the room.
        turns: (4, A, A) of the next one to the right, coming before a wall, in a corner that stands out.
        ends: (4, A, W / 16) of a wall that ends before the one behind it, at columns from its middle on.
        column: (A, A) where two walls at distances meet, in the half turn of the first.
    """

    sums: Array
    meets: Array
    turns: Array
    ends: Array
    column: NDArray[np.intp]


def best_rooms(support: Support) -> list[Hypothesis]:
    """Return the best room of 4 walls, and the best L for each corner cut out and each way to see it."""
    rings = [_ring(support, height) for height in HEIGHTS.tolist()]
    fours = [_four_walls(ring, height) for ring, height in zip(rings, HEIGHTS.tolist(), strict=True)]
    best = max(range(len(fours)), key=lambda i: fours[i][0])
    near = range(max(0, best - _NEAR), min(len(rings), best + _NEAR + 1))
    mirrored = _mirrored(support)
    found: dict[tuple[str, int], tuple[float, Hypothesis]] = {}
    for i in near:
        height = float(HEIGHTS[i])
        other = _ring(mirrored, height)
        for quadrant in range(4):
            options = {
                "open": _open_l(rings[i], quadrant, height),
                "hidden": _hidden_l(rings[i], quadrant, height),
                "mirrored": _hidden_l(other, quadrant, height),
            }
            for kind, option in options.items():
                found[kind, quadrant] = max(found.get((kind, quadrant), option), option, key=itemgetter(0))
    sixes = [_reflected(room) if kind == "mirrored" else room for (kind, _), (_, room) in found.items()]
    return [fours[best][1], *(room for room in sixes if room.quadrant is not None)]


def _ring(support: Support, height: float) -> _Ring:
    _, rows, columns = support.upper.shape
    half, quarter = columns // 2, columns // 4
    local = (np.arange(half) + 0.5) * 2 * np.pi / columns - np.pi / 2
    slope = np.cos(local) / DISTANCES[:, None]
    above, below = (row_of(each, rows).astype(np.intp) for each in (height * slope, -slope))
    sums = np.zeros((4, len(DISTANCES), half + 1))
    for k in range(4):
        column = (np.arange(half) + (k - 1) * quarter) % columns
        np.cumsum(
            support.upper[k][above, column] + support.lower[k][below, column], axis=1, out=sums[k, :, 1:]
        )
    distance = np.hypot(DISTANCES[:, None], DISTANCES)
    at = np.round(np.arctan2(DISTANCES, DISTANCES[:, None]) / (2 * np.pi) * columns).astype(np.intp) + quarter
    meets, turns = np.zeros((4, *at.shape)), np.zeros((4, *at.shape))
    ends = np.zeros((4, len(DISTANCES), quarter // _EVERY))
    i, j = np.indices(at.shape)
    oblique = np.hypot(DISTANCES[:, None], DISTANCES[:, None] * np.tan(local[quarter::_EVERY]))
    for k in range(4):
        upright = upright_score(support, distance, (at + (k - 1) * quarter) % columns, height)
        change = sums[k][i, at] - sums[(k + 1) % 4][j, at - quarter]
        meets[k], turns[k] = change + upright, upright - change
        right = (np.arange(0, quarter, _EVERY) + k * quarter) % columns
        ends[k] = sums[k][:, quarter:-1:_EVERY] + upright_score(support, oblique, right, height)
    return _Ring(sums, meets, turns, ends, at)


def _four_walls(ring: _Ring, height: float) -> tuple[float, Hypothesis]:
    front, back = _joined(*ring.meets[:2]), _joined(*ring.meets[2:])
    total = front + back.T
    i, k = _best(total)
    (j,) = _best(ring.meets[0][i] + ring.meets[1][:, k])
    (m,) = _best(ring.meets[2][k] + ring.meets[3][:, i])
    return float(total[i, k]), Hypothesis(None, tuple(DISTANCES[[i, j, k, m]].tolist()), height)


def _open_l(ring: _Ring, quadrant: int, height: float) -> tuple[float, Hypothesis]:
    """An L whose six walls are all seen: the inner corner lies ahead along both axes."""
    first, second, third, fourth = np.roll(ring.meets, -quadrant, axis=0)
    count = len(DISTANCES)
    inner = first[:, :, None] + ring.turns[quadrant].T  # (a, inner_b, inner_a)
    inner = np.where(np.tri(count, count, -_APART, dtype=bool)[:, None, :], inner, -np.inf)  # inner_a < a
    nearer = np.full(inner.shape, -np.inf)  # (a, b, inner_a), the best inner_b < b
    np.maximum.accumulate(inner[:, :-_APART], axis=1, out=nearer[:, _APART:])
    around = _joined(_joined(second, third), fourth)  # (b, a)
    total = (nearer + first.T).max(axis=2) + around.T
    a, b = _best(total)
    if not np.isfinite(total[a, b]):
        return -np.inf, Hypothesis(None, (1.0,) * 4, height)
    inner_b, inner_a = _best(inner[a, : b - _APART + 1] + first[:, b])
    c, d = _best(second[b][:, None] + third + fourth[:, a])
    return float(total[a, b]), _l(quadrant, DISTANCES[[a, b, c, d, inner_a, inner_b]], height)


def _hidden_l(ring: _Ring, quadrant: int, height: float) -> tuple[float, Hypothesis]:
    """An L in which one wall beside the inner corner faces away, and hides a part of the wall behind it."""
    first, second, third, fourth = np.roll(ring.meets, -quadrant, axis=0)
    wall, count = (quadrant + 1) % 4, len(DISTANCES)
    stops, quarter = ring.ends.shape[2], ring.sums.shape[2] // 2
    # (inner_b, b, column): the wall at inner_b ends there, the one at b > inner_b comes after it.
    change = ring.ends[wall][:, None] - ring.sums[wall][None, :, quarter:-1:_EVERY]
    change = np.where(np.tri(count, count, -_APART, dtype=bool).T[:, :, None], change, -np.inf)
    best = np.maximum.accumulate(change, axis=2)
    last = np.clip(
        (ring.column - quarter) // _EVERY - 1, 0, stops - 1
    )  # (b, c): before the corner of b and c
    through = best[:, np.arange(count)[:, None], last] + second  # (inner_b, b, c)
    hidden = through.max(axis=1)
    total = _joined(first, hidden) + _joined(third, fourth).T
    a, c = _best(total)
    if not np.isfinite(total[a, c]):
        return -np.inf, Hypothesis(None, (1.0,) * 4, height)
    (inner_b,) = _best(first[a] + hidden[:, c])
    (b,) = _best(through[inner_b, :, c])
    (column,) = _best(change[inner_b, b, : last[b, c] + 1])
    (d,) = _best(third[c] + fourth[:, a])
    inner_a = -DISTANCES[inner_b] * np.tan((column + 0.1) / stops * np.pi / 2)
    walls = [*DISTANCES[[a, b, c, d]], inner_a, DISTANCES[inner_b]]
    return float(total[a, c]), _l(quadrant, np.array(walls), height)


def _l(quadrant: int, walls: Array, height: float) -> Hypothesis:
    """The hypothesis of distances from the quadrant's first wall on."""
    ordered = np.append(np.roll(walls[:4], quadrant), walls[4:])
    return Hypothesis(quadrant, tuple(ordered.tolist()), height)


def _mirrored(support: Support) -> Support:
    """Left for right: the walls of directions 1 and 3 are exchanged."""
    upper, lower = (each[[0, 3, 2, 1], :, ::-1] for each in (support.upper, support.lower))
    return support._replace(upper=upper, lower=lower, upright=support.upright[:, ::-1])


def _reflected(room: Hypothesis) -> Hypothesis:
    """The room of which a mirror shows this one."""
    if room.quadrant is None:
        return room
    a, b, c, d, inner_a, inner_b = room.walls
    return Hypothesis(3 - room.quadrant, (a, d, c, b, inner_b, inner_a), room.height)


def _joined(first: Array, second: Array) -> Array:
    """(A, C) the best sum over what is between: of (A, B) and (B, C)."""
    return np.asarray((first[:, :, None] + second).max(axis=1))


def _best(values: Array) -> tuple[np.intp, ...]:
    return np.unravel_index(values.argmax(), values.shape)
