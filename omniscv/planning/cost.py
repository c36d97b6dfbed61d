"""What a plan costs, before it is run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any

import numpy as np

from omniscv import modalities
from omniscv.planning.base import Round, Task, Viewpoint, drive
from omniscv.planning.registry import get, rounds
from omniscv.planning.sharing import together
from omniscv.sources.base import Request


@dataclass(frozen=True)
class Cost:
    """What a strategy asks of a source. Where that depends on what is captured, an estimate, and the most.

    Attributes:
        strategy: its name.
        views: pictures.
        requests, most_requests: captures.
        pixels: captured, over all modes.
        bytes: on the wire, estimated.
        seconds: estimated.
        displacement_m: the largest distance from a pixel's own optical centre to its captures' one, metres.
    """

    strategy: str
    views: int
    requests: int
    most_requests: int
    pixels: int
    bytes: float
    seconds: float
    displacement_m: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        """Return what the strategy asks for two sets of images that share no captures."""
        sums = {
            each.name: getattr(self, each.name) + getattr(other, each.name)
            for each in fields(self)
            if each.name not in ("strategy", "displacement_m")
        }
        displacement_m = max(self.displacement_m, other.displacement_m)
        return Cost(strategy=self.strategy, displacement_m=displacement_m, **sums)


def cost(
    strategy: str, frames: Iterable[Sequence[Task]], modes: Sequence[str], seconds_per_request: float
) -> Cost:
    """Return the cost of images whose views are captured once each.

    Args:
        strategy: its name; in place of the one that the tasks' options have.
        frames: of each moment one task an image; these share captures.
        modes: what is captured.
        seconds_per_request: of the source.

    Raises:
        ArgumentError: the source cannot do what the strategy needs.
    """
    requests: dict[Request, None] = {}
    further = most = 0
    displacement_m = 0.0
    for task in chain.from_iterable(_with_strategy(strategy, frame, modes) for frame in frames):
        serving: list[Viewpoint] = []

        def plan(round_: Round, serving: list[Viewpoint] = serving) -> None:
            requests.update(dict.fromkeys(round_.requests(modes)))
            serving += round_.viewpoints

        drive(rounds(task), plan)
        displacement_m = max([displacement_m, *(_displacement_m(task, each) for each in serving)])
        estimate, limit = get(strategy).further_views(task)
        further, most = further + estimate, most + limit
    each = len({*modes, "depth"}) if further else len(modes)
    areas = [request.view.width * request.view.height for request in requests]
    largest = dict.fromkeys(modes, 0)
    for request, area in zip(requests, areas, strict=True):
        largest[request.mode] = max(area, largest.get(request.mode, 0))
    wire_bytes = sum(a * modalities.get(r.mode).wire_bytes for a, r in zip(areas, requests, strict=True))
    further_bytes = sum(modalities.get(mode).wire_bytes * area for mode, area in largest.items())
    count = len(requests) + further * each
    return Cost(
        strategy,
        views=len({request.view for request in requests}) + further,
        requests=count,
        most_requests=len(requests) + most * each,
        pixels=sum(areas) + further * sum(largest.values()),
        bytes=wire_bytes + further * further_bytes,
        seconds=count * seconds_per_request,
        displacement_m=displacement_m,
    )


def _with_strategy(strategy: str, frame: Sequence[Task], modes: Sequence[str]) -> list[Task]:
    """The tasks of a moment with a strategy, and with options by which they share captures."""
    changes: dict[str, Any] = {"strategy": strategy}
    if not get(strategy).approximate:
        changes["max_error_px"] = None
    return together([replace(task, options=replace(task.options, **changes)) for task in frame], modes)[0]


def _displacement_m(task: Task, viewpoint: Viewpoint) -> float:
    """How far from its own optical centre a pixel is captured, at most; marched rays are not."""
    origins = task.rays.origins
    if origins is None or viewpoint.toward_w is not None or not len(viewpoint.pixels):
        return 0.0
    own_w = task.pose.to_world(origins.reshape(-1, 3)[viewpoint.pixels])
    return float(np.linalg.norm(own_w - viewpoint.center_w, axis=1).max())
