"""The Scaramuzza model of OCamCalib."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array, Camera, Mask, polar
from omniscv.cameras.polynomials import first_positive_root, invert
from omniscv.cameras.radial import ROUNDING
from omniscv.errors import ArgumentError


class Scaramuzza(Camera):
    """A camera of revolution by a polynomial: the ray of (u'', v'') is ``(u'', v'', -f(rho))``,
    ``f(rho) = a0 + a1 rho + ... + aN rho^N``, ``rho = |(u'', v'')|`` px.

    ``u = u_0 + c u'' + d v''``, ``v = v_0 + e u'' + v''``.
    Parameters: ``coefficients`` a0..aN with a0 < 0; ``affine`` = (c, d, e), (1, 0, 0) if not given;
    ``fov_deg`` <= 360, an optional limit.
    Domain: the branch on which the ray turns away from +z as rho grows, ``rho f'(rho) > f(rho)``;
    beyond it two pixels would see one ray, and they are invalid.
    Source: OmniSCV, Scaramuzza; Scaramuzza et al. 2006.
    """

    name = "scaramuzza"

    def __init__(
        self,
        width: int,
        height: int,
        coefficients: ArrayLike,
        affine: ArrayLike = (1.0, 0.0, 0.0),
        fov_deg: float | None = None,
        center: ArrayLike | None = None,
    ) -> None:
        super().__init__(width, height, center)
        count = np.size(np.asarray(coefficients, dtype=object))
        self.coefficients = self._numbers("coefficients", coefficients, max(1, count))
        self._number("coefficients[0]", self.coefficients[0], below=0)
        self.affine = self._numbers("affine", affine, 3)
        c, d, e = self.affine
        if c - d * e == 0:
            raise ArgumentError(f"affine: expected c - d e != 0, got (c, d, e) = {self.affine.tolist()}")
        self._A = np.array([[c, d], [e, 1.0]])
        self.fov_deg = None if fov_deg is None else self._number("fov_deg", fov_deg, above=0, most=360)
        self._slope = polyder(self.coefficients) if count > 1 else np.zeros(1)
        turning = first_positive_root((np.arange(len(self.coefficients)) - 1) * self.coefficients)
        corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64)
        with np.errstate(all="ignore"):
            farthest = np.hypot(*np.linalg.solve(self._A, (corners - self.center).T)).max()
        if not np.isfinite(farthest):
            raise ArgumentError(
                f"affine: expected c - d e further from 0, got (c, d, e) = {self.affine.tolist()}"
            )
        self._rho_end = float(min(turning, farthest))
        if self.fov_deg is not None:
            half = np.radians(self.fov_deg) / 2
            if self._theta(np.array(self._rho_end)) > half:
                self._rho_end = float(self._rho_of(np.array([half]))[0])
        self._theta_end = float(self._theta(np.array(self._rho_end)))

    def parameters(self) -> dict[str, Any]:
        limit = {} if self.fov_deg is None else {"fov_deg": self.fov_deg}
        return {"coefficients": self.coefficients.tolist(), "affine": self.affine.tolist(), **limit}

    def _theta(self, rho: Array) -> Array:
        return np.asarray(np.arctan2(rho, -polyval(rho, self.coefficients)))

    def _rho_of(self, theta: Array) -> Array:
        """The radius on the branch whose ray is theta off +z."""

        def slope(rho: Array) -> Array:
            f = polyval(rho, self.coefficients)
            return np.asarray((rho * polyval(rho, self._slope) - f) / (rho * rho + f * f))

        return invert(self._theta, slope, self._rho_end, theta)

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        uv = (pixels - self.center) @ np.linalg.inv(self._A).T
        rho = np.hypot(uv[..., 0], uv[..., 1])
        along = -polyval(rho, self.coefficients)
        length = np.hypot(rho, along)
        directions = np.concatenate([uv, along[..., None]], axis=-1) / length[..., None]
        return np.zeros_like(directions), directions, rho <= self._rho_end * (1 + ROUNDING)

    def _project(self, points: Array) -> tuple[Array, Mask]:
        across, cos_a, sin_a = polar(points[..., :2], np.zeros(2))
        theta = np.arctan2(across, points[..., 2])
        seen = theta <= self._theta_end * (1 + ROUNDING)
        rho = self._rho_of(np.minimum(theta, self._theta_end))
        return self.center + np.stack([rho * cos_a, rho * sin_a], axis=-1) @ self._A.T, seen
