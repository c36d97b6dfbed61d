"""Panoramas: azimuth across, elevation down."""

from collections.abc import Callable
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np

from omniscv.arguments import number, one_of
from omniscv.cameras.base import Array, Camera, CentralCamera, Mask, grid_axes, sin_cos_of_half, vectors
from omniscv.cameras.lens_parameters import Parameters
from omniscv.cameras.registry import register

Profile = Literal["angular", "perspective", "mercator", "miller", "equal-area"]


class AngularGrid(Camera):
    """Azimuth by column and elevation by row, in equal steps, to half the field of view on either side."""

    _half = np.array([np.pi, np.pi / 2])
    typical_aspect = 0.5

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)

    def _angles(self, pixels: Array) -> tuple[Array, Array]:
        """Return azimuth and elevation of pixels; of a grid only those of its columns and rows."""
        u, v = grid_axes(pixels)
        across, up = 2 * u / self.width - 1, 1 - 2 * v / self.height
        return across * self._half[0], up * self._half[1]

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        theta, phi = self._angles(pixels)
        level = np.cos(phi)
        return vectors(level * np.sin(theta), -np.sin(phi), level * np.cos(theta)), True

    def _pixels_at(self, theta: Array, up: Array) -> Array:
        """Return the pixels at azimuths and at fractions ``up`` of the image's upper half."""
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
    poles, where all columns meet, ``project`` returns the middle column, and at the seam at +-180
    degrees u = 0 or u = W by the sign of x. Source: OmniSCV, eq. 1.
    """

    name = "equirectangular"
    lens = Parameters()


class _Rows(NamedTuple):
    """The heights of a cylinder's rows, in units in which rows are equally spaced.

    Attributes:
        height: by the slope tan phi.
        level_and_up: cos phi and sin phi by the height.
        to_pole: whether the height of the pole is finite.
    """

    height: Callable[[Array], Array]
    level_and_up: Callable[[Array], tuple[Array, Array]]
    to_pole: bool


# Functions of the slope tan phi: near the pole phi has lost the digits of the height.
_ROWS: dict[str, _Rows] = {
    "perspective": _Rows(
        lambda slope: slope,
        lambda h: (1 / np.hypot(1.0, h), h / np.hypot(1.0, h)),
        to_pole=False,
    ),
    "mercator": _Rows(np.arcsinh, lambda h: (1 / np.cosh(h), np.tanh(h)), to_pole=False),
    "miller": _Rows(
        lambda slope: 1.25 * np.arcsinh(np.tan(0.8 * np.arctan(slope))),
        lambda h: _cos_sin(1.25 * np.arctan(np.sinh(0.8 * h))),
        to_pole=True,
    ),
    "equal-area": _Rows(
        lambda slope: np.sin(np.arctan(slope)),
        lambda h: (np.sqrt((1 - h) * (1 + h)), h),
        to_pole=True,
    ),
}
_LEAST_LEVEL = 1e-17  # keeps the azimuth of rays straight up


@register
class Cylindrical(AngularGrid, CentralCamera):
    """A band around the horizon: ``theta = (2u/W - 1) fov_h / 2`` to the right; rows by ``profile``:
    their height h(phi) falls evenly from ``h(fov_v / 2)`` in the first row to ``-h(fov_v / 2)``.

    ``angular``: ``h = phi``, the paper's, a cropped equirectangular image; ``perspective``: ``h = tan phi``,
    a picture on the cylinder's wall; ``mercator``: ``h = asinh(tan phi)``, no shape is distorted, a square
    image at fov_v = 2 x 85.051; ``miller``: ``h = 1.25 asinh(tan(0.8 phi))``; ``equal-area``: ``h = sin phi``
    (Lambert), every pixel spans the same solid angle.
    Parameters: ``fov_h_deg`` <= 360 (default 360), ``fov_v_deg`` <= 180 (perspective, mercator: < 180;
    default 90). Domain: every pixel; directions within the field of view.
    Source: OmniSCV, eq. 2; Snyder, Map Projections (1987), for mercator, miller and equal-area.
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
        rows = _ROWS.get(self.profile)
        self.fov_h_deg = number("fov_h_deg", fov_h_deg, above=0, most=360)
        limit = {"most" if rows is None or rows.to_pole else "below": 180.0}
        self.fov_v_deg = number("fov_v_deg", fov_v_deg, above=0, **limit)
        self._half = np.radians([self.fov_h_deg / 2, self.fov_v_deg / 2])
        if rows is not None:
            across, along = sin_cos_of_half(self.fov_v_deg)
            self._top = rows.height(across / along)

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        if self.profile == "angular":
            return super()._directions(pixels)
        theta, _ = self._angles(pixels)
        level, up = _ROWS[self.profile].level_and_up((1 - 2 * pixels[..., 1] / self.height) * self._top)
        level = np.maximum(level, _LEAST_LEVEL)
        return vectors(level * np.sin(theta), -up, level * np.cos(theta)), True

    def _project(self, points: Array) -> tuple[Array, Mask | bool]:
        if self.profile == "angular":
            return super()._project(points)
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        height = _ROWS[self.profile].height(-y / np.hypot(x, z))
        return self._pixels_at(np.arctan2(x, z), height / self._top), True


def _cos_sin(phi: Array) -> tuple[Array, Array]:
    return np.cos(phi), np.sin(phi)
