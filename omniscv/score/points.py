"""Distances between point clouds that depth describes: Chamfer distance and F-score.

Source: Knapitsch and others, Tanks and Temples, 2017 (F-score: precision is the share of predicted points
that are within a distance of a true one, recall that of true points within it of a predicted one). Chamfer is
half the sum of the mean distances both ways, metres, as UniK3D has it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import numbers
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array

DISTANCES_M = (0.05, 0.1, 0.2, 0.5)
"""Metres within which points count as met."""
MOST_POINTS = 75_000
"""Points that are compared, of every cloud: the pixels of a grid."""


@dataclass(frozen=True)
class PointScores:
    """How near two clouds are.

    Attributes:
        chamfer_m: half the sum of the mean distances, metres.
        precision, recall, f_score: by the distances that were asked for.
        distances_m: these, metres.
    """

    chamfer_m: float
    precision: tuple[float, ...]
    recall: tuple[float, ...]
    f_score: tuple[float, ...]
    distances_m: tuple[float, ...]

    def figures(self) -> dict[str, float]:
        """Return chamfer and F-scores by name, such as ``f_score_0.1m``."""
        named = {"chamfer_m": self.chamfer_m}
        for distance, score in zip(self.distances_m, self.f_score, strict=True):
            named[f"f_score_{distance:g}m"] = score
        return named


def points(predicted: ArrayLike, truth: ArrayLike, distances_m: Sequence[float] = DISTANCES_M) -> PointScores:
    """Return how near two clouds of points are.

    Args:
        predicted: (N, 3) metres.
        truth: (M, 3) metres, in the same frame.
        distances_m: within which points count as met.

    Raises:
        ArgumentError: other arrays, or clouds without points.
    """
    from scipy.spatial import KDTree

    if not (len(np.asarray(predicted)) and len(np.asarray(truth))):
        raise ArgumentError("predicted: expected clouds with points, got one without")
    p = numbers("predicted", predicted, (None, 3))
    t = numbers("truth", truth, (None, 3))
    to_truth = np.asarray(KDTree(t).query(p)[0])
    to_prediction = np.asarray(KDTree(p).query(t)[0])
    precision = [float(np.mean(to_truth < distance)) for distance in distances_m]
    recall = [float(np.mean(to_prediction < distance)) for distance in distances_m]
    scores = []
    for hit, seen in zip(precision, recall, strict=True):
        scores.append(2 * hit * seen / (hit + seen) if hit + seen else 0.0)
    chamfer = float(to_truth.mean() + to_prediction.mean()) / 2
    return PointScores(chamfer, tuple(precision), tuple(recall), tuple(scores), tuple(distances_m))


def cloud(along: Array, camera: Camera, where: ArrayLike, most: int = MOST_POINTS) -> Array:
    """Return (N, 3) points of depth along rays, camera frame, metres.

    Args:
        along: (H, W) metres along rays.
        camera: with one optical centre.
        where: (H, W) bool, pixels that have depth.
        most: points; of more pixels, those of a grid.
    """
    chosen = np.asarray(where, np.bool_)
    step = int(np.ceil(np.sqrt(np.count_nonzero(chosen) / most)))
    if step > 1:
        grid = np.zeros_like(chosen)
        grid[step // 2 :: step, step // 2 :: step] = True
        chosen = chosen & grid
    return np.asarray(along[chosen][:, None] * camera.unproject().directions[chosen])
