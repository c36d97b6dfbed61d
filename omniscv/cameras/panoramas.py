"""Panoramas: azimuth across, elevation down."""

from typing import ClassVar, Literal, Self, get_args

import numpy as np

from omniscv.arguments import number, one_of
from omniscv.cameras.arrays import grid_axes, vectors
from omniscv.cameras.base import Array, Camera, CentralCamera, Mask, sin_cos_of_half
from omniscv.cameras.registry import register

Profile = Literal["angular", "perspective"]


class AngularGrid(Camera):
    """Azimuth by column and elevation by row, in equal steps, to half the field of view on either side."""

    _half = np.array([np.pi, np.pi / 2])

    @classmethod
    def example(cls, width: int = 512) -> Self:
        return cls(width, max(1, width // 2), **cls.typical)

    def _angles(self, pixels: Array) -> tuple[Array, Array]:
        """Azimuth and elevation of pixels; of a grid's columns and of its rows."""
        u, v = grid_axes(pixels)
        across, up = 2 * u / self.width - 1, 1 - 2 * v / self.height
        return across * self._half[0], up * self._half[1]

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        theta, phi = self._angles(pixels)
        level = np.cos(phi)
        return vectors(level * np.sin(theta), -np.sin(phi), level * np.cos(theta)), True

    def _pixels_at(self, theta: Array, up: Array) -> Array:
        """The pixels at azimuths and at parts ``up`` of the image's upper half."""
        across = theta / self._half[0]
        return np.stack([(across + 1) * self.width / 2, (1 - up) * self.height / 2], axis=-1)

    def _project(self, points: Array) -> tuple[Array, Mask | bool]:
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        return self._pixels_at(np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z)) / self._half[1]), True


@register
class Equirectangular(AngularGrid, CentralCamera):
    """The whole sphere in a rectangle of angles.

    ``theta = (2u/W - 1) pi`` to the right, ``phi = (1/2 - v/H) pi`` up; direction
    ``(cos phi sin theta, -sin phi, cos phi cos theta)``. Domain: every pixel, every direction; at the
    poles, where all columns meet, ``project`` answers the middle column, and the seam at +-180
    degrees is answered as u = 0 or u = W by the sign of x. Source: OmniSCV, eq. 1.
    """

    name = "equirectangular"

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)


@register
class Cylindrical(AngularGrid, CentralCamera):
    """A band around the horizon: ``theta = (2u/W - 1) fov_h / 2`` to the right, and up, by ``profile``:

    ``angular``: ``phi = (1 - 2v/H) fov_v / 2``, the paper's, a cropped equirectangular image;
    ``perspective``: ``tan phi = (1 - 2v/H) tan(fov_v / 2)``, rows equally spaced on the cylinder's wall.
    Parameters: ``fov_h_deg`` <= 360 (default 360), ``fov_v_deg`` <= 180 (perspective: < 180; default 90).
    Domain: every pixel; directions within the field of view. Source: OmniSCV, eq. 2.
    """

    name = "cylindrical"
    typical: ClassVar = {"fov_v_deg": 120}

    def __init__(
        self,
        width: int,
        height: int,
        fov_h_deg: float = 360.0,
        fov_v_deg: float = 90.0,
        profile: Profile = "angular",
    ) -> None:
        super().__init__(width, height)
        self.profile: Profile = one_of("profile", profile, get_args(Profile))
        self.fov_h_deg = number("fov_h_deg", fov_h_deg, above=0, most=360)
        limit = {"most" if profile == "angular" else "below": 180.0}
        self.fov_v_deg = number("fov_v_deg", fov_v_deg, above=0, **limit)
        self._half = np.radians([self.fov_h_deg / 2, self.fov_v_deg / 2])
        if profile == "perspective":
            across, along = sin_cos_of_half(self.fov_v_deg)
            self._wall = across / along  # half the wall's height over the cylinder's radius

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        if self.profile == "angular":
            return super()._directions(pixels)
        # Not by way of phi, which has lost the wall's height when it is nearly straight up.
        theta, phi = self._angles(pixels)
        height = phi / self._half[1] * self._wall
        level = 1 / np.hypot(1.0, height)
        return vectors(level * np.sin(theta), -(height * level), level * np.cos(theta)), True

    def _project(self, points: Array) -> tuple[Array, Mask | bool]:
        if self.profile == "angular":
            return super()._project(points)
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        return self._pixels_at(np.arctan2(x, z), -y / np.hypot(x, z) / self._wall), True
