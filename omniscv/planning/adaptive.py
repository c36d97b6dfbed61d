"""Depth at a few optical centres, and at more of them where rays are occluded."""

import numpy as np

from omniscv.geometry import Array
from omniscv.planning.base import Task
from omniscv.planning.reproject import INITIAL_VIEWPOINTS, MarchedRays, Reproject

_ENOUGH = 0.003
"""Part of the rays that may stay uncertified."""
_MAX_ADDED = 8
"""Centres that a round adds at most."""
_NEIGHBOURHOODS = 128
_WORTH = 100
"""Rays that a new centre must promise to resolve: fewer are cheaper left unsure."""


class Adaptive(Reproject):
    """Add centres at the origins of the rays whose neighbourhoods hold the most uncertified ones.

    Until almost none is left, or more centres hardly help.
    """

    name = "adaptive"
    max_rounds = 5

    def next_centers(self, rays: MarchedRays) -> list[Array]:
        unsure = ~rays.met.sure
        if unsure.mean() <= _ENOUGH:
            return []
        groups = int(rays.own.max()) + 1
        reach = max(1, groups // _NEIGHBOURHOODS)
        count = np.bincount(rays.own[unsure], minlength=groups).astype(np.float64)
        before = np.concatenate([[0.0], np.cumsum(count)])
        at = np.arange(groups)
        around = before[np.minimum(at + reach + 1, groups)] - before[np.maximum(at - reach, 0)]
        last_of = np.full(groups, -1)
        last_of[rays.own] = np.arange(len(rays.own))
        centers_w: list[Array] = []
        while len(centers_w) < _MAX_ADDED and around.max() >= _WORTH:
            best = int(np.argmax(around))
            centers_w.append(rays.origins_w[last_of[best]])
            around[max(0, best - 2 * reach) : best + 2 * reach + 1] = 0
        return centers_w

    def further_views(self, task: Task) -> tuple[int, int]:
        if len(task.groups(INITIAL_VIEWPOINTS)) < 2:
            return 0, 0
        # An estimate: one round's centres; at most: all rounds', and every one of the camera's own.
        added, own = 6 * _MAX_ADDED, 6 * len(task.rays.own.centers)
        return added, (self.max_rounds - 1) * added + own
