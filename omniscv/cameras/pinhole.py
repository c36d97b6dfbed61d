"""The perspective camera."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array, Camera, Mask, sin_cos_of_half
from omniscv.errors import ArgumentError


class Pinhole(Camera):
    """A perspective camera: ``u = u_0 + f x / z``, ``v = v_0 + f y / z``.

    Parameters: ``focal`` f in px, or ``fov_deg``, the angle from the left to the right edge of an image
    whose centre is in the middle, ``f = (W / 2) / tan(fov / 2)``; 90 if neither is given.
    Domain: every pixel; points with z > 0; 0 < fov_deg < 180.
    Source: any textbook; pixel centres at +0.5.
    """

    name = "pinhole"

    def __init__(
        self,
        width: int,
        height: int,
        focal: float | None = None,
        fov_deg: float | None = None,
        center: ArrayLike | None = None,
    ) -> None:
        super().__init__(width, height, center)
        if focal is not None and fov_deg is not None:
            raise ArgumentError(
                f"focal: expected focal or fov_deg, got both ({focal!r} px and {fov_deg!r} deg)"
            )
        if focal is not None:
            self.focal = self._number("focal", focal, above=0)
        else:
            fov = self._number("fov_deg", 90.0 if fov_deg is None else fov_deg, above=0, below=180)
            across, along = sin_cos_of_half(fov)
            self.focal = self.width / 2 * float(along / across)

    def parameters(self) -> dict[str, Any]:
        return {"focal": self.focal}

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        xy = (pixels - self.center) / self.focal
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.zeros_like(directions), directions, np.ones(pixels.shape[:-1], dtype=bool)

    def _project(self, points: Array) -> tuple[Array, Mask]:
        z = points[..., 2:]
        return self.center + self.focal * points[..., :2] / z, z[..., 0] > 0
