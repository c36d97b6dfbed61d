"""Panoramas: azimuth across, elevation down."""

from __future__ import annotations

import numpy as np

from omniscv.cameras.base import Array, Camera, Mask


class Equirectangular(Camera):
    """The whole sphere in a rectangle of angles.

    ``theta = (2u/W - 1) pi`` to the right, ``phi = (1/2 - v/H) pi`` up; direction
    ``(cos phi sin theta, -sin phi, cos phi cos theta)``. Domain: every pixel, every direction; at the
    poles, where all columns meet, ``project`` answers the middle column, and the seam at +-180
    degrees is answered as u = 0 or u = W by the sign of x. Source: OmniSCV, eq. 1.
    """

    name = "equirectangular"

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
        return pixels, (points != 0).any(axis=-1)
