"""The parameter r_vl of an uncalibrated camera of revolution, from the images of straight lines.

For a candidate, each line's plane normal follows linearly from its points. The distances of the points from
the line image of this normal measure the fit. See :mod:`omniscv.evaluate.calibration.line_images`.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from omniscv.evaluate.calibration.line_images import LineImages
from omniscv.geometry.pose import Array

_CANDIDATES = 60
_CAP_PX = 3.0  # bound of the distances: a point farther off is an outlier
_REWEIGHTINGS = 2
_LEAST_NZ = 0.15  # radial lines, whose planes contain the axis, do not depend on r_vl
_MOST_PX = 1.0  # rms distance of the points of a line
_PASSES = 3
_ROBUST_PX = 0.5


class PointsOnLines:
    """Points, grouped by line.

    Args:
        groups: (N_i, 2) px from the image's middle, per line, at least 3 each.
    """

    def __init__(self, groups: Sequence[Array]) -> None:
        self._points = np.concatenate(groups)
        self._r = np.maximum(np.linalg.norm(self._points, axis=-1), 1e-9)
        self._counts = np.array([len(group) for group in groups])
        self._starts = np.cumsum(self._counts) - self._counts

    def fit(self, model: LineImages, r_vl: float) -> tuple[Array, Array]:
        """Fit each line's normal to its points, by least squares of Sampson's distances.

        Returns:
            (L, 3) unit normals, and (N,) px distances of the points from the line images, at most the cap,
            which stands where the model has no such radius.
        """
        with np.errstate(invalid="ignore"):
            alpha, slope = model.alpha(self._r, r_vl), model.slope(self._r, r_vl)
        seen = np.isfinite(alpha) & np.isfinite(slope)
        rows = np.where(seen[:, None], np.column_stack([self._points, -alpha]), 0.0)
        outward = np.where(seen, slope, 0.0)[:, None] * self._points / self._r[:, None]
        weight = seen.astype(np.float64)
        for _ in range(1 + _REWEIGHTINGS):
            products = (weight[:, None] * rows)[:, :, None] * rows[:, None, :]
            normals = np.linalg.eigh(np.add.reduceat(products, self._starts))[1][:, :, 0]
            normal = np.repeat(normals, self._counts, axis=0)
            length = np.maximum(np.linalg.norm(normal[:, :2] - normal[:, 2:] * outward, axis=-1), 1e-9)
            weight = seen / length**2
        distance = np.abs((rows * normal).sum(axis=-1)) / length
        return normals, np.where(seen, np.minimum(distance, _CAP_PX), _CAP_PX)

    def rms(self, distances: Array) -> Array:
        """Return (L,) px of distances (N,)."""
        return np.asarray(np.sqrt(np.add.reduceat(distances**2, self._starts) / self._counts))


def calibrate(groups: Sequence[Array], model: LineImages, low: float, high: float) -> float:
    """Return r_vl, px.

    Args:
        groups: (N_i, 2) px from the image's middle, per line; curves that are no lines are left out.
        model: of the camera.
        low, high: px, bounds of r_vl.

    Returns:
        px; NaN if no line depends on r_vl.
    """
    if not groups:
        return float("nan")
    points = PointsOnLines(groups)
    candidates = np.geomspace(low, high, _CANDIDATES)
    costs = [float((points.fit(model, candidate)[1] ** 2).sum()) for candidate in candidates]
    r_vl = float(candidates[np.argmin(costs)])
    for _ in range(_PASSES):
        normals, distances = points.fit(model, r_vl)
        used = (np.abs(normals[:, 2]) >= _LEAST_NZ) & (points.rms(distances) <= _MOST_PX)
        if not used.any():
            return float("nan")
        lines = PointsOnLines([group for group, use in zip(groups, used, strict=True) if use])
        r_vl = _refine(lines, model, r_vl, low, high)
    return r_vl


def _refine(lines: PointsOnLines, model: LineImages, r_vl: float, low: float, high: float) -> float:
    def distances(x: Array) -> Array:
        return lines.fit(model, float(x[0]))[1]

    solution = least_squares(
        distances, [r_vl], bounds=([low], [high]), loss="soft_l1", f_scale=_ROBUST_PX, xtol=1e-14, ftol=1e-14
    )
    return float(solution.x[0])
