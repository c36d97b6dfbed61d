"""Edge points, grouped by straight line, in an image of unknown calibration: RANSAC with three points.

Three points determine r_vl and a line's image (``LineImages.of_three``). In
every chain of edge points the triple that most points agree with takes those points away, until too few are
left. A triple's own r_vl only groups; what all groups say of r_vl together is
:mod:`omniscv.evaluate.calibration.estimation`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omniscv.evaluate.calibration.edges import EdgePoints
from omniscv.evaluate.calibration.line_images import LineImages
from omniscv.geometry.pose import Array

_TRIPLES = 48
_NEAR_PX = 0.8
_MOST_LINES = 6  # of a chain
_MOST_POINTS = 120  # of a group, which more would not make more accurate


def group_lines(
    edges: EdgePoints, center: Array, model: LineImages, limits: tuple[float, float], least: int
) -> list[Array]:
    """Return the points, (N_i, 2) px from the centre, of what may be lines.

    Args:
        edges: of an image.
        center: (2,) px.
        model: which camera it is.
        limits: px, between which r_vl lies.
        least: points of a line.
    """
    rng = np.random.default_rng(0)
    order = np.argsort(edges.chain, kind="stable")
    counts = np.bincount(edges.chain)
    chains = np.split(edges.pixels[order] - center, np.cumsum(counts)[:-1])
    groups = []
    for points in (each for each in chains if len(each) >= least):
        left = points
        for _ in range(_MOST_LINES):
            near = _most_agreed(left, model, limits, rng)
            if near.sum() < least:
                break
            groups.append(_thinned(left[near]))
            left = left[~near]
            if len(left) < least:
                break
    return groups


def _most_agreed(
    points: Array, model: LineImages, limits: tuple[float, float], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """(N,) the points near the image of a line through three of them."""
    triples = points[rng.integers(len(points), size=(_TRIPLES, 3))]
    r_vl = model.of_three(triples, *limits)
    triples, r_vl = triples[np.isfinite(r_vl)], r_vl[np.isfinite(r_vl), None]
    if not len(triples):
        return np.zeros(len(points), np.bool_)
    rows = np.concatenate([triples, -model.alpha(np.linalg.norm(triples, axis=-1), r_vl)[..., None]], axis=-1)
    normals = np.linalg.svd(rows)[2][:, 2]
    r = np.maximum(np.linalg.norm(points, axis=-1), 1e-9)
    with np.errstate(invalid="ignore"):
        alpha, slope = model.alpha(r, r_vl), model.slope(r, r_vl)
        across = normals[:, None, :2] - normals[:, None, 2:] * slope[..., None] * (points / r[:, None])
        value = normals[:, :2] @ points.T - normals[:, 2:] * alpha
        near = np.abs(value) <= _NEAR_PX * np.linalg.norm(across, axis=-1)
    return np.asarray(near[near.sum(axis=1).argmax()])


def _thinned(points: Array) -> Array:
    return points[:: -(-len(points) // _MOST_POINTS)]
