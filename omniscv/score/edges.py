"""Edges of predicted depth: the F1 score of occluding boundaries, scale-invariant.

A step between neighbours is an edge where their depths have a ratio above a threshold. Sources: Bochkovskii
and others, Depth Pro, 2024 (:func:`boundary_f1`: of each of the four directions, thresholds 1.05 to 1.25);
Wang and others, MoGe, 2025 (:func:`windowed_f1`: of pairs within a radius).
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask

THRESHOLDS = np.linspace(1.05, 1.25, 10)
"""Ratios of depth, which are also the weights of their scores."""


def boundary_f1(
    predicted: ArrayLike, truth: ArrayLike, valid: ArrayLike | None = None, wraps: bool = False
) -> float:
    """Return the boundary F1 of Depth Pro, 0 to 1: means of recall and precision over four directions.

    Args:
        predicted: (H, W) depth above 0, of any scale.
        truth: (H, W) depth above 0.
        valid: (H, W) bool, pixels that count; steps need both neighbours. None: all, as published.
        wraps: whether the last column is beside the first one, as in a panorama; as published: not.
    """
    p = np.asarray(predicted, np.float64)
    t = np.asarray(truth, np.float64)
    known = np.ones(p.shape, np.bool_) if valid is None else np.asarray(valid, np.bool_)
    total = 0.0
    for threshold in THRESHOLDS:
        recall = 0.0
        precision = 0.0
        for first, second in _neighbours(p.shape[1], wraps):
            counted = known[first] & known[second]
            of_p = _ratio(p[first], p[second]) > threshold
            of_t = _ratio(t[first], t[second]) > threshold
            both, in_p, in_t = _matches(of_p, of_t, counted)
            recall += both / max(in_t, 1) / 4
            precision += both / max(in_p, 1) / 4
        if recall + precision > 0:
            total += threshold * 2 * recall * precision / (recall + precision)
    return float(total / THRESHOLDS.sum())


def _ratio(first: Array, second: Array) -> Array:
    """Return the ratios of neighbours; NaN where depth is none, which is no edge."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(second / first)


def _neighbours(width: int, wraps: bool) -> list[tuple[Any, Any]]:
    """Return indices of neighbours, nearer and farther, in the four directions."""
    columns = np.arange(width if wraps else width - 1)
    left = (slice(None), columns)
    right = (slice(None), (columns + 1) % width)
    above = (slice(None, -1), slice(None))
    below = (slice(1, None), slice(None))
    return [(left, right), (right, left), (above, below), (below, above)]


def windowed_f1(predicted: ArrayLike, truth: ArrayLike, valid: ArrayLike, radius: int = 1) -> float:
    """Return the boundary F1 of MoGe, 0 to 1: of a pixel and those within a radius, all of them at once.

    Args:
        predicted: (H, W) depth above 0, of any scale.
        truth: (H, W) depth above 0.
        valid: (H, W) bool.
        radius: px; pixels nearer to the border are no centres.
    """
    p = np.asarray(predicted, np.float64)
    t = np.asarray(truth, np.float64)
    known = np.asarray(valid, np.bool_)
    thresholds = np.linspace(0.05, 0.25, 10)
    counts = np.zeros((len(thresholds), 3))
    inner = _window(known, radius, 0, 0)
    p_middle = _window(p, radius, 0, 0)
    t_middle = _window(t, radius, 0, 0)
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            if u * u + v * v > radius * radius:
                continue
            counted = inner & _window(known, radius, u, v)
            p_ratio = _ratio(p_middle, _window(p, radius, u, v))
            t_ratio = _ratio(t_middle, _window(t, radius, u, v))
            for row, threshold in zip(counts, thresholds, strict=True):
                row += _matches(p_ratio > 1 + threshold, t_ratio > 1 + threshold, counted)
    both, of_p, of_t = counts.T
    precision = both / np.maximum(of_t, 1e-12)
    recall = both / np.maximum(of_p, 1e-12)
    f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-12)
    return float(thresholds @ f1 / thresholds.sum())


def _window(values: NDArray[Any], radius: int, u: int, v: int) -> NDArray[Any]:
    """Return the pixels beside those that are farther than ``radius`` from the border, (u, v) px away."""
    height, width = values.shape
    return values[radius + v : height - radius + v, radius + u : width - radius + u]


def _matches(of_p: Mask, of_t: Mask, counted: Mask) -> tuple[int, int, int]:
    """Return the counts of edges in both, in the prediction and in the truth."""
    of_p = of_p & counted
    of_t = of_t & counted
    both = np.count_nonzero(of_p & of_t)
    return int(both), int(np.count_nonzero(of_p)), int(np.count_nonzero(of_t))
