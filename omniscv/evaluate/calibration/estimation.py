"""The parameter r_vl of an uncalibrated camera of revolution, from the images of straight lines.

A camera of revolution sees a point at the angle phi from its axis at the radius r. A line and the optical
centre span a plane with the normal n = (nx, ny, nz), where z is the axis that the image's middle sees. With
``alpha(r) = -r cot phi(r)`` the line's image is ``nx x + ny y - nz alpha(r) = 0``, where (x, y) is relative
to the image's middle. ``r_vl`` is the radius at phi = 90 degrees, of the vanishing points of lines parallel
to the image plane. It alone determines alpha; for hyper-catadioptric systems together with the camera's
focal length f. With ``s = r / r_vl``, ``q = f / r_vl``, and 2p and d the mirror's latus rectum and distance
of foci:

==================  ==============================  ============  ===================================
model               definition                      r_vl          alpha / r_vl
==================  ==============================  ============  ===================================
equi-angular        r = f phi                       f pi / 2      -s cot(s pi / 2)
stereographic       r = 2 f tan(phi / 2)            2 f           (s^2 - 1) / 2
orthogonal          r = f sin phi                   f             -sqrt(1 - s^2)
equi-solid          r = f sin(phi / 2)              f / sqrt 2    (s^2 - 1) / sqrt(2 - s^2)
para-catadioptric   paraboloid, telecentric camera  f 2p          (s^2 - 1) / 2
hyper-catadioptric  hyperboloid                     f 2p / d      q (sqrt(s^2 + q^2) - sqrt(1 + q^2))
==================  ==============================  ============  ===================================

For a candidate, each line's plane normal follows linearly from its points. The distances of the points from
the line image of this normal measure the fit.

Source: Bermudez-Cameo, Lopez-Nicolas, Guerrero 2015, Automatic line extraction in uncalibrated
omnidirectional cameras with revolution symmetry; f as in the paper of OmniSCV.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.geometry.pose import Array

_HALVINGS = 24

Formula = Callable[[Array, Array], Array]
"""Of s and r_vl, px."""

_CANDIDATES = 60
_CAP_PX = 3.0  # bound of the distances: a point farther off is an outlier
_REWEIGHTINGS = 2
_LEAST_NZ = 0.15  # radial lines, whose planes contain the axis, do not depend on r_vl
_MOST_PX = 1.0  # rms distance of the points of a line
_PASSES = 3
_ROBUST_PX = 0.5


@dataclass(frozen=True)
class LineImages:
    """A model of cameras.

    Attributes:
        name: the paper's.
        model, parameters: of the camera, :func:`omniscv.cameras.create`; parameters by r_vl, px.
        formula, derivative: of alpha / r_vl, by s.
        widest: the s that radii are below.
    """

    name: str
    model: str
    parameters: Callable[[float], Mapping[str, Any]]
    formula: Formula
    derivative: Formula
    widest: float = np.inf

    def alpha(self, r: Array, r_vl: Array | float) -> Array:
        """Return alpha, px, NaN where the model has no radius r, px; arguments are broadcast."""
        return np.asarray(r_vl * self.formula(self._relative(r, r_vl), np.asarray(r_vl)))

    def slope(self, r: Array, r_vl: Array | float) -> Array:
        """Return the derivative of :meth:`alpha` by r."""
        return np.asarray(self.derivative(self._relative(r, r_vl), np.asarray(r_vl)))

    def camera(self, size: int, r_vl: float) -> Camera:
        """Return the camera of ``size`` by ``size`` px with that r_vl, px."""
        return cameras.create(self.model, width=size, height=size, **self.parameters(r_vl))

    def r_vl_of_triples(self, points: Array, low: float, high: float) -> Array:
        """Return the r_vl for which three points lie on the image of one line, by bisection.

        With ``l1 = x2 y3 - x3 y2``, ``l2 = x3 y1 - x1 y3``, ``l3 = x1 y2 - x2 y1`` it is a zero of
        ``sum_i l_i alpha(r_i)``.

        Args:
            points: (..., 3, 2) px from the image's middle.
            low, high: px, bounds of r_vl.

        Returns:
            (...) px; NaN where there is none.
        """
        r = np.linalg.norm(points, axis=-1)
        b, c = np.roll(points, -1, axis=-2), np.roll(points, -2, axis=-2)
        weights = b[..., 0] * c[..., 1] - b[..., 1] * c[..., 0]

        def value(r_vl: Array) -> Array:
            return np.asarray((weights * self.alpha(r, r_vl[..., None])).sum(axis=-1))

        below = np.maximum(r.max(axis=-1) / self.widest * (1 + 1e-9), low)
        above = np.full(below.shape, high)
        with np.errstate(invalid="ignore"):
            start = value(below)
            crossed = start * value(above) < 0
            for _ in range(_HALVINGS):
                middle = (below + above) / 2
                beyond = start * value(middle) > 0
                below, above = np.where(beyond, middle, below), np.where(beyond, above, middle)
        return np.where(crossed, (below + above) / 2, np.nan)

    def _relative(self, r: Array, r_vl: Array | float) -> Array:
        s = r / r_vl
        return np.where(s < self.widest, s, np.nan)


def models(focal: float) -> Mapping[str, LineImages]:
    """Return the paper's six models by name; ``focal`` is that of the hyper-catadioptric's camera, px."""
    parabola: tuple[Formula, Formula] = (lambda s, _: (s * s - 1) / 2, lambda s, _: s)
    all_models = (
        LineImages(
            "equi-angular",
            "fisheye-equidistant",
            lambda r_vl: {"focal": 2 * r_vl / np.pi},
            lambda s, _: -s / np.tan(s * np.pi / 2),
            lambda s, _: s * np.pi / 2 / np.sin(s * np.pi / 2) ** 2 - 1 / np.tan(s * np.pi / 2),
            widest=2.0,
        ),
        LineImages("stereographic", "fisheye-stereographic", lambda r_vl: {"focal": r_vl / 2}, *parabola),
        LineImages(
            "orthogonal",
            "fisheye-orthographic",
            lambda r_vl: {"focal": r_vl},
            lambda s, _: -np.sqrt(1 - s * s),
            lambda s, _: s / np.sqrt(1 - s * s),
            widest=1.0,
        ),
        LineImages(
            "equi-solid",
            "fisheye-equisolid",
            lambda r_vl: {"focal": np.sqrt(2) * r_vl},
            lambda s, _: (s * s - 1) / np.sqrt(2 - s * s),
            lambda s, _: s * (3 - s * s) / (2 - s * s) ** 1.5,
            widest=np.sqrt(2),
        ),
        LineImages("para-catadioptric", "catadioptric-parabolic", lambda r_vl: {"focal": r_vl}, *parabola),
        LineImages(
            "hyper-catadioptric",
            "catadioptric-hyperbolic",
            lambda r_vl: {"focal": focal, "distance": 1.0, "semi_latus_rectum": r_vl / focal},
            lambda s, r_vl: focal / r_vl * (np.hypot(s, focal / r_vl) - np.hypot(1, focal / r_vl)),
            lambda s, r_vl: focal / r_vl * s / np.hypot(s, focal / r_vl),
        ),
    )
    return {model.name: model for model in all_models}


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
