"""Fisheye lenses: four ways from the angle off the axis to the radius in the image."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array, sin_cos_of_half
from omniscv.cameras.radial import Meridian, RadialCamera

_HAIR = 1e-17
"""Where all pixels of the rim look straight back, this much across keeps their azimuth."""


class Fisheye(RadialCamera):
    """A lens with ``r = f h(phi)``, phi from +z; ``fov_deg`` 180 if neither it nor ``focal`` is given."""

    max_fov_deg: ClassVar[float] = 360.0
    fov_is_open: ClassVar[bool] = False

    def __init__(
        self,
        width: int,
        height: int,
        focal: float | None = None,
        fov_deg: float | None = None,
        center: ArrayLike | None = None,
    ) -> None:
        super().__init__(width, height, focal, fov_deg, center)

    def _default_focal(self) -> float:
        return min(self.width, self.height) / 2 / self._radius_of_fov(180.0)

    def _radius_of_fov(self, fov_deg: float) -> float:
        limit = {"below" if self.fov_is_open else "most": self.max_fov_deg}
        across, along = sin_cos_of_half(self._number("fov_deg", fov_deg, above=0, **limit))
        with np.errstate(divide="ignore", invalid="ignore"):  # on the branch that is not taken
            return float(self._radius(across, along))


class FisheyeEquidistant(Fisheye):
    """Equal angles at equal distances: ``phi = r / f`` (the paper's equi-angular lens).

    Parameters: ``focal`` f in px per radian, or ``fov_deg``, the full angle of the image circle; 180 if
    neither is given. Domain: phi <= pi, fov_deg <= 360.
    Source: OmniSCV, table of fish-eye projections.
    """

    name = "fisheye-equidistant"

    def _edge(self) -> float:
        return np.pi

    def _direction(self, t: Array) -> Meridian:
        return Meridian(np.sin(t), np.cos(t))

    def _radius(self, across: Array, along: Array) -> Array:
        return np.arctan2(across, along)


class FisheyeStereographic(Fisheye):
    """Circles stay circles: ``phi = 2 atan(r / 2f)``, ``r = 2 f tan(phi / 2)``.

    Parameters: ``focal`` f in px, or ``fov_deg``, the full angle of the image circle; 180 if neither is
    given. Domain: phi < pi, fov_deg < 360: straight back lies at infinity.
    Source: OmniSCV, table of fish-eye projections.
    """

    name = "fisheye-stereographic"
    fov_is_open = True

    def _edge(self) -> float:
        return np.inf

    def _direction(self, t: Array) -> Meridian:
        half = t / 2
        scale = 1 + half * half
        return Meridian(t / scale, (1 - half) * (1 + half) / scale)

    def _radius(self, across: Array, along: Array) -> Array:
        # tan(phi / 2) two ways: neither subtracts like numbers on its side.
        return np.where(along >= 0, 2 * across / (1 + along), 2 * (1 - along) / across)


class FisheyeOrthographic(Fisheye):
    """The hemisphere seen from infinitely far: ``phi = asin(r / f)`` (the paper's orthogonal lens).

    Parameters: ``focal`` f in px, or ``fov_deg``, the full angle of the image circle; 180 if neither is
    given. Domain: phi <= pi / 2, r <= f, fov_deg <= 180.
    Source: OmniSCV, table of fish-eye projections.
    """

    name = "fisheye-orthographic"
    max_fov_deg = 180.0

    def _edge(self) -> float:
        return 1.0

    def _direction(self, t: Array) -> Meridian:
        return Meridian(t, np.sqrt((1 - t) * (1 + t)))

    def _radius(self, across: Array, along: Array) -> Array:
        return np.where(along >= 0, across, np.nan)


class FisheyeEquisolid(Fisheye):
    """Equal solid angles on equal areas: ``phi = 2 asin(r / f)``, ``r = f sin(phi / 2)``.

    This f is the paper's, twice the f of ``r = 2 f sin(phi / 2)`` that lens makers use.
    Parameters: ``focal`` f in px, or ``fov_deg``, the full angle of the image circle; 180 if neither is
    given. Domain: phi <= pi, r <= f, fov_deg <= 360.
    Source: OmniSCV, table of fish-eye projections.
    """

    name = "fisheye-equisolid"

    def _edge(self) -> float:
        return 1.0

    def _direction(self, t: Array) -> Meridian:
        rest = (1 - t) * (1 + t)
        return Meridian(np.where(rest > 0, 2 * t * np.sqrt(rest), _HAIR), 1 - 2 * t * t)

    def _radius(self, across: Array, along: Array) -> Array:
        # sin(phi / 2) two ways: neither subtracts like numbers on its side.
        front = across / np.sqrt(2 * (1 + along))
        return np.where(along >= 0, front, np.sqrt((1 - along) / 2))
