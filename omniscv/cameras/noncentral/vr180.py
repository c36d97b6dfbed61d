"""VR180: a pair of half panoramas side by side."""

from typing import ClassVar

import numpy as np

from omniscv.arguments import number, one_of
from omniscv.cameras.base import FARTHEST, Array, Mask, Viewpoints
from omniscv.cameras.noncentral.panorama import Eye, side
from omniscv.cameras.panoramas import AngularGrid
from omniscv.cameras.registry import register


@register
class Vr180(AngularGrid):
    """One eye of a VR180 pair: the half sphere ahead, from an optical centre beside the middle of the head.

    ``theta = (u/W - 1/2) pi`` and ``phi = (1/2 - v/H) pi``, direction as in ``equirectangular``; all rays
    start at ``s (b / 2, 0, 0)``, s = -1 for the left eye and +1 for the right one.
    Parameters: ``interpupillary`` b >= 0, metres (people: about 0.064); ``eye``, "left" or "right".
    Domain: every pixel, and points with z > 0. The pose is that of the head: both eyes have the same one.
    Source: Google, VR180 video format (2018).
    """

    name = "vr180"
    typical: ClassVar = {"interpupillary": 0.064}
    central = False
    _half = np.array([np.pi / 2, np.pi / 2])

    def __init__(self, width: int, height: int, interpupillary: float, eye: Eye = "left") -> None:
        super().__init__(width, height)
        self.interpupillary = number("interpupillary", interpupillary, least=0, most=FARTHEST)
        self.eye: Eye = one_of("eye", eye, ("left", "right"))
        self._center_c = np.array([side(self.eye) * self.interpupillary / 2, 0.0, 0.0])

    @classmethod
    def example(cls, width: int = 512) -> "Vr180":
        return cls(width, width, **cls.typical)

    def _unproject(self, pixels: Array) -> tuple[Array, Array, bool]:
        directions, _ = self._directions(pixels)
        return np.zeros_like(directions) + self._center_c, directions, True

    def _project(self, points: Array) -> tuple[Array, Mask]:
        offset = points - self._center_c
        pixels, _ = super()._project(offset)
        return pixels, offset.any(axis=-1)

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """One centre: the eye's."""
        return Viewpoints(self._center_c[None], super().viewpoints(count).index)
