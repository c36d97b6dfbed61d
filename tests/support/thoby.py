"""A camera model of an outsider: Thoby's fit to a real fisheye, registered through public names alone."""

import numpy as np

from omniscv import cameras
from omniscv.errors import ArgumentError


@cameras.register
class Thoby(cameras.CentralCamera):
    """A lens by two numbers: ``r = f k1 sin(k2 phi)``, phi from +z.

    Parameters: ``focal`` f in px; ``k1`` and ``k2``, without unit.
    Domain: phi <= pi / (2 k2), where the radius no longer grows; r <= f k1.
    Source: Thoby, on the AF DX 10.5 mm: k1 = 1.47, k2 = 0.713.
    """

    name = "fisheye-thoby"

    def __init__(self, width, height, focal, k1=1.47, k2=0.713, center=None):
        super().__init__(width, height, center)
        for key, value in (("focal", focal), ("k1", k1), ("k2", k2)):
            if not isinstance(value, int | float) or not 0 < value < np.inf:
                raise ArgumentError(f"{key}: expected a finite number > 0, got {value!r}")
            setattr(self, key, float(value))

    @classmethod
    def example(cls, width=512):
        return cls(width, width, focal=0.4 * width)

    def _directions(self, pixels):
        x, y = np.moveaxis(pixels - self.center, -1, 0) / (self.focal * self.k1)
        t = np.hypot(x, y)
        phi = np.arcsin(np.minimum(t, 1)) / self.k2
        across = np.where(t > 0, np.sin(phi) / np.where(t > 0, t, 1), 0)
        return np.stack([across * x, across * y, np.cos(phi)], axis=-1), t <= 1

    def _project(self, points):
        x, y, z = np.moveaxis(points, -1, 0)
        across = np.hypot(x, y)
        turned = self.k2 * np.arctan2(across, z)
        scale = self.focal * self.k1 * np.sin(turned) * (1 - 1e-14) / np.where(across > 0, across, 1)
        return self.center + np.stack([scale * x, scale * y], axis=-1), turned <= np.pi / 2
