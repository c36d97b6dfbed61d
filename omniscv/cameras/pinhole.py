"""The perspective camera."""

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number
from omniscv.cameras.base import Array, CentralCamera, Mask, refuse_focal_and_fov, sin_cos_of_half
from omniscv.cameras.registry import register


@register
class Pinhole(CentralCamera):
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
        refuse_focal_and_fov(focal, fov_deg)
        if focal is not None:
            self.focal = number("focal", focal, above=0)
        else:
            fov = number("fov_deg", 90.0 if fov_deg is None else fov_deg, above=0, below=180)
            across, along = sin_cos_of_half(fov)
            self.focal = self.width / 2 * float(along / across)

    def _directions(self, pixels: Array) -> tuple[Array, Mask]:
        xy = (pixels - self.center) / self.focal
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        length = np.linalg.norm(rays, axis=-1, keepdims=True)
        return rays / length, np.isfinite(length[..., 0])

    def _project(self, points: Array) -> tuple[Array, Mask]:
        z = points[..., 2:]
        return self.center + self.focal * points[..., :2] / z, z[..., 0] > 0
