"""Panoramas: azimuth across, elevation down."""

from __future__ import annotations

from typing import Any

import numpy as np

from omniscv.cameras.base import Array, Camera, Mask, sin_cos_of_half
from omniscv.errors import ArgumentError


class Equirectangular(Camera):
    """The whole sphere in a rectangle of angles.

    ``theta = (2u/W - 1) pi`` to the right, ``phi = (1/2 - v/H) pi`` up; direction
    ``(cos phi sin theta, -sin phi, cos phi cos theta)``. Domain: every pixel, every direction; at the
    poles, where all columns meet, ``project`` answers the middle column, and the seam at +-180
    degrees is answered as u = 0 or u = W by the sign of x. Source: OmniSCV, eq. 1.
    """

    name = "equirectangular"
    has_center = False

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        theta = (2 * pixels[..., 0] / self.width - 1) * np.pi
        phi = (0.5 - pixels[..., 1] / self.height) * np.pi
        directions = np.stack(
            [np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)], axis=-1
        )
        return np.zeros_like(directions), directions, np.ones(pixels.shape[:-1], dtype=bool)

    def _project(self, points: Array) -> tuple[Array, Mask]:
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        theta = np.arctan2(x, z)
        phi = np.arctan2(-y, np.hypot(x, z))
        pixels = np.stack([(theta / np.pi + 1) * self.width / 2, (0.5 - phi / np.pi) * self.height], axis=-1)
        return pixels, np.ones(points.shape[:-1], dtype=bool)


class Cylindrical(Camera):
    """A band around the horizon: ``theta = (2u/W - 1) fov_h / 2`` to the right, and up, by ``profile``:

    ``angular``: ``phi = (1 - 2v/H) fov_v / 2``, the paper's, a cropped equirectangular image;
    ``perspective``: ``tan phi = (1 - 2v/H) tan(fov_v / 2)``, rows equally spaced on the cylinder's wall.
    Parameters: ``fov_h_deg`` <= 360 (default 360), ``fov_v_deg`` <= 180 (perspective: < 180; default 90).
    Domain: every pixel; directions within the field of view. Source: OmniSCV, eq. 2.
    """

    name = "cylindrical"
    has_center = False

    def __init__(
        self,
        width: int,
        height: int,
        fov_h_deg: float = 360.0,
        fov_v_deg: float = 90.0,
        profile: str = "angular",
    ) -> None:
        super().__init__(width, height)
        if profile not in ("angular", "perspective"):
            raise ArgumentError(f"profile: expected 'angular' or 'perspective', got {profile!r}")
        self.profile = profile
        self.fov_h_deg = self._number("fov_h_deg", fov_h_deg, above=0, most=360)
        limit = {"most" if profile == "angular" else "below": 180.0}
        self.fov_v_deg = self._number("fov_v_deg", fov_v_deg, above=0, **limit)
        self._half = np.radians([self.fov_h_deg / 2, self.fov_v_deg / 2])
        if profile == "perspective":
            across, along = sin_cos_of_half(self.fov_v_deg)
            self._wall = across / along  # half the wall's height over the cylinder's radius

    def parameters(self) -> dict[str, Any]:
        return {"fov_h_deg": self.fov_h_deg, "fov_v_deg": self.fov_v_deg, "profile": self.profile}

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        theta = (2 * pixels[..., 0] / self.width - 1) * self._half[0]
        row = 1 - 2 * pixels[..., 1] / self.height
        if self.profile == "angular":
            level, up = np.cos(row * self._half[1]), np.sin(row * self._half[1])
        else:  # not by way of phi, which has lost the wall's height when it is nearly straight up
            height = row * self._wall
            level = 1 / np.hypot(1.0, height)
            up = height * level
        directions = np.stack([level * np.sin(theta), -up, level * np.cos(theta)], axis=-1)
        return np.zeros_like(directions), directions, np.ones(pixels.shape[:-1], dtype=bool)

    def _project(self, points: Array) -> tuple[Array, Mask]:
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        from_axis = np.hypot(x, z)
        if self.profile == "angular":
            row = np.arctan2(-y, from_axis) / self._half[1]
        else:
            row = -y / from_axis / self._wall
        column = np.arctan2(x, z) / self._half[0]
        pixels = np.stack([(column + 1) * self.width / 2, (1 - row) * self.height / 2], axis=-1)
        return pixels, np.ones(points.shape[:-1], dtype=bool)  # the band is the rectangle
