"""Captures that several cameras share, and what they cost.

Central cameras at one optical centre share a cube map, made for the finest of them, where that takes less
than views of each one's own. Cameras that each need a narrow view do not gain from it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from omniscv.geometry import Pose
from omniscv.planning.plan import Plan, get
from omniscv.planning.rays import ImageRays
from omniscv.planning.rounds import pixels_of
from omniscv.planning.viewpoints import SAME_M
from omniscv.planning.views import PIXELS_PER_REQUEST
from omniscv.sources.base import Request

_MARKED = 0.03
"""Share of marked pixels of images in rooms, from own optical centres (docs/accuracy.md)."""
_BUSY = 2
"""Captures of an image whose doubt is bounded, relative to those expected in a furnished room: other rooms
took 1.1 to 2 times as many."""
_PLANNED_POSES = 3
"""Of a camera whose captures serve one pose: costs at others are like theirs."""


def share_captures(plans: Sequence[Plan], modes: Sequence[str]) -> list[Plan]:
    """Return plans for several cameras at one moment, which share captures.

    Args:
        plans: in any order; of one source.
        modes: of the captures.

    Raises:
        ArgumentError: the source cannot do what a plan's strategy needs.
    """
    shared = list(plans)
    for group in _groups(plans):
        center_w = plans[group[0]].pose.position
        at_center = []
        for i in group:
            at_center.append(replace(plans[i], pose=Pose(center_w, plans[i].pose.rotation)))
        for i, plan in zip(group, _cheapest(at_center, modes), strict=True):
            shared[i] = plan
    return shared


def _groups(plans: Sequence[Plan]) -> list[list[int]]:
    """Return the plans, by index, whose cameras share an optical centre; central ones apart from others."""
    groups: list[list[int]] = []
    for i, plan in enumerate(plans):
        for group in groups:
            first = plans[group[0]]
            apart = np.abs(first.pose.position - plan.pose.position).max()
            alike = first.rays.camera.central == plan.rays.camera.central and first.state == plan.state
            if apart < SAME_M and alike:
                group.append(i)
                break
        else:
            groups.append([i])
    return [group for group in groups if len(group) > 1]


def _cheapest(plans: list[Plan], modes: Sequence[str]) -> list[Plan]:
    """Return plans at one centre: each its own, or faces of one cube map, whichever takes less."""
    if not plans[0].rays.camera.central:
        made = []
        for plan in plans:
            made.append(plan.make(plan.modes) if plan.modes else plan)
        return made
    # Planned as if captures were new, as when the recording was made; not by the views that it lacks.
    cheapest = _cheapest_new([replace(plan, recorded=None) for plan in plans], modes)
    if plans[0].recorded is None:
        return cheapest
    replayed = []
    for plan, best in zip(plans, cheapest, strict=True):
        replayed.append(replace(plan, options=best.options, shared=best.shared).make(modes))
    for plan in replayed:
        if not plan.available([request.view for request in plan.requests]):
            return [plan.make(modes) for plan in plans]
    return replayed


def _cheapest_new(plans: list[Plan], modes: Sequence[str]) -> list[Plan]:
    """Return plans at one centre, whose captures are new: each its own, or with faces that they share."""
    own = [plan.make(modes) for plan in plans]
    best = own
    least = _work(own)
    if least == 0:
        return own
    everybody = list(range(len(plans)))
    # A narrow camera that one view holds may need finer faces than all others.
    wide = [i for i in everybody if _view_count(own[i]) > 1]
    choices = [everybody] if wide == everybody else [everybody, wide]
    for sharing in choices:
        if len(sharing) < 2:
            continue
        edge = max(plans[i].edge for i in sharing)
        together = list(own)
        for i in sharing:
            together[i] = replace(plans[i].by(face_size=edge), shared=True).make(modes)
        work = _work(together)
        if work < least:
            best = together
            least = work
    return best


def _view_count(plan: Plan) -> int:
    """Return how many views a plan captures."""
    return len({request.view for request in plan.requests})


def _work(plans: Sequence[Plan]) -> float:
    """Return what the distinct requests of plans cost a source, in requests."""
    requests: dict[Request, None] = {}
    for plan in plans:
        requests |= plan.requests
    return len(requests) + pixels_of(request.view for request in requests) / PIXELS_PER_REQUEST


@dataclass(frozen=True)
class Cost:
    """Captures and time of images: an estimate for a furnished room where they depend on what is captured.

    Attributes:
        way: the strategy's name, or an accuracy such as ``1 %``.
        requests: captures.
        most: captures that they may become, where what is seen decides.
        pixels: captured, over all modes.
        seconds: as they were measured; None if nothing was.
        marked: the largest share of an image's pixels that it is expected to mark as inexact or unsure; 1
            where the options have optical centres shared, which nothing is known of.
        traced: modes that are not captured: they come by rays.
    """

    way: str
    requests: int
    pixels: int
    most: int = 0
    marked: float = 0.0
    traced: tuple[str, ...] = ()
    seconds: float | None = None

    def __add__(self, other: Cost) -> Cost:
        """Return the cost of two sets of images that share no captures."""
        return replace(
            self,
            requests=self.requests + other.requests,
            pixels=self.pixels + other.pixels,
            seconds=_sum(self.seconds, other.seconds),
            most=self.most + other.most,
            marked=max(self.marked, other.marked),
            traced=self.traced or other.traced,
        )

    def times(self, factor: float) -> Cost:
        """Return the cost of so many times the images, alike and without shared captures."""
        return replace(
            self,
            requests=round(factor * self.requests),
            pixels=round(factor * self.pixels),
            most=round(factor * self.most),
            seconds=None if self.seconds is None else factor * self.seconds,
        )


def _sum(seconds: float | None, other: float | None) -> float | None:
    """Return the sum of seconds; None if some are not known."""
    return None if seconds is None or other is None else seconds + other


def cost(way: str, frames: Iterable[Sequence[Plan]], modes: Sequence[str], **changes: Any) -> Cost:
    """Return the cost of images whose views are captured once each.

    Args:
        way: its name.
        frames: for each moment its plans, which share captures. Those that hardly do so with other moments
            are planned at a few of the poses, and counted for all.
        modes: of the captures.
        changes: of the options of the plans.

    Raises:
        ArgumentError: the source cannot do what the strategy needs.
    """
    total = Cost(way, 0, 0)
    shared: dict[Request, None] = {}
    apart: dict[ImageRays, dict[tuple[Any, ...], Plan]] = defaultdict(dict)
    for plans in frames:
        changed = [replace(plan.by(**changes), modes=tuple(modes)).by_rays() for plan in plans]
        total = replace(total, traced=total.traced or changed[0].by_ray)
        for plan in share_captures([plan for plan in changed if not _is_apart(plan)], modes):
            shared |= plan.requests or plan.make(modes).requests
            if not plan.by_ray:
                total = replace(total, marked=max(total.marked, _MARKED))
        for plan in filter(_is_apart, changed):
            position = plan.pose.position.tobytes()
            rotation = plan.pose.rotation.tobytes()
            apart[plan.rays][position, rotation, plan.state] = plan
    for plans_of_camera in apart.values():
        step = math.ceil(len(plans_of_camera) / _PLANNED_POSES)
        planned = list(plans_of_camera.values())[::step]
        alone = reduce(add, [_cost_alone(plan, way) for plan in planned])
        total += alone.times(len(plans_of_camera) / len(planned))
    return total + Cost(way, len(shared), pixels_of(request.view for request in shared), len(shared))


def _is_apart(plan: Plan) -> bool:
    """Return whether an image hardly shares captures with those at other poses."""
    return plan.doubt_share is not None or not plan.rays.camera.central


def _cost_alone(plan: Plan, way: str) -> Cost:
    if not plan.modes:
        return Cost(way, 0, 0)
    if plan.doubt_share:
        marked = plan.doubt_share
    elif plan.rays.one_center or plan.options.viewpoints is None:
        marked = _MARKED
    else:
        marked = 1.0
    requests, pixels = get(plan.options.strategy).expected(plan)
    most = requests if plan.doubt_share is None else _BUSY * requests
    return Cost(way, requests, pixels, most, marked)
