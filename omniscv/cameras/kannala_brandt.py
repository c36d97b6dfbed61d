"""The Kannala-Brandt lens."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array, Camera, Mask, polar
from omniscv.cameras.polynomials import first_positive_root, invert
from omniscv.cameras.radial import ROUNDING


class KannalaBrandt(Camera):
    """A lens by an odd polynomial: ``d(theta) = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9``.

    ``u = cx + fx d(theta) cos a``, ``v = cy + fy d(theta) sin a``, theta from +z, a the azimuth.
    Parameters: ``fx``, ``fy`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5, so
    OpenCV's cx + 0.5); ``k`` = (k1, k2, k3, k4); ``fov_deg`` <= 360, an optional limit.
    Domain: the branch on which d increases from theta = 0, at most to pi; pixels beyond its last value,
    and angles beyond its end, are invalid.
    Source: OmniSCV, Kannala-Brandt; Kannala and Brandt 2006.
    """

    name = "kannala-brandt"
    has_center = False  # it is (cx, cy)

    def __init__(
        self,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float | None = None,
        cy: float | None = None,
        k: ArrayLike = (0.0, 0.0, 0.0, 0.0),
        fov_deg: float | None = None,
    ) -> None:
        super().__init__(width, height)
        self.fx, self.fy = self._number("fx", fx, above=0), self._number("fy", fy, above=0)
        middle = self.center
        self.center = np.array(
            [
                middle[0] if cx is None else self._number("cx", cx),
                middle[1] if cy is None else self._number("cy", cy),
            ]
        )
        self.k = self._numbers("k", k, 4)
        self.fov_deg = None if fov_deg is None else self._number("fov_deg", fov_deg, above=0, most=360)
        self._d = np.zeros(10)
        self._d[1], self._d[3::2] = 1.0, self.k
        self._slope = polyder(self._d)
        # d' is even: its first root is the square root of one in theta^2.
        turning = np.sqrt(first_positive_root(self._slope[::2]))
        limit = np.pi if self.fov_deg is None else np.radians(self.fov_deg) / 2
        self._theta_end = float(min(np.pi, turning, limit))
        self._d_end = float(self._d_of(np.array(self._theta_end)))

    def parameters(self) -> dict[str, Any]:
        given = {"fx": self.fx, "fy": self.fy, "cx": self.center[0].item(), "cy": self.center[1].item()}
        limit = {} if self.fov_deg is None else {"fov_deg": self.fov_deg}
        return {**given, "k": self.k.tolist(), **limit}

    def _d_of(self, theta: Array) -> Array:
        return np.asarray(polyval(theta, self._d), dtype=np.float64)

    def _slope_of(self, theta: Array) -> Array:
        return np.asarray(polyval(theta, self._slope), dtype=np.float64)

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        focal = np.array([self.fx, self.fy])
        d, cos_a, sin_a = polar((pixels - self.center) / focal, np.zeros(2))
        seen = d <= self._d_end
        theta = invert(self._d_of, self._slope_of, self._theta_end, np.where(seen, d, 0.0))
        across = np.sin(theta)
        directions = np.stack([across * cos_a, across * sin_a, np.cos(theta)], axis=-1)
        return np.zeros_like(directions), directions, seen

    def _project(self, points: Array) -> tuple[Array, Mask]:
        across, cos_a, sin_a = polar(points[..., :2], np.zeros(2))
        theta = np.arctan2(across, points[..., 2])
        seen = theta <= self._theta_end * (1 + ROUNDING)
        d = np.minimum(
            polyval(np.minimum(theta, self._theta_end), self._d), self._d_end * (1 - 0.1 * ROUNDING)
        )
        return self.center + np.stack([self.fx * d * cos_a, self.fy * d * sin_a], axis=-1), seen
