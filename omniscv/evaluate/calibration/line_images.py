"""Images of straight lines in central cameras of revolution, by one parameter.

A camera of revolution sees a point at the angle phi from its axis at the radius r. A line and the optical
centre span a plane with the normal n = (nx, ny, nz), where z is the axis that the image's middle sees; with
``alpha(r) = -r cot phi(r)`` the line's image is ``nx x + ny y - nz alpha(r) = 0``, where (x, y) counts from
the image's middle. ``r_vl`` is the radius at phi = 90 degrees: where images of lines parallel to the image
plane vanish. It alone determines alpha; of hyper-catadioptric systems together with the camera's focal
length.

Source: Bermudez-Cameo, Lopez-Nicolas, Guerrero 2015, Automatic line extraction in uncalibrated
omnidirectional cameras with revolution symmetry; f as in the paper of OmniSCV.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.geometry.pose import Array

_HALVINGS = 24


class LineImages(ABC):
    """A model's alpha. Lengths in px; NaN where the model has no such radius.

    Attributes:
        name: the paper's.
    """

    name: str

    @abstractmethod
    def alpha(self, r: Array, r_vl: Array | float) -> Array:
        """Return ``-r cot phi(r)``, px; arguments are broadcast."""

    @abstractmethod
    def slope(self, r: Array, r_vl: Array | float) -> Array:
        """Return the derivative of :meth:`alpha` by r."""

    @abstractmethod
    def camera(self, size: int, r_vl: float) -> Camera:
        """Return the camera of ``size`` by ``size`` px with that r_vl, px."""

    def least(self, r: Array) -> Array:
        """Return the r_vl, px, above which the model has a radius r, px; 0 of most models."""
        return np.zeros_like(r)

    def of_three(self, points: Array, low: float, high: float) -> Array:
        """Return the r_vl with which three points lie on the image of one line.

        With ``l1 = x2 y3 - x3 y2``, ``l2 = x3 y1 - x1 y3``, ``l3 = x1 y2 - x2 y1`` it is a zero of
        ``sum_i l_i alpha(r_i)``: in closed form, or bisected.

        Args:
            points: (..., 3, 2) px from the image's middle.
            low, high: px, where to look for it.

        Returns:
            (...) px; NaN where there is none.
        """
        r, weights = np.linalg.norm(points, axis=-1), _weights(points)
        least = self.least(r.max(axis=-1)) * (1 + 1e-9)
        return self._zero(r, weights, np.maximum(least, low), np.full(weights.shape[:-1], high))

    def _zero(self, r: Array, weights: Array, low: Array, high: Array) -> Array:
        def value(r_vl: Array) -> Array:
            return np.asarray((weights * self.alpha(r, r_vl[..., None])).sum(axis=-1))

        with np.errstate(invalid="ignore"):
            start = value(low)
            crossed = start * value(high) < 0
            for _ in range(_HALVINGS):
                middle = (low + high) / 2
                beyond = start * value(middle) > 0
                low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
        return np.where(crossed, (low + high) / 2, np.nan)


class EquiAngular(LineImages):
    """``r = f phi``: ``alpha = -r cot(r / f)``, ``r_vl = f pi / 2``."""

    name = "equi-angular"

    def alpha(self, r: Array, r_vl: Array | float) -> Array:
        return np.asarray(-r / np.tan(_angle(r, r_vl)))

    def slope(self, r: Array, r_vl: Array | float) -> Array:
        phi = _angle(r, r_vl)
        return np.asarray(phi / np.sin(phi) ** 2 - 1 / np.tan(phi))

    def camera(self, size: int, r_vl: float) -> Camera:
        return cameras.create("fisheye-equidistant", width=size, height=size, focal=2 * r_vl / np.pi)

    def least(self, r: Array) -> Array:
        return r / 2  # phi < pi


class Stereographic(LineImages):
    """``r = 2 f tan(phi / 2)``: ``alpha = (r^2 / r_vl - r_vl) / 2``, ``r_vl = 2 f``."""

    name = "stereographic"

    def alpha(self, r: Array, r_vl: Array | float) -> Array:
        return np.asarray((r * r / r_vl - r_vl) / 2)

    def slope(self, r: Array, r_vl: Array | float) -> Array:
        return np.asarray(r / r_vl)

    def camera(self, size: int, r_vl: float) -> Camera:
        return cameras.create("fisheye-stereographic", width=size, height=size, focal=r_vl / 2)

    def _zero(self, r: Array, weights: Array, low: Array, high: Array) -> Array:
        return _root_of((weights * r * r).sum(axis=-1), weights.sum(axis=-1), low, high)


class Orthogonal(LineImages):
    """``r = f sin phi``: ``alpha = -sqrt(f^2 - r^2)``, ``r_vl = f``: the rim of the hemisphere."""

    name = "orthogonal"

    def alpha(self, r: Array, r_vl: Array | float) -> Array:
        return np.asarray(-_leg(r_vl, r))

    def slope(self, r: Array, r_vl: Array | float) -> Array:
        return np.asarray(r / _leg(r_vl, r))

    def camera(self, size: int, r_vl: float) -> Camera:
        return cameras.create("fisheye-orthographic", width=size, height=size, focal=r_vl)

    def least(self, r: Array) -> Array:
        return r


class EquiSolid(LineImages):
    """``r = f sin(phi / 2)``: ``alpha = (2 r^2 - f^2) / (2 sqrt(f^2 - r^2))``, ``r_vl = f / sqrt 2``."""

    name = "equi-solid"

    def alpha(self, r: Array, r_vl: Array | float) -> Array:
        f = np.sqrt(2) * np.asarray(r_vl)
        return np.asarray((2 * r * r - f * f) / (2 * _leg(f, r)))

    def slope(self, r: Array, r_vl: Array | float) -> Array:
        f = np.sqrt(2) * np.asarray(r_vl)
        return np.asarray(r * (3 * f * f - 2 * r * r) / (2 * _leg(f, r) ** 3))

    def camera(self, size: int, r_vl: float) -> Camera:
        return cameras.create("fisheye-equisolid", width=size, height=size, focal=np.sqrt(2) * r_vl)

    def least(self, r: Array) -> Array:
        return np.asarray(r / np.sqrt(2))


class ParaCatadioptric(Stereographic):
    """A paraboloid under a telecentric camera: alpha as of a stereographic lens, ``r_vl = f 2p``."""

    name = "para-catadioptric"

    def camera(self, size: int, r_vl: float) -> Camera:
        return cameras.create("catadioptric-parabolic", width=size, height=size, focal=r_vl)


class HyperCatadioptric(LineImages):
    """A hyperboloid: ``alpha = (cos chi sqrt(r^2 + f^2) - f) / sin chi``, ``r_vl = f tan chi``.

    ``tan chi = 2p / d``, the mirror's latus rectum over the distance between its foci.

    Args:
        focal: f of the camera below the mirror, px, which is known.
    """

    name = "hyper-catadioptric"

    def __init__(self, focal: float) -> None:
        self.focal = focal

    def alpha(self, r: Array, r_vl: Array | float) -> Array:
        # Over cos chi: numerator and denominator in r_vl, which is all that changes.
        f = self.focal
        return np.asarray(f * (np.hypot(r, f) - np.hypot(f, r_vl)) / r_vl)

    def slope(self, r: Array, r_vl: Array | float) -> Array:
        return np.asarray(self.focal * r / (np.hypot(r, self.focal) * r_vl))

    def camera(self, size: int, r_vl: float) -> Camera:
        shape = {"distance": 1.0, "semi_latus_rectum": r_vl / self.focal}
        return cameras.create("catadioptric-hyperbolic", width=size, height=size, focal=self.focal, **shape)

    def _zero(self, r: Array, weights: Array, low: Array, high: Array) -> Array:
        total = weights.sum(axis=-1)
        slanted = (weights * np.hypot(r, self.focal)).sum(axis=-1)
        return _root_of(slanted**2 - (self.focal * total) ** 2, total**2, low, high)


def models(focal: float) -> Mapping[str, LineImages]:
    """Return the paper's six models by name; ``focal`` is that of the hyper-catadioptric's camera, px."""
    all_of_them = EquiAngular(), Stereographic(), Orthogonal(), EquiSolid(), ParaCatadioptric()
    return {each.name: each for each in (*all_of_them, HyperCatadioptric(focal))}


def _angle(r: Array, r_vl: Array | float) -> Array:
    """phi of an equi-angular lens; NaN from pi on."""
    phi = r * (np.pi / 2) / r_vl
    return np.where(phi < np.pi, phi, np.nan)


def _leg(hypotenuse: Array | float, leg: Array) -> Array:
    """The other leg; NaN where there is none."""
    squared = (hypotenuse - leg) * (hypotenuse + leg)
    return np.sqrt(np.where(squared > 0, squared, np.nan))


def _weights(points: Array) -> NDArray[np.float64]:
    """(..., 3) the cross products of the other two of three points (..., 3, 2)."""
    a, b = np.roll(points, -1, axis=-2), np.roll(points, -2, axis=-2)
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _root_of(numerator: Array, denominator: Array, low: Array, high: Array) -> Array:
    """sqrt(numerator / denominator); NaN where it is not within low and high."""
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(numerator / denominator)
        return np.where((root > low) & (root < high), root, np.nan)
