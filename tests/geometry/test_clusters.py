"""Clusters of positions are those of every pair, and take memory in step with their number."""

import tracemalloc

import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage

from omniscv.geometry.clusters import cluster_starts

RANDOM = np.random.default_rng(5)
SETS = {
    "in a box": RANDOM.uniform(-3, 3, (300, 3)),
    "on a grid, as far apart as the distance": np.stack(
        np.meshgrid(*[np.arange(0, 4, 0.5)] * 3), axis=-1
    ).reshape(-1, 3),
    "a grid far from the origin": np.stack(np.meshgrid(*[np.arange(0, 3, 0.5)] * 3), axis=-1).reshape(-1, 3)
    + 500_000,
    "at one height": np.c_[RANDOM.uniform(-4, 4, (300, 2)), np.full(300, 1.5)],
    "crowds": np.repeat(RANDOM.uniform(-4, 4, (12, 3)), 60, axis=0) + RANDOM.normal(0, 0.15, (720, 3)),
    "two crowds that touch at one position": np.concatenate(
        [
            RANDOM.uniform(0, 0.2, (300, 3)),
            [[0.45, 0.1, 0.1]],
            RANDOM.uniform((0.8, 0, 0), (1, 0.2, 0.2), (300, 3)),
        ]
    ),
    "equal ones": np.zeros((50, 3)),
    "two": np.array([[0.0, 0, 0], [0.5, 0, 0]]),
}


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("distance", [0.07, 0.3, 0.5, 2.0])
def test_clusters_are_those_of_single_linkage(name, distance):
    positions = SETS[name]
    labels = fcluster(linkage(positions, "single"), distance, "distance")
    first = {label: index for index, label in reversed(list(enumerate(labels)))}
    expected = positions[[first[label] for label in labels]]
    np.testing.assert_array_equal(cluster_starts(positions, distance), expected)


@pytest.mark.parametrize("extent", [0.2, 2.0, 20.0, 200.0])
def test_memory_is_linear(extent):
    positions = np.random.default_rng(1).uniform(0, extent, (20_000, 3))
    tracemalloc.start()
    cluster_starts(positions, 0.5)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 20_000 * 4_000  # bytes; all pairs would be 6.4 GB
