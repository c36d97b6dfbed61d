"""What a plan costs, before it is run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any

import numpy as np

from omniscv import modalities
from omniscv.planning.recorded_views import sees
from omniscv.planning.sharing import Plan, share_captures
from omniscv.planning.strategy import Task, get
from omniscv.sources.base import Request

_AWAY_M = 2.0
_MARKED = 0.03
_MARKED_PER_M = 3.0
"""Marked pixels of images in rooms: their share from own optical centres, and by how much it grows with the
distance to a shared one (docs/accuracy.md)."""


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
        marked: the largest share of an image's pixels that it is expected to mark as inexact or unsure.
    """

    strategy: str
    views: int
    requests: int
    most_requests: int
    pixels: int
    bytes: float
    seconds: float
    displacement_m: float = 0.0
    marked: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        """Return the cost of two sets of images that share no captures."""
        sums = {
            field.name: getattr(self, field.name) + getattr(other, field.name)
            for field in fields(self)
            if field.name not in ("strategy", "displacement_m", "marked")
        }
        displacement_m = max(self.displacement_m, other.displacement_m)
        marked = max(self.marked, other.marked)
        return Cost(strategy=self.strategy, displacement_m=displacement_m, marked=marked, **sums)


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
    displacement_m = marked = 0.0
    changes: dict[str, Any] = {"strategy": strategy}
    if not get(strategy).approximate:
        changes["max_error_px"] = None
    changed = ([replace(t, options=replace(t.options, **changes)) for t in tasks] for tasks in frames)
    for plan in chain.from_iterable(share_captures(tasks, modes) for tasks in changed):
        plan = plan if plan.requests else Plan.make(plan.task, modes)
        requests |= plan.requests
        displacements_m, shares = _shared(plan)
        displacement_m, marked = max(displacement_m, displacements_m), max(marked, shares)
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
        marked=marked,
    )


def _shared(plan: Plan) -> tuple[float, float]:
    """Return the largest distance from a pixel's optical centre to that of its captures, metres, and the
    share of pixels that are expected to be marked.

    Viewpoints of marched rays count as exact. Labels are marked where no view shows the point that a ray
    meets, taken to be 2 m away; else by measurement of rooms.
    """
    task = plan.task
    if task.rays.origins is None:
        return 0.0, _MARKED
    farthest_m, marked = 0.0, _MARKED * task.rays.valid_count
    for viewpoint in (viewpoint for round_ in plan.planned or () for viewpoint in round_.viewpoints):
        if viewpoint.toward_w is not None or not len(viewpoint.pixels):
            continue
        own_w = task.origins_w(viewpoint.pixels) - viewpoint.center_w
        away = np.linalg.norm(own_w, axis=1)
        points = own_w + _AWAY_M * task.directions_w(viewpoint.pixels)  # from the centre
        shown = np.any([sees(view, points) for view in viewpoint.views], axis=0)
        farthest_m = max(farthest_m, float(away.max()))
        marked += float(np.where(shown, np.minimum(_MARKED_PER_M * away, 1 - _MARKED), 1 - _MARKED).sum())
    return farthest_m, marked / max(1, task.rays.valid_count)
