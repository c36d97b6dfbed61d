"""A layout from one panorama without learned weights: lines propose rooms, lines and colours judge them.

1. straight segments, and the room's heading from them (:mod:`panorama_lines`, :mod:`manhattan`);
2. how much speaks for an edge at each pixel (:mod:`layout_evidence`);
3. the best room of 4 walls, and that of 6, by lines (:mod:`room_search`);
4. from each of the two, again and again the best room by lines and by the colours that the surfaces of the
   last one have (:mod:`surface_colors`), with distances between those of the search's grid (:func:`refined`);
5. the one of the two whose own surfaces differ more in colour, and whose edges show more.

Only the colour image goes in. It is upright and shows a room of upright walls at right angles.
"""

from __future__ import annotations

from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from omniscv.evaluate.layout_evidence import Evidence, evidence
from omniscv.evaluate.room_hypotheses import Hypothesis, Support, score
from omniscv.evaluate.room_search import best_rooms
from omniscv.evaluate.surface_colors import region_support
from omniscv.geometry.pose import Array

_WIDTH = 512  # at most, or half the panorama's, in 16ths
_UPPER, _LOWER = 1.0, 0.6  # furniture hides lower edges more than upper ones
_PER_CORNER, _CHANCE = 0.03, 0.4  # of the width; of the pixels of an upright edge
_MORE_WALLS = 0.08  # of the width: what two more walls must add to the score
_ROUNDS = 2
_REFINED = 2  # rooms of six walls
_LEAST_LENGTH, _BETTER = 0.1, 1e-9  # an inner corner's coordinate may be near 0; no steps back and forth
_STEPS = (0.04, 0.02, 0.01, 0.005, 0.0025)


def predict(lit: NDArray[np.uint8]) -> Array:
    """Return the corners of the room in a panorama as :mod:`omniscv.truth.cor_id` orders them, (2N, 2) px.

    Args:
        lit: (H, W, 3) RGB, W = 2 H.
    """
    seen = evidence(lit, min(_WIDTH, lit.shape[1] // 32 * 16))
    edges = edge_support(seen)
    four, *six = best_rooms(edges)
    found = []
    for start in (four, *sorted(six, key=lambda room: score(room, edges))[-1:]):
        room = refined(start, edges)
        for _ in range(_ROUNDS):
            room = chosen(region_support(edges, seen.colors, room))
        found.append((merit(room, region_support(edges, seen.colors, room)), room))
    _, best = max(found, key=itemgetter(0))
    return corner_pixels(best, seen.azimuth, lit.shape[1])


def edge_support(seen: Evidence) -> Support:
    """Return what lines alone say."""
    across = seen.lines[[1, 0, 1, 0]]  # the edges of a wall run across its direction
    upright = np.concatenate([np.zeros((1, seen.lines.shape[2])), np.cumsum(seen.lines[2], axis=0)])
    return Support(_UPPER * across, _LOWER * across, upright, _PER_CORNER * seen.lines.shape[2], _CHANCE)


def merit(room: Hypothesis, support: Support) -> float:
    """Return the score of a room, less a margin for six walls, which can follow more lines by chance."""
    return score(room, support) - (0 if room.quadrant is None else _MORE_WALLS * support.upper.shape[2])


def chosen(support: Support) -> Hypothesis:
    """Return the best room."""
    four, *six = best_rooms(support)
    likely = [four, *sorted(six, key=lambda room: score(room, support))[-_REFINED:]]
    return max((refined(room, support) for room in likely), key=lambda room: merit(room, support))


def refined(room: Hypothesis, support: Support) -> Hypothesis:
    """Return the room with its lengths changed one by one, and all at once, in steps that become smaller.

    All at once moves the lower edges and leaves the upper ones.
    """
    best, values = score(room, support), np.array([*room.walls, room.height])
    for step in _STEPS:
        changed = True
        while changed:
            changed = False
            alone = np.diag(np.abs(values) + _LEAST_LENGTH)
            for way in (*alone, *-alone, values, -values):
                moved = values + step * way
                other = Hypothesis(room.quadrant, tuple(moved[:-1].tolist()), float(moved[-1]))
                if other.is_room() and (value := score(other, support)) > best + _BETTER:
                    best, values, room, changed = value, moved, other, True
    return room


def corner_pixels(room: Hypothesis, azimuth: float, width: int) -> Array:
    """Return (2N, 2) px: pairs of ceiling and floor, clockwise from above, the leftmost first."""
    plan = room.corners()
    theta = np.arctan2(plan[:, 1], plan[:, 0]) + azimuth
    u = (theta / (2 * np.pi) + 0.5) % 1.0 * width
    away = np.hypot(*plan.T)
    rows = [(0.5 - np.arctan(z / away) / np.pi) * width / 2 for z in (room.height, -1.0)]
    pairs = np.stack([np.column_stack([u, v]) for v in rows], axis=1) - 0.5
    return np.asarray(np.roll(pairs, -int(u.argmin()), axis=0).reshape(-1, 2))
