"""Random orientations, and random cameras, for images that are composed on the fly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from omniscv.arguments import numbers, shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose


class Draw(Protocol):
    """What a sample is drawn by: any function that can be pickled for workers that are spawned."""

    def __call__(self, random: np.random.Generator) -> tuple[Camera, Array]:
        """Return a central camera and (3, 3) ``R_w_c``, of nothing but the generator."""


@dataclass(frozen=True)
class RandomTurns:
    """One of some cameras, and angles that are drawn evenly from ranges.

    Attributes:
        cameras: central ones; each is as likely. Batches need images of one size.
        yaw_deg, pitch_deg, roll_deg: least and most, degrees, as :meth:`omniscv.Pose.from_angles` has them.

    Raises:
        ArgumentError: no camera, one that is not central, or a range that is none.
    """

    cameras: Sequence[Camera]
    yaw_deg: tuple[float, float] = (-180.0, 180.0)
    pitch_deg: tuple[float, float] = (0.0, 0.0)
    roll_deg: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        cameras = (self.cameras,) if isinstance(self.cameras, Camera) else tuple(self.cameras)
        if not cameras:
            raise ArgumentError("cameras: expected at least one camera, got none")
        for camera in cameras:
            check_central(camera)
        for name in ("yaw_deg", "pitch_deg", "roll_deg"):
            least, most = numbers(name, getattr(self, name), (2,)).tolist()
            if least > most:
                raise ArgumentError(f"{name}: expected (least, most), got ({least:g}, {most:g})")
        object.__setattr__(self, "cameras", cameras)

    def __call__(self, random: np.random.Generator) -> tuple[Camera, Array]:
        camera = self.cameras[int(random.integers(len(self.cameras)))]
        angles = [float(random.uniform(*each)) for each in (self.yaw_deg, self.pitch_deg, self.roll_deg)]
        return camera, Pose.from_angles((0, 0, 0), *angles).R_w_c


def check_central(camera: object) -> None:
    """Raise ArgumentError unless a camera has a single optical centre."""
    if not isinstance(camera, Camera):
        raise ArgumentError(f"camera: expected a Camera, got {shown(camera)}")
    if not camera.central:
        wanted = "expected a camera with a single optical centre"
        raise ArgumentError(f"camera: {wanted}, got {camera.name}; render it with omniscv.render")
