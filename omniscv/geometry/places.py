"""Positions that belong to one place: each is within a distance of another of them."""

import numpy as np

from omniscv.geometry.pose import Array


def joined(positions_w: Array, distance_m: float) -> Array:
    """Return, for each position, the first one that steps of at most a distance join it to.

    Args:
        positions_w: (N, 3) metres, world frame.
        distance_m: of a step.
    """
    from scipy.spatial import cKDTree

    first = np.full(len(positions_w), -1)
    tree = cKDTree(positions_w) if len(positions_w) else None
    for i in range(len(first)):
        reached = [i] if first[i] < 0 else []
        while tree is not None and reached:
            for near in tree.query_ball_point(positions_w[reached.pop()], distance_m):
                if first[near] < 0:
                    first[near] = i
                    reached.append(near)
    found: Array = positions_w[first]
    return found
