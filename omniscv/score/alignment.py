"""Predictions without a known scale, aligned with the truth as papers do it."""

import numpy as np

from omniscv.arguments import one_of
from omniscv.geometry import Array

ALIGNMENTS = ("none", "median", "scale", "scale-shift", "disparity-scale-shift")
"""``median``: by the ratio of medians. ``scale``: by least squares of depth. ``scale-shift``: of depth,
with an offset (MiDaS, Ranftl and others 2020). ``disparity-scale-shift``: of 1 / depth, with an offset,
then depth."""


def align(predicted: Array, truth: Array, weights: Array, how: str) -> Array:
    """Return predictions (N,) with the scale, and offset, of the truth; 0 and less where an offset leaves
    none.

    Args:
        predicted: (N,) metres, positive.
        truth: (N,) metres, positive.
        weights: (N,) of each pixel; medians count pixels, as papers do.
        how: one of :data:`ALIGNMENTS`.

    Raises:
        ArgumentError: an unknown alignment.
    """
    one_of("align", how, ALIGNMENTS)
    if how == "none" or not len(predicted):
        return predicted
    if how == "median":
        return np.asarray(predicted * (np.median(truth) / np.median(predicted)))
    if how == "scale":
        return np.asarray(predicted * ((weights * predicted * truth).sum() / (weights * predicted**2).sum()))
    if how == "scale-shift":
        scale, shift = _fitted_line(predicted, truth, weights)
        return np.asarray(scale * predicted + shift)
    scale, shift = _fitted_line(1 / predicted, 1 / truth, weights)
    with np.errstate(divide="ignore"):
        return np.asarray(1 / (scale / predicted + shift))


def _fitted_line(x: Array, y: Array, weights: Array) -> tuple[float, float]:
    """Return scale and shift with the least weighted squares of ``scale * x + shift - y``."""
    total = weights.sum()
    mean_x = (weights * x).sum() / total
    mean_y = (weights * y).sum() / total
    spread = (weights * (x - mean_x) ** 2).sum()
    if spread == 0:
        return 1.0, float(mean_y - mean_x)
    scale = float((weights * (x - mean_x) * (y - mean_y)).sum() / spread)
    return scale, float(mean_y - scale * mean_x)
