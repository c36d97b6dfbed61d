"""The conical mirror."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array
from omniscv.cameras.noncentral_mirror import MeridianRays, NoncentralMirror
from omniscv.cameras.radial import ROUNDING


class NoncentralConicalMirror(NoncentralMirror):
    """A perspective camera that looks at the tip of a cone.

    ``R_c = Z_m sin 2tau``, ``Z_c = Z_m (1 - cos 2tau)``, ``cot phi = (1 + r tan 2tau) / (tan 2tau - r)``,
    ``Z_r = Z_c + R_c cot phi``; origin ``(0, 0, Z_r)``, direction ``(sin phi cos a, sin phi sin a, cos phi)``
    at azimuth a.
    Parameters: ``half_angle_deg`` tau between axis and surface, 0 < tau < 90; ``distance`` Z_m > 0 from
    the camera to the tip, metres; ``focal`` px (default width / 2) or ``fov_deg``, twice the angle from
    -z of the last ray; ``mirror_radius`` of the cone's rim, metres, endless if not given.
    Domain: 0 < r < tan tau (beyond, the cone is missed; the tip itself has no normal), r up to the rim.
    Source: OmniSCV, table of Z_r and cot phi. Multiplied by cos 2tau here: nothing special at 45 degrees.
    """

    name = "noncentral-conical-mirror"

    def __init__(
        self,
        width: int,
        height: int,
        half_angle_deg: float,
        distance: float,
        focal: float | None = None,
        fov_deg: float | None = None,
        mirror_radius: float | None = None,
        center: ArrayLike | None = None,
    ) -> None:
        self.half_angle_deg = self._number("half_angle_deg", half_angle_deg, above=0, below=90)
        self.distance = self._number("distance", distance, above=0)
        self.mirror_radius = (
            None if mirror_radius is None else self._number("mirror_radius", mirror_radius, above=0)
        )
        # From the complement, because cos of nearly 90 degrees has lost its digits in radians.
        self._sin, self._cos = np.sin(np.radians([self.half_angle_deg, 90 - self.half_angle_deg])).tolist()
        self._sin2, self._cos2 = 2 * self._sin * self._cos, (self._cos - self._sin) * (self._cos + self._sin)
        super().__init__(width, height, focal, fov_deg, center)

    def parameters(self) -> dict[str, Any]:
        return {
            "half_angle_deg": self.half_angle_deg,
            "distance": self.distance,
            "focal": self.focal,
            "mirror_radius": self.mirror_radius,
        }

    def _edge(self) -> float:
        if self.mirror_radius is None:
            return float(np.nextafter(self._sin / self._cos, 0))
        rim = self.mirror_radius
        return float(rim * self._sin / (self.distance * self._sin + rim * self._cos))

    def _reflect(self, r: Array) -> MeridianRays:
        r = np.where(r > 0, r, np.nan)
        across, along = self._sin2 - r * self._cos2, self._cos2 + r * self._sin2
        length = np.hypot(1.0, r)  # of (across, along), too
        return MeridianRays(self.distance * (1 + r / across), across / length, along / length)

    def _radius_seeing(self, rho: Array, z: Array) -> Array:
        """Mirrors the point in the cone's side, where the camera sees it as through a window."""
        h = z - self.distance
        x_image = h * self._sin2 - rho * self._cos2
        z_image = h * self._cos2 + rho * self._sin2 + self.distance
        outside = rho * self._cos - h * self._sin >= -ROUNDING * (rho + np.abs(h))
        seen = outside & (rho > 0) & (x_image > 0) & (z_image > 0)
        radius: Array = np.where(seen, x_image / z_image, np.nan)
        return radius

    def _radius_of_fov(self, fov_deg: float) -> float:
        """From the tip's 360 - 4 tau to the 360 - 2 tau of rays along the cone's side."""
        tip, side = 360 - 4 * self.half_angle_deg, 360 - 2 * self.half_angle_deg
        fov_deg = self._number("fov_deg", fov_deg, above=tip, below=side)
        return float(np.tan(np.radians((fov_deg - tip) / 2)))
