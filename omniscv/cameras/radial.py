"""What lenses and mirrors have in common: everything turns about the axis, within an image circle.

A model says how the distance from the image's centre, over the focal length, and the ray's angle from
its axis belong together; the image circle and the two ways to give the focal length are the same for all.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array, Camera, Mask, polar
from omniscv.errors import ArgumentError

ROUNDING = 1e-12  # relative: what rounding may add to a radius


class Meridian(NamedTuple):
    """A direction in the half-plane of its azimuth: across the axis z, and along it."""

    across: Array
    along: Array


class CircleCamera(Camera):
    """A camera of revolution about z, with a focal length and an image circle.

    Domain. ``0 <= r <= min(width, height) / 2`` px, and as far as the model reaches.
    """

    def __init__(
        self, width: int, height: int, focal: float | None, fov_deg: float | None, center: ArrayLike | None
    ) -> None:
        super().__init__(width, height, center)
        circle = min(self.width, self.height) / 2
        if focal is not None and fov_deg is not None:
            raise ArgumentError(
                f"focal: expected focal or fov_deg, got both ({focal!r} px and {fov_deg!r} deg)"
            )
        if fov_deg is not None:
            self.focal = circle / self._radius_of_fov(fov_deg)
        else:
            self.focal = self._default_focal() if focal is None else self._number("focal", focal, above=0)
        self._reach_px = min(circle, self.focal * self._edge())

    @abstractmethod
    def _default_focal(self) -> float:
        """The focal length, px, where neither it nor the field of view is given."""

    @abstractmethod
    def _edge(self) -> float:
        """The last normalised radius of the model; infinite where it has none."""

    @abstractmethod
    def _radius_of_fov(self, fov_deg: float) -> float:
        """The normalised radius of the ray ``fov_deg / 2`` off the axis, checked."""

    def _place(self, radius: Array, cos_a: Array, sin_a: Array) -> tuple[Array, Mask]:
        """The pixels at normalised radii and azimuths, and which are within reach (NaN is not)."""
        r_px = self.focal * radius
        seen = r_px <= self._reach_px * (1 + ROUNDING)
        # A hair inside the edge, so that the pixel that comes out is one that has a ray.
        r_px = np.minimum(r_px, self._reach_px * (1 - 0.1 * ROUNDING))
        return self.center + np.stack([r_px * cos_a, r_px * sin_a], axis=-1), seen


class RadialCamera(CircleCamera):
    """A central camera of revolution."""

    def parameters(self) -> dict[str, Any]:
        return {"focal": self.focal}

    # -- what a model says ----------------------------------------------------------------------

    @abstractmethod
    def _direction(self, t: Array) -> Meridian:
        """The unit direction of normalised radii 0 <= t <= edge."""

    @abstractmethod
    def _radius(self, across: Array, along: Array) -> Array:
        """The normalised radius that sees a unit direction; NaN where there is none."""

    # -- common to all --------------------------------------------------------------------------

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        r_px, cos_a, sin_a = polar(pixels, self.center)
        across, along = self._direction(np.minimum(r_px / self.focal, self._edge()))
        directions = np.stack([across * cos_a, across * sin_a, along], axis=-1)
        return np.zeros_like(directions), directions, r_px <= self._reach_px

    def _project(self, points: Array) -> tuple[Array, Mask]:
        across, cos_a, sin_a = polar(points[..., :2], np.zeros(2))
        length = np.hypot(across, points[..., 2])
        return self._place(self._radius(across / length, points[..., 2] / length), cos_a, sin_a)
