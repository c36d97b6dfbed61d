"""What a plan costs, before it is run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any

import numpy as np

from omniscv import modalities
from omniscv.planning.sharing import Plan, share_captures
from omniscv.planning.strategy import Task, get
from omniscv.sources.base import Request


@dataclass(frozen=True)
class Cost:
    """Captures and time that a strategy needs: an estimate where they depend on captured depth.

    Attributes:
        strategy: its name.
        views: pictures.
        requests, most_requests: captures, estimated and at most.
        pixels: captured, over all modes.
        bytes: on the wire, estimated.
        seconds: estimated.
        displacement_m: the largest distance from a pixel's optical centre to that of its captures, metres.
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
        """Return the cost of two sets of images that share no captures."""
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
        strategy: its name; used instead of the strategy in the tasks' options.
        frames: for each moment its tasks, which share captures.
        modes: of the captures.
        seconds_per_request: of the source.

    Raises:
        ArgumentError: the source cannot do what the strategy needs.
    """
    requests: dict[Request, None] = {}
    further = most = 0
    displacement_m = 0.0
    for plan in chain.from_iterable(_plans(strategy, tasks, modes) for tasks in frames):
        requests |= plan.requests
        displacement_m = max([displacement_m, *_displacements_m(plan)])
        estimate, limit = get(strategy).further_views(plan.task)
        further, most = further + estimate, most + limit
    modes_per_view = len({*modes, "depth"}) if further else len(modes)
    areas = [request.view.width * request.view.height for request in requests]
    largest = dict.fromkeys(modes, 0)
    for request, area in zip(requests, areas, strict=True):
        largest[request.mode] = max(area, largest.get(request.mode, 0))
    wire_bytes = sum(a * modalities.get(r.mode).wire_bytes for a, r in zip(areas, requests, strict=True))
    further_bytes = sum(modalities.get(mode).wire_bytes * area for mode, area in largest.items())
    count = len(requests) + further * modes_per_view
    return Cost(
        strategy,
        views=len({request.view for request in requests}) + further,
        requests=count,
        most_requests=len(requests) + most * modes_per_view,
        pixels=sum(areas) + further * sum(largest.values()),
        bytes=wire_bytes + further * further_bytes,
        seconds=count * seconds_per_request,
        displacement_m=displacement_m,
    )


def _plans(strategy: str, tasks: Sequence[Task], modes: Sequence[str]) -> list[Plan]:
    """Return the plans of a moment's tasks with a strategy, by which they share captures."""
    changes: dict[str, Any] = {"strategy": strategy}
    if not get(strategy).approximate:
        changes["max_error_px"] = None
    changed = [replace(task, options=replace(task.options, **changes)) for task in tasks]
    return [plan if plan.requests else Plan.make(plan.task, modes) for plan in share_captures(changed, modes)]


def _displacements_m(plan: Plan) -> Iterator[float]:
    """Yield the largest distance from a pixel's optical centre to the centre of its captures, by viewpoint.

    Viewpoints of marched rays are left out.
    """
    task, origins = plan.task, plan.task.rays.origins
    if origins is None:
        return
    for viewpoint in (each for round_ in plan.planned or () for each in round_.viewpoints):
        if viewpoint.toward_w is None and len(viewpoint.pixels):
            own_w = task.pose.to_world(origins.reshape(-1, 3)[viewpoint.pixels])
            yield float(np.linalg.norm(own_w - viewpoint.center_w, axis=1).max())
