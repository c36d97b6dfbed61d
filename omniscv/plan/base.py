"""What a plan is: the views that an image needs, and which of its pixels each optical centre serves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.captures.view import Capture, Request, View
from omniscv.geometry import Array, Pose

PROBE_MODES = ("depth",)


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

    def requests(self, modes: Sequence[str]) -> list[Request]:
        """What is captured, view by view: a server then poses its camera once for all modes.

        Depth comes first, because it differs between places where colours may be alike: a live source
        can tell by it that its camera has moved.
        """
        order = sorted(modes, key=lambda mode: mode != "depth")
        return [Request(view, mode) for view in self.views for mode in order]

    def by_mode(self, modes: Sequence[str], captures: Iterator[Capture]) -> dict[str, list[Capture]]:
        """The next captures, those of :meth:`requests`, as one list for each mode in the views' order."""
        found: dict[str, list[Capture]] = {mode: [] for mode in modes}
        for capture in islice(captures, len(self.views) * len(modes)):
            found[capture.mode].append(capture)
        return found


@dataclass(frozen=True, eq=False)
class Plan:
    """The views that an image of ``camera`` at ``pose`` is composed from.

    Attributes:
        camera, pose: what is rendered.
        strategy: the name of the strategy that made the plan.
        stations: one per optical centre; every valid pixel of the camera is in exactly one.
        border_px: how many pixels beyond the pixels that rays hit each view holds, for filters.
        probe: views for depth at the camera's own position, to tell which centres are in the open; None
            for a single centre, or where a record has none.
        more: gives the station of a further optical centre, (3,) world frame, for strategies that find out
            while they capture what they need.
    """

    camera: Camera
    pose: Pose
    strategy: str
    stations: tuple[Station, ...]
    border_px: int = 0
    probe: Station | None = None
    more: Callable[[Array], Station] | None = None

    def views(self) -> Iterator[View]:
        """All views, in the order of their capture."""
        for station in self.stations:
            yield from station.views

    def requests(self, modes: Sequence[str]) -> Iterator[Request]:
        """What is captured: the probe's depth, then station by station."""
        if self.probe is not None:
            yield from self.probe.requests(PROBE_MODES)
        for station in self.stations:
            yield from station.requests(modes)

    def __len__(self) -> int:
        """How many views the plan has."""
        return sum(len(station.views) for station in self.stations)
