"""Predictions without a known scale, aligned with the truth as papers do it."""

from typing import NamedTuple

import numpy as np

from omniscv.arguments import one_of
from omniscv.geometry import Array

ALIGNMENTS = ("none", "median", "scale", "scale-shift", "disparity-scale-shift")
"""``median``: by the ratio of medians. ``scale``: by least squares of depth. ``scale-shift``: of depth,
with an offset (MiDaS, Ranftl and others 2020). ``disparity-scale-shift``: of 1 / depth, with an offset,
then depth."""
_BINS = 1 << 20  # of a set's histogram: its medians are exact to a part in 40,000
_LEAST_LOG = -10.0
_MOST_LOG = 15.0  # of metres


class Line(NamedTuple):
    """An alignment: ``scale * p + shift``, or that of 1 / p.

    Attributes:
        scale: factor.
        shift: metres; of disparity 1 / metres.
        of_disparity: whether 1 / p is meant.
    """

    scale: float = 1.0
    shift: float = 0.0
    of_disparity: bool = False

    def apply(self, p: Array) -> Array:
        """Return aligned depth of predictions above 0, metres; 0 and less where the shift leaves none."""
        if not self.of_disparity:
            return np.asarray(self.scale * p + self.shift if self.shift else self.scale * p)
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (self.scale / p + self.shift))


class Fit:
    """An alignment of one image, or of a set that is not in memory at once.

    Args:
        how: one of :data:`ALIGNMENTS`.

    Raises:
        ArgumentError: an unknown alignment.
    """

    def __init__(self, how: str) -> None:
        self._how = one_of("align", how, ALIGNMENTS)
        self._of_disparity = how == "disparity-scale-shift"
        self._sums = np.zeros(5)  # of weights, x, y, x x and x y
        self._counts = np.zeros((2, _BINS), np.int64) if how == "median" else np.zeros((2, 0), np.int64)

    def add(self, p: Array, t: Array, weights: Array) -> None:
        """Add pixels: predictions and truths above 0 (N,), metres, and weights, which medians do not use."""
        if self._how == "none":
            return
        if self._how == "median":
            for counts, values in zip(self._counts, (p, t), strict=True):
                position = (np.log(values) - _LEAST_LOG) / (_MOST_LOG - _LEAST_LOG)
                bins = np.clip(position * _BINS, 0, _BINS - 1).astype(np.int64)
                counts += np.bincount(bins, minlength=_BINS)
            return
        x = 1 / p if self._of_disparity else p
        y = 1 / t if self._of_disparity else t
        wx = weights * x
        self._sums += (weights.sum(), wx.sum(), weights @ y, wx @ x, wx @ y)

    def line(self) -> Line:
        """Return the alignment of all pixels that were added."""
        weight, x, y, xx, xy = self._sums
        if self._how == "median" and self._counts.any():
            return Line(_median_of(self._counts[1]) / _median_of(self._counts[0]))
        if self._how == "scale" and xx > 0:
            return Line(float(xy / xx))
        if self._how not in ("scale-shift", "disparity-scale-shift") or weight == 0:
            return Line()
        spread = xx - x * x / weight
        scale = float((xy - x * y / weight) / spread) if spread > 0 else 1.0
        return Line(scale, float((y - scale * x) / weight), self._of_disparity)


def _median_of(counts: Array) -> float:
    """Return the median of a histogram of logarithms: the middle of its bin."""
    middle = np.searchsorted(np.cumsum(counts), counts.sum() / 2)
    return float(np.exp(_LEAST_LOG + (middle + 0.5) / _BINS * (_MOST_LOG - _LEAST_LOG)))


def fitted(p: Array, t: Array, weights: Array, how: str) -> Line:
    """Return the alignment of one image's predictions with the truth.

    Args:
        p: (N,) metres, positive.
        t: (N,) metres, positive.
        weights: (N,) of each pixel; medians count pixels, as papers do.
        how: one of :data:`ALIGNMENTS`.

    Raises:
        ArgumentError: an unknown alignment.
    """
    one_of("align", how, ALIGNMENTS)
    if how == "none" or not len(p):
        return Line()
    if how == "median":
        return Line(float(np.median(t) / np.median(p)))
    if how == "scale":
        wp = weights * p
        return Line(float(wp @ t / (wp @ p)))
    of_disparity = how == "disparity-scale-shift"
    scale, shift = _fitted_line(1 / p, 1 / t, weights) if of_disparity else _fitted_line(p, t, weights)
    return Line(scale, shift, of_disparity)


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
    if how == "none":
        return predicted
    return fitted(predicted, truth, weights, how).apply(predicted)


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
