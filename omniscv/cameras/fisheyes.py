"""Fisheye lenses: four functions from the angle off the axis to the radius in the image."""

from typing import ClassVar

import numpy as np

from omniscv.arguments import number
from omniscv.cameras.base import Array, sin_cos_of_half
from omniscv.cameras.lens_parameters import Parameters
from omniscv.cameras.radial import Meridian, RadialCamera
from omniscv.cameras.registry import register

_MIN_SINE = 1e-17  # keeps the azimuth of pixels at phi = pi, which look straight back


class Fisheye(RadialCamera):
    """A lens with ``r = f h(phi)``, phi from +z; ``fov_deg`` 180 if neither it nor ``focal`` is given."""

    lens = Parameters.of("focal | center=cx,cy |")
    _fov_limit: ClassVar = {"most": 360.0}
    _default_fov_deg = 180.0

    def _radius_of_fov(self, fov_deg: float) -> float:
        across, along = sin_cos_of_half(number("fov_deg", fov_deg, above=0, **self._fov_limit))
        return float(self._radius(across, along))


@register
class FisheyeEquidistant(Fisheye):
    """Equal angles at equal distances: ``phi = r / f`` (the paper's equi-angular lens).

    Parameters: ``focal`` f in px per radian, or ``fov_deg``, the full angle of the image circle; 180 if
    neither is given. Domain: phi <= pi, fov_deg <= 360.
    Source: OmniSCV, table of fish-eye projections.
    """

    name = "fisheye-equidistant"
    typical: ClassVar = {"fov_deg": 185}
    _edge = np.pi

    def _meridian(self, t: Array) -> Meridian:
        return Meridian(np.sin(t), np.cos(t))

    def _radius(self, across: Array, along: Array) -> Array:
        return np.arctan2(across, along)


@register
class FisheyeStereographic(Fisheye):
    """Circles stay circles: ``phi = 2 atan(r / 2f)``, ``r = 2 f tan(phi / 2)``.

    Parameters: ``focal`` f in px, or ``fov_deg``, the full angle of the image circle; 180 if neither is
    given. Domain: phi < pi, fov_deg < 360: straight back lies at infinity.
    Source: OmniSCV, table of fish-eye projections.
    """

    name = "fisheye-stereographic"
    typical: ClassVar = {"fov_deg": 220}
    _fov_limit: ClassVar = {"below": 360.0}

    def _meridian(self, t: Array) -> Meridian:
        half = t / 2
        scale = 1 + half * half
        return Meridian(t / scale, (1 - half) * (1 + half) / scale)

    def _radius(self, across: Array, along: Array) -> Array:
        # Two forms of tan(phi / 2), each free of cancellation on its side.
        return np.where(along >= 0, 2 * across / (1 + along), 2 * (1 - along) / across)


@register
class FisheyeOrthographic(Fisheye):
    """The hemisphere seen from infinitely far: ``phi = asin(r / f)`` (the paper's orthogonal lens).

    Parameters: ``focal`` f in px, or ``fov_deg``, the full angle of the image circle; 180 if neither is
    given. Domain: phi <= pi / 2, r <= f, fov_deg <= 180.
    Source: OmniSCV, table of fish-eye projections.
    """

    name = "fisheye-orthographic"
    _fov_limit: ClassVar = {"most": 180.0}
    _edge = 1.0

    def _meridian(self, t: Array) -> Meridian:
        return Meridian(t, np.sqrt((1 - t) * (1 + t)))

    def _radius(self, across: Array, along: Array) -> Array:
        return np.where(along >= 0, across, np.nan)


@register
class FisheyeEquisolid(Fisheye):
    """Equal solid angles on equal areas: ``phi = 2 asin(r / f)``, ``r = f sin(phi / 2)``.

    This f is the paper's, twice the f of ``r = 2 f sin(phi / 2)`` that lens makers use.
    Parameters: ``focal`` f in px, or ``fov_deg``, the full angle of the image circle; 180 if neither is
    given. Domain: phi <= pi, r <= f, fov_deg <= 360.
    Source: OmniSCV, table of fish-eye projections.
    """

    name = "fisheye-equisolid"
    typical: ClassVar = {"fov_deg": 240}
    _edge = 1.0

    def _meridian(self, t: Array) -> Meridian:
        squared_cosine = (1 - t) * (1 + t)  # of phi / 2
        across = np.where(squared_cosine > 0, 2 * t * np.sqrt(squared_cosine), _MIN_SINE)
        return Meridian(across, 1 - 2 * t * t)

    def _radius(self, across: Array, along: Array) -> Array:
        # Two forms of sin(phi / 2), each free of cancellation on its side.
        front = across / np.sqrt(2 * (1 + along))
        return np.where(along >= 0, front, np.sqrt((1 - along) / 2))
