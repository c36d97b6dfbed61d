"""What a plan is: the views that an image needs, and which of its pixels each optical centre serves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.captures.view import View
from omniscv.geometry import Array, Pose


@dataclass(frozen=True, eq=False)
class Station:
    """All that is captured from one optical centre.

    Attributes:
        center_w: (3,) the centre, world frame, metres: where depth is measured from.
        views: the pictures taken there, all of one size.
        pixels: (N,) int64, row-major flat indices of the image's valid pixels that it serves.
    """

    center_w: Array
    views: tuple[View, ...]
    pixels: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Plan:
    """The views that an image of ``camera`` at ``pose`` is composed from.

    Attributes:
        camera, pose: what is rendered.
        strategy: the name of the strategy that made the plan.
        stations: one per optical centre; every valid pixel of the camera is in exactly one.
        border_px: how many pixels beyond the pixels that rays hit each view holds, for filters.
        more: gives the station of a further optical centre, (3,) world frame, for strategies that find out
            while they capture what they need.
    """

    camera: Camera
    pose: Pose
    strategy: str
    stations: tuple[Station, ...]
    border_px: int = 0
    more: Callable[[Array], Station] | None = None

    def views(self) -> Iterator[View]:
        """All views, in the order of their capture."""
        for station in self.stations:
            yield from station.views

    def __len__(self) -> int:
        """How many views the plan has."""
        return sum(len(station.views) for station in self.stations)
