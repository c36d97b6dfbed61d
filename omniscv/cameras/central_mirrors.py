"""Central mirrors: the sphere model, and the edge of the real mirror.

The camera looks along +z at the mirror; the image's centre looks back along -z, so angles of these models are
measured from -z. With ``x_bar = (u - u_0) / (-eta f)`` and ``rho`` its length,
``lambda = (xi + sqrt(1 + (1 - xi^2) rho^2)) / (rho^2 + 1)``, the ray is
``(lambda x_bar, lambda y_bar, -(lambda - xi))``. Source: OmniSCV, eq. of the back-projection (Puig et al.
2012), and its table of xi and eta.
"""

from typing import Any, ClassVar

import numpy as np

from omniscv.arguments import number
from omniscv.cameras.base import Array, sin_cos_of_half
from omniscv.cameras.radial import Meridian, RadialCamera
from omniscv.cameras.registry import register


class SphereModel(RadialCamera):
    """The unified sphere model with mirror parameters xi and eta, and the mirror's edge."""

    xi: float
    eta: float
    _one_less_xi_squared: float  # 1 - xi^2, without cancellation
    typical_pitch_deg = 90.0

    def _meridian(self, t: Array) -> Meridian:
        rho = t / -self.eta
        root = np.sqrt(1 + self._one_less_xi_squared * rho * rho)
        scale = 1 / (rho * rho + 1)
        return Meridian(rho * (self.xi + root) * scale, -(root - self.xi * rho * rho) * scale)

    def _radius(self, across: Array, along: Array) -> Array:
        # xi - along; for rays far ahead as (1 - along) - (1 - xi), without cancellation where xi is near 1.
        ahead = across * across / (1 + along) - self._one_less_xi_squared / (1 + self.xi)
        below = np.where(along <= 0.5, self.xi - along, ahead)
        return np.where(below > 0, -self.eta * across / below, np.nan)

    def _radius_of_fov(self, fov_deg: float) -> float:
        if np.isinf(self._edge):
            limit = 2 * float(np.degrees(np.arccos(-self.xi)))
        else:
            across, along, _ = self._meridian(np.array(self._edge))
            limit = 2 * float(np.degrees(np.arctan2(across, -along)))
        across, back = sin_cos_of_half(number("fov_deg", fov_deg, above=0, below=limit))
        return float(self._radius(across, -back))


@register
class CatadioptricParabolic(SphereModel):
    """A paraboloid under a telecentric camera: ``xi = 1``, ``eta = -2p``.

    Parameters: ``semi_latus_rectum`` 2p > 0, metres; ``focal``, the camera's scale in px per metre
    (default width / 2), or ``fov_deg``, the full angle around -z of the image circle.
    Domain: every direction but straight ahead, +z; fov_deg < 360. The mirror has no edge.
    Source: OmniSCV, sphere model; the ray is what a real paraboloid reflects, focus at the origin.
    """

    name = "catadioptric-parabolic"
    typical_focal = 0.39
    xi = 1.0
    _one_less_xi_squared = 0.0

    def __init__(self, width: int, height: int, *, semi_latus_rectum: float = 1.0, **circle: Any) -> None:
        self.semi_latus_rectum = number("semi_latus_rectum", semi_latus_rectum, above=0)
        self.eta = -self.semi_latus_rectum
        super().__init__(width, height, **circle)


@register
class CatadioptricHyperbolic(SphereModel):
    """A hyperboloid with the camera at its outer focus: ``xi = d / D``, ``eta = -2p / D``,
    ``D = sqrt(d^2 + 4 p^2)``.

    Parameters: ``distance`` d > 0 between the foci and ``semi_latus_rectum`` 2p > 0, metres; ``focal``
    px (default width / 2), or ``fov_deg``, the full angle around -z of the image circle.
    Domain: the formula continues beyond the mirror: with ``2a = D - 2p`` a ray of the camera at
    ``t = r / f`` meets it only while ``sqrt(1 + t^2) < d / 2a``.
    Source: OmniSCV, sphere model; the ray is what a real hyperboloid reflects, inner focus at the origin.
    """

    name = "catadioptric-hyperbolic"
    typical: ClassVar = {"semi_latus_rectum": 0.4}

    def __init__(
        self, width: int, height: int, *, distance: float = 1.0, semi_latus_rectum: float = 0.5, **circle: Any
    ) -> None:
        self.distance = number("distance", distance, above=0)
        self.semi_latus_rectum = number("semi_latus_rectum", semi_latus_rectum, above=0)
        root = float(np.hypot(self.distance, self.semi_latus_rectum))
        self.xi = self.distance / root
        self.eta = -self.semi_latus_rectum / root
        self._one_less_xi_squared = self.eta**2
        # d / 2a = (D + 2p) / d, because D^2 - (2p)^2 = d^2; t^2 = (d / 2a)^2 - 1.
        edge = np.sqrt(2 * self.semi_latus_rectum * (root + self.semi_latus_rectum)) / self.distance
        self._edge = float(np.nextafter(edge, 0))
        super().__init__(width, height, **circle)


@register
class CatadioptricPlanar(SphereModel):
    """A flat mirror: ``xi = 0``, ``eta = -1``; a pinhole that looks back along -z, mirrored as mirrors do.

    Parameters: ``focal`` px (default width / 2), or ``fov_deg``, the full angle around -z of the image
    circle. Domain: directions with z < 0; fov_deg < 180.
    Source: OmniSCV, sphere model.
    """

    name = "catadioptric-planar"
    xi = 0.0
    eta = -1.0
    _one_less_xi_squared = 1.0
    typical: ClassVar = {"fov_deg": 100}
