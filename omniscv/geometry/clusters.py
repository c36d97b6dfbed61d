"""Clusters of positions, within which steps of limited length lead from each position to each other."""

import numpy as np

from omniscv.geometry.pose import Array


def cluster_starts(positions_w: Array, distance_m: float) -> Array:
    """Return, for each position, the first position of its cluster.

    Args:
        positions_w: (N, 3) metres, world frame.
        distance_m: the longest step between two positions of a cluster.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    count = len(positions_w)
    if not count:
        return positions_w
    pairs = cKDTree(positions_w).query_pairs(distance_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), (count, count))
    _, first, cluster = np.unique(
        connected_components(graph, directed=False)[1], return_index=True, return_inverse=True
    )
    starts: Array = positions_w[first[cluster]]
    return starts
