"""What a plan costs, before it is run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from omniscv.captures.source import Source
from omniscv.captures.view import Request, View
from omniscv.geometry import Pose
from omniscv.plan.base import Plan

BYTES_PER_PIXEL = {"lit": 1.5, "object_mask": 0.1, "depth": 4.0, "normal": 1.0}
"""What a pixel takes on the wire: PNG of furnished rooms, raw floats for depth."""

_PROBES = 3
_PROBE_PX = 16


@dataclass(frozen=True)
class Cost:
    """What a strategy asks of a source.

    Attributes:
        strategy: its name.
        views: pictures, each in every mode.
        requests: captures: views times modes.
        pixels: captured, over all modes.
        bytes: on the wire, estimated.
        seconds: estimated from the time that one small capture takes on the source.
    """

    strategy: str
    views: int
    requests: int
    pixels: int
    bytes: float
    seconds: float


def cost(strategy: str, plans: Sequence[Plan], modes: Sequence[str], latency_s: float) -> Cost:
    """The cost of plans whose views are captured once each; ``latency_s`` is the time of a request."""
    views = dict.fromkeys(view for plan in plans for view in plan.views())
    area = sum(view.width * view.height for view in views)
    requests = len(views) * len(modes)
    size = sum(BYTES_PER_PIXEL[mode] for mode in modes) * area
    return Cost(strategy, len(views), requests, area * len(modes), size, requests * latency_s)


def measure_latency(source: Source) -> float:
    """Seconds that a small capture takes; 0 for a recorded source, which captures nothing."""
    if source.recorded_views() is not None:
        return 0.0
    size = source.capabilities.image_size or (_PROBE_PX, _PROBE_PX)
    probes = [
        Request(View(Pose.from_angles((0, 0, 1.5), yaw_deg=turn), 90.0, *size), "lit")
        for turn in range(_PROBES)
    ]
    list(source.capture(probes[:1]))  # the first one sets size and field of view
    started = time.perf_counter()
    for probe in probes:
        list(source.capture([probe]))
    return (time.perf_counter() - started) / _PROBES
