"""The spherical mirror."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array
from omniscv.cameras.noncentral_mirror import MeridianRays, NoncentralMirror
from omniscv.cameras.radial import ROUNDING

_BLOCK = 1 << 14  # points solved together: their arrays stay in the processor's cache
_MOST_STEPS = 100  # bisection alone would need 60


class NoncentralSphericalMirror(NoncentralMirror):
    """A perspective camera that looks at a mirror ball.

    With the camera ray at alpha from the axis, ``tan alpha = r``, and the angle of incidence i,
    ``sin i = Z sin alpha``, ``Z = Z_s / R_s``, ``Z_s = Z_m + R_s``: the ray goes off at
    ``phi = pi - 2i + alpha`` from +z and crosses the axis at ``Z_r = Z_s (1 - sin alpha / sin(2i - alpha))``.
    This is the paper's zeta, delta, epsilon without their 0/0 at r = 0; its gamma >= 0 is i <= 90 deg.
    Parameters: ``mirror_radius`` R_s > 0 and ``distance`` Z_m > 0 to the ball's nearest point, metres;
    ``focal`` px (default width / 2) or ``fov_deg``, twice the angle from -z of the last ray.
    Domain: ``r <= 1 / sqrt(Z^2 - 1)``, where the camera's ray grazes the ball.
    Source: OmniSCV, eq. of the spherical mirror (Agrawal and Ramalingam 2013); ``project`` solves
    Alhazen's problem.
    """

    name = "noncentral-spherical-mirror"

    def __init__(
        self,
        width: int,
        height: int,
        mirror_radius: float,
        distance: float,
        focal: float | None = None,
        fov_deg: float | None = None,
        center: ArrayLike | None = None,
    ) -> None:
        self.mirror_radius = self._number("mirror_radius", mirror_radius, above=0)
        self.distance = self._number("distance", distance, above=0)
        self._z_s = self.distance + self.mirror_radius
        super().__init__(width, height, focal, fov_deg, center)

    def parameters(self) -> dict[str, Any]:
        return {"mirror_radius": self.mirror_radius, "distance": self.distance, "focal": self.focal}

    def _edge(self) -> float:
        # Z^2 - 1 as a product: a camera close to the ball must not lose its distance.
        return float(self.mirror_radius / np.sqrt(self.distance * (self.distance + 2 * self.mirror_radius)))

    def _reflect(self, r: Array) -> MeridianRays:
        ratio, t = self._z_s / self.mirror_radius, r / self._edge()
        cos_alpha = 1 / np.hypot(1.0, r)
        sin_alpha = r * cos_alpha
        cos_i = np.sqrt((1 - t) * (1 + t)) * cos_alpha
        # sin(2i - alpha) / sin(alpha) - 1, which is >= 0, without a difference of like numbers.
        excess = 2 * cos_i / (self._edge() ** 2 * (ratio * cos_alpha + cos_i))
        return MeridianRays(
            self._z_s * excess / (1 + excess),
            sin_alpha * (1 + excess),
            -((2 * cos_i**2 - 1) * cos_alpha + 2 * ratio * sin_alpha**2 * cos_i),
        )

    def _radius_seeing(self, rho: Array, z: Array) -> Array:
        from_ball = np.hypot(rho, self._z_s - z)
        t = self._reflection_point(
            (self._z_s - z) / from_ball, rho / from_ball, self.mirror_radius / from_ball
        )
        return self._radius_of(t)

    def _radius_of_fov(self, fov_deg: float) -> float:
        limit = 360 - 2 * float(np.degrees(np.arcsin(self.mirror_radius / self._z_s)))
        fov_deg = self._number("fov_deg", fov_deg, above=0, most=limit)
        half = np.radians(np.array([fov_deg / 2]))  # the direction of a point at infinity
        t = self._reflection_point(np.cos(half), np.sin(half), np.zeros(1))
        return float(self._radius_of(t)[0])

    def _radius_of(self, t: Array) -> Array:
        """Where the camera sees the ball's point at the angle ``2 atan t`` from its nearest point."""
        radius: Array = (
            2 * self.mirror_radius * t / (self.distance * (1 + t**2) + 2 * self.mirror_radius * t**2)
        )
        return radius

    def _reflection_point(self, cos_psi: Array, sin_psi: Array, closeness: Array) -> Array:
        """Where on the ball the camera sees a point: t = tan(beta / 2), NaN where it does not.

        Seen from the ball's centre the point is at psi from the camera, the reflection at beta, and
        ``closeness`` is ball radius over the point's distance. The law of reflection, equal angles of
        incidence, is ``sin(beta) (cos(psi - beta) - closeness) = sin(psi - beta) (cos(beta) - R_s / Z_s)``,
        a quartic in t. It has one root between 0 and psi, where the angle to the camera grows while
        that to the point shrinks; the camera sees it up to the grazing ring.
        """
        t = np.full(cos_psi.shape, np.nan)
        every = t.reshape(-1), cos_psi.ravel(), sin_psi.ravel(), closeness.ravel()
        m = self.distance / self._z_s
        grazing = np.sqrt(m / (2 - m))
        for start in range(0, t.size, _BLOCK):
            found, p, q, k = (values[start : start + _BLOCK] for values in every)
            limit = np.where(p > 0, np.minimum(grazing, q / (1 + p)), grazing)
            above_horizon = (p - k) + 2 * q * limit - (p + k) * limit**2 >= -ROUNDING
            seen = above_horizon & (k <= 1 + ROUNDING)
            p, q, k = p[seen], q[seen], np.minimum(k[seen], 1.0)
            quartic = (-m * q, 2 * (p * (1 + m) - k), 6 * q, -2 * (p * (3 - m) + k), -(2 - m) * q)
            found[seen] = _rising_root(np.stack(quartic), limit[seen])
        return t


def _rising_root(quartic: Array, limit: Array) -> Array:
    """The root in [0, limit] of polynomials (5, N), lowest power first, that are negative before it.

    Newton's steps within a bracket that shrinks; a step that leaves it becomes a bisection. Those that
    are done are set aside when they are the greater part, so that a few slow ones cost little.
    """
    root = np.empty_like(limit)
    left = np.arange(limit.size)
    # Not far above the root of a camera that nearly touches the ball: t - value / slope would lose it.
    t = np.where(quartic[1] > 0, np.minimum(-quartic[0] / quartic[1], 0.5 * limit), 0.5 * limit)
    low, high = np.zeros_like(limit), limit
    for _ in range(_MOST_STEPS):
        c0, c1, c2, c3, c4 = quartic
        value = (((c4 * t + c3) * t + c2) * t + c1) * t + c0
        slope = ((4 * c4 * t + 3 * c3) * t + 2 * c2) * t + c1
        below = value < 0
        low, high = np.where(below, t, low), np.where(below, high, t)
        step = t - value / slope
        step = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        moving = np.abs(step - t) > 4e-16 * t
        t = step
        root[left] = t
        if 2 * np.count_nonzero(moving) <= left.size:
            left, t, low, high, quartic = (
                left[moving],
                t[moving],
                low[moving],
                high[moving],
                quartic[:, moving],
            )
        if not left.size:
            break
    return root
