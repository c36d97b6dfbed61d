"""The non-central panorama: a camera that turns on an arm while it scans column after column."""

from typing import ClassVar

import numpy as np

from omniscv.arguments import number, whole_number
from omniscv.cameras.base import Array, Mask, Viewpoints
from omniscv.cameras.panoramas import AngularGrid
from omniscv.cameras.registry import register

_ROUNDING = 8 * np.finfo(np.float64).eps


@register
class NoncentralPanorama(AngularGrid):
    """An equirectangular image whose columns look outward from a circle of optical centres.

    ``theta = (2u/W - 1) pi`` and ``phi = (1/2 - v/H) pi`` as in ``equirectangular``; the ray starts at
    ``R_c (sin theta, 0, cos theta)`` and points to ``(cos phi sin theta, -sin phi, cos phi cos theta)``.
    Parameter: ``radius`` R_c >= 0, metres; 0 equals ``equirectangular`` to the bit.
    Domain: every pixel. A point is seen in the column of its own azimuth, unless it lies within the
    upright cylinder of the circle: rays look away from the axis and never come there. On the cylinder
    itself it is seen in the first or last row; on the circle it has no direction.
    Source: OmniSCV, eq. of the semi-toroid (Menem and Pajdla 2004). The paper's pitch is the pose.
    """

    name = "noncentral-panorama"
    typical: ClassVar = {"radius": 1.0}
    central = False

    def __init__(self, width: int, height: int, radius: float) -> None:
        super().__init__(width, height)
        self.radius = number("radius", radius, least=0)

    def _unproject(self, pixels: Array) -> tuple[Array, Array, bool]:
        theta, phi = self._angles(pixels)
        outward = _outward(theta)
        directions = np.cos(phi)[..., None] * outward
        directions[..., 1] = -np.sin(phi)
        return self.radius * outward, directions, True

    def _project(self, points: Array) -> tuple[Array, Mask]:
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        from_axis = np.hypot(x, z)
        ahead = from_axis - self.radius
        # The first and last row look straight up and down, along the cylinder: rounding must not lose them.
        seen = ahead >= -_ROUNDING * self.radius
        ahead = np.maximum(ahead, 0.0)
        pixels = self._pixels_at(np.arctan2(x, z), np.arctan2(-y, ahead) / self._half[1])
        return pixels, seen & ((ahead > 0) | (y != 0))

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """One centre per column, or at most ``count`` for equal steps of azimuth.

        A shared centre is the mean of its columns' own centres (least squares; a single column's is
        exact, and ``count=1`` is the axis). Columns of a step of ``2 pi / count`` are displaced by at
        most about ``radius * pi / count`` from it. One centre suffices at radius 0.
        """
        count = whole_number("count", self.width if count is None else count, "viewpoints")
        groups = 1 if self.radius == 0 else min(count, self.width)
        group = np.arange(self.width) * groups // self.width
        theta = (2 * np.arange(0.5, self.width) / self.width - 1) * np.pi
        origins = self.radius * _outward(theta)
        first = np.searchsorted(group, np.arange(groups))
        centers = np.add.reduceat(origins, first) / np.bincount(group)[:, None]
        index = np.broadcast_to(group.astype(np.int32), (self.height, self.width)).copy()
        return Viewpoints(centers, index)


def _outward(theta: Array) -> Array:
    """(..., 3) the level unit vector at an azimuth."""
    outward = np.zeros((*theta.shape, 3))
    outward[..., 0], outward[..., 2] = np.sin(theta), np.cos(theta)
    return outward
