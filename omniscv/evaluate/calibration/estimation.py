"""The parameter r_vl of an uncalibrated camera of revolution, from the images of straight lines.

For a candidate each line's plane normal follows linearly from its points; how far the points are from the
line image that this gives says how well the candidate fits. See ``line_images.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from omniscv.evaluate.calibration.line_images import LineImages
from omniscv.geometry.pose import Array

_CANDIDATES = 60
_CAP_PX = 3.0  # a point farther off counts as so far: it is of no line
_REWEIGHTED = 2
_LEAST_NZ = 0.15  # radial lines, whose planes hold the axis, carry nothing
_MOST_PX = 1.0  # rms, of the points of what is a line
_PASSES = 3
_ROBUST_PX = 0.5


class Fit(NamedTuple):
    """Lines at a candidate.

    Attributes:
        normals: (L, 3) unit.
        residuals: (N,) px from each point to its line's image; the cap where the model has no such radius.
    """

    normals: Array
    residuals: Array


class PointsOnLines:
    """Points, grouped by line.

    Args:
        groups: (N_i, 2) px from the image's middle, per line, at least 3 each.
    """

    def __init__(self, groups: Sequence[Array]) -> None:
        self.groups = groups
        self._points = np.concatenate(groups)
        self._r = np.maximum(np.linalg.norm(self._points, axis=-1), 1e-9)
        counts = np.array([len(each) for each in groups])
        self.starts = np.cumsum(counts) - counts
        self._line = np.repeat(np.arange(len(groups)), counts)

    def fit(self, model: LineImages, r_vl: float) -> Fit:
        """Return each line's normal, the least squares of Sampson's distances, and the distances."""
        with np.errstate(invalid="ignore"):
            alpha, slope = model.alpha(self._r, r_vl), model.slope(self._r, r_vl)
        seen = np.isfinite(alpha) & np.isfinite(slope)
        rows = np.column_stack([self._points, -alpha])
        rows[~seen] = 0.0
        outward = np.where(seen, slope, 0.0)[:, None] * self._points / self._r[:, None]
        weight = seen.astype(np.float64)
        for _ in range(1 + _REWEIGHTED):
            normals = self._normals(rows, weight)
            own = normals[self._line]
            length = np.linalg.norm(own[:, :2] - own[:, 2:] * outward, axis=-1)
            weight = seen / np.maximum(length, 1e-9) ** 2
        distance = np.abs((rows * own).sum(axis=-1)) / np.maximum(length, 1e-9)
        return Fit(normals, np.where(seen, np.minimum(distance, _CAP_PX), _CAP_PX))

    def rms(self, residuals: Array) -> Array:
        """Return (L,) px."""
        counts = np.diff(np.append(self.starts, len(residuals)))
        return np.asarray(np.sqrt(np.add.reduceat(residuals**2, self.starts) / counts))

    def chosen(self, lines: NDArray[np.bool_]) -> PointsOnLines:
        """Return the points of some lines."""
        return PointsOnLines([each for each, taken in zip(self.groups, lines, strict=True) if taken])

    def _normals(self, rows: Array, weight: Array) -> Array:
        products = (weight[:, None] * rows)[:, :, None] * rows[:, None, :]
        return np.asarray(np.linalg.eigh(np.add.reduceat(products, self.starts))[1][:, :, 0])


def calibrate(groups: Sequence[Array], model: LineImages, low: float, high: float) -> float:
    """Return r_vl, px.

    Args:
        groups: (N_i, 2) px from the image's middle, per line; some may be of curves that are no lines.
        model: which camera it is.
        low, high: px, between which r_vl lies.

    Returns:
        px; NaN where no line says anything.
    """
    if not groups:
        return float("nan")
    everything = PointsOnLines(groups)
    candidates = np.geomspace(low, high, _CANDIDATES)
    costs = [float((everything.fit(model, each).residuals ** 2).sum()) for each in candidates]
    r_vl, points = float(candidates[np.argmin(costs)]), everything
    for _ in range(_PASSES):
        normals, residuals = everything.fit(model, r_vl)
        told = (np.abs(normals[:, 2]) >= _LEAST_NZ) & (everything.rms(residuals) <= _MOST_PX)
        if not told.any():
            return float("nan")
        points = everything.chosen(told)
        r_vl = _refined(points, model, r_vl, low, high)
    return r_vl


def _refined(points: PointsOnLines, model: LineImages, r_vl: float, low: float, high: float) -> float:
    def residuals(x: Array) -> Array:
        return points.fit(model, float(x[0])).residuals

    found = least_squares(
        residuals, [r_vl], bounds=([low], [high]), loss="soft_l1", f_scale=_ROBUST_PX, xtol=1e-14, ftol=1e-14
    )
    return float(found.x[0])
