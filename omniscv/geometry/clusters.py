"""Clusters of positions, in time and memory that grow with their number, however near they are to each other.

Positions are sorted into cubes whose diagonal is the distance: those of one cube are of one cluster, so only
neighbouring cubes are compared, of which a cube has at most 124. Most pairs of cubes are joined, or told
apart, by one position of each and by the boxes around their positions.
"""

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry.pose import Array

Indices = NDArray[np.integer]
Pairs = NDArray[np.integer]
"""Of cubes, (M, 2), by their numbers."""

_SMALLER = 1 - 1e-9  # of a cube's side, so that rounding does not make its diagonal too long
_LARGER = 1 + 1e-9  # of the distance, so that rounding does not part cubes that touch
_FEW = 256  # pairs of positions of two cubes, of which all are compared
_AT_A_TIME = 1 << 18  # pairs of positions that are in memory


def cluster_starts(positions_w: Array, distance_m: float) -> Array:
    """Return (N, 3): for each position the first one of its cluster.

    Args:
        positions_w: (N, 3) metres, world frame.
        distance_m: how far neighbours of a cluster are apart at most.
    """
    if len(positions_w) < 2:
        return positions_w
    clusters = _Cubes(positions_w, distance_m).clusters()
    _, first, cluster = np.unique(clusters, return_index=True, return_inverse=True)
    starts: Array = positions_w[first[cluster]]
    return starts


class _Cubes:
    """The cubes that hold positions, numbered from 0; arguments as of :func:`cluster_starts`."""

    def __init__(self, positions_w: Array, distance_m: float) -> None:
        self._distance = distance_m
        side = _SMALLER * distance_m / np.sqrt(3)
        cells = np.floor((positions_w - positions_w.min(axis=0)) / side)
        self._cells, cube, self._sizes = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        self._cube = cube.reshape(-1)
        # The positions cube by cube, and where those of a cube start.
        self._positions = positions_w[np.argsort(self._cube, kind="stable")]
        self._starts = np.cumsum(self._sizes) - self._sizes

    def clusters(self) -> Indices:
        """Return the cluster of each position, a number."""
        pairs = self._near_boxes(self._neighbours())
        joined = self._are_near(self._starts[pairs[:, 0]], self._starts[pairs[:, 1]])
        labels = self._components(pairs[joined])
        pairs = _between(pairs, labels)
        counts = self._sizes[pairs].prod(axis=1)
        few = counts <= _FEW
        labels = _merged(labels, pairs[few][self._touch(pairs[few], counts[few])])
        for pair in pairs[~few]:
            if labels[pair[0]] != labels[pair[1]] and self._touch_by_tree(*pair.tolist()):
                labels = _merged(labels, pair[None])
        return labels[self._cube]

    def _neighbours(self) -> Pairs:
        """Return the pairs of cubes that are at most two apart along each axis."""
        from scipy.spatial import cKDTree  # slow to load

        pairs: Pairs = cKDTree(self._cells).query_pairs(2.5, p=np.inf, output_type="ndarray")
        return pairs

    def _near_boxes(self, pairs: Pairs) -> Pairs:
        """Return the pairs of cubes whose positions have boxes that are near enough to each other."""
        low = np.minimum.reduceat(self._positions, self._starts)
        high = np.maximum.reduceat(self._positions, self._starts)
        left = pairs[:, 0]
        right = pairs[:, 1]
        gaps = np.maximum(low[left] - high[right], low[right] - high[left]).clip(min=0)
        near: Pairs = pairs[(gaps**2).sum(axis=1) <= (_LARGER * self._distance) ** 2]
        return near

    def _components(self, pairs: Pairs) -> Indices:
        """Return the cluster of each cube, a number, where the cubes of these pairs are of one cluster."""
        return _merged(np.arange(len(self._cells)), pairs)

    def _touch(self, pairs: Pairs, counts: Indices) -> NDArray[np.bool_]:
        """Return whether some positions of two cubes are near enough, of pairs that have so many pairs of
        positions each."""
        touch = np.zeros(len(pairs), np.bool_)
        step = _AT_A_TIME // _FEW
        for start in range(0, len(pairs), step):
            block = slice(start, start + step)
            pair = np.repeat(np.arange(len(pairs))[block], counts[block])
            ends = np.cumsum(counts[block])
            within = np.arange(len(pair)) - np.repeat(ends - counts[block], counts[block])
            cube, neighbour = pairs[pair].T
            left = self._starts[cube] + within // self._sizes[neighbour]
            right = self._starts[neighbour] + within % self._sizes[neighbour]
            touch[pair[self._are_near(left, right)]] = True
        return touch

    def _touch_by_tree(self, cube: int, neighbour: int) -> bool:
        """Return whether some positions of two cubes are near enough."""
        from scipy.spatial import cKDTree

        smaller, larger = sorted((cube, neighbour), key=lambda index: int(self._sizes[index]))
        left = self._starts[smaller] + np.arange(self._sizes[smaller])
        right = self._starts[larger] + np.arange(self._sizes[larger])
        nearest = cKDTree(self._positions[right]).query(self._positions[left])[1]
        return bool(self._are_near(left, right[nearest]).any())

    def _are_near(self, left: Indices, right: Indices) -> NDArray[np.bool_]:
        """Return whether positions are near enough to others, each to its own, by index."""
        squares = (self._positions[left] - self._positions[right]) ** 2
        near: NDArray[np.bool_] = (squares[:, 0] + squares[:, 1]) + squares[:, 2] <= self._distance**2
        return near


def _between(pairs: Pairs, labels: Indices) -> Pairs:
    """Return the pairs of cubes of two clusters."""
    between: Pairs = pairs[labels[pairs[:, 0]] != labels[pairs[:, 1]]]
    return between


def _merged(labels: Indices, pairs: Pairs) -> Indices:
    """Return the clusters of cubes by cube, after those of the cubes of these pairs were made one."""
    from scipy.sparse import coo_array  # slow to load
    from scipy.sparse.csgraph import connected_components

    ends = labels[pairs].T
    size = len(labels)
    graph = coo_array((np.ones(len(pairs)), ends), (size, size))
    merged: Indices = connected_components(graph, directed=False)[1][labels]
    return merged
