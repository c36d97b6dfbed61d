"""Plans of images: their rounds, captures that several cameras share, and what they cost.

Central cameras at one optical centre share a cube map, made for the finest of them, where that takes less
than views of each one's own. Cameras that each need a narrow view do not gain from it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from omniscv.geometry import Pose
from omniscv.planning import strategy
from omniscv.planning.rays import ImageRays
from omniscv.planning.refinement import OneCenter, Refinement
from omniscv.planning.several_centers import SeveralCenters
from omniscv.planning.strategies import SAME_M
from omniscv.planning.strategy import Round, Rounds, Task, pixels_of
from omniscv.planning.views import PIXELS_PER_REQUEST
from omniscv.render_options import Price
from omniscv.sources.base import Request

_MARKED = 0.03
"""Share of marked pixels of images in rooms, from own optical centres (docs/accuracy.md)."""
_PLANNED_POSES = 3
"""Of a camera whose captures serve one pose: costs at others are like theirs."""


def rounds(task: Task) -> Rounds:
    """Return the rounds of a task's strategy; where it has an aim, and finer ones until that is reached.

    Then the last round has no viewpoints, and says why captures stop.

    Raises:
        ArgumentError: as :func:`omniscv.planning.strategy.rounds`.
    """
    return strategy.rounds(task) if task.aim is None else _refinement(task).rounds()


def _refinement(task: Task) -> Refinement:
    return OneCenter(task) if task.rays.origins is None else SeveralCenters(task)


@dataclass(frozen=True, eq=False)
class Plan:
    """The rounds of a task, planned once.

    Attributes:
        task: the image.
        requests: captures that do not depend on other captures, each once; empty if the plan shares none.
        planned: its rounds, as far as they do not depend on captures; None: not planned yet.
    """

    task: Task
    requests: dict[Request, None] = field(default_factory=dict)
    planned: tuple[Round, ...] | None = None

    @classmethod
    def make(cls, task: Task, modes: Sequence[str]) -> Plan:
        """Return the plan of a task for what is captured in some modes, without capturing."""
        planned = tuple(rounds(task))
        requests = dict.fromkeys(request for round_ in planned for request in round_.requests(modes))
        return cls(task, requests, planned)

    def rounds(self) -> Rounds:
        """Yield the rounds: as planned, or anew by the strategy if they depend on captures."""
        planned = self.planned or ()
        adapts = any(viewpoint.keep for round_ in planned for viewpoint in round_.viewpoints)
        if self.planned is None or adapts or self.task.aim is not None:
            yield from rounds(self.task)
        else:
            for round_ in planned:  # noqa: UP028 - a tuple takes nothing that is sent
                yield round_

    def available(self) -> bool:
        """Return whether the source can deliver the views."""
        return self.task.available([request.view for request in self.requests])


def share_captures(tasks: Sequence[Task], modes: Sequence[str]) -> list[Plan]:
    """Return plans for several cameras at one moment, which share captures.

    Args:
        tasks: in any order; of one source.
        modes: of the captures.

    Raises:
        ArgumentError: the source cannot do what a task's strategy needs.
    """
    plans = [Plan(task) for task in tasks]
    for group in _groups(tasks):
        center_w = tasks[group[0]].pose.position
        at_center = [replace(tasks[i], pose=Pose(center_w, tasks[i].pose.rotation)) for i in group]
        for i, plan in zip(group, _cheapest(at_center, modes), strict=True):
            plans[i] = plan
    return plans


def _groups(tasks: Sequence[Task]) -> list[list[int]]:
    """Return the tasks, by index, whose cameras share an optical centre, several each.

    Central cameras are apart from others, which are captured from elsewhere.
    """
    groups: list[list[int]] = []
    for i, task in enumerate(tasks):
        for group in groups:
            first = tasks[group[0]]
            apart = np.abs(first.pose.position - task.pose.position).max()
            alike = first.rays.camera.central == task.rays.camera.central and first.state == task.state
            if apart < SAME_M and alike:
                group.append(i)
                break
        else:
            groups.append([i])
    return [group for group in groups if len(group) > 1]


def _cheapest(tasks: list[Task], modes: Sequence[str]) -> list[Plan]:
    """Return plans of tasks at one centre: each its own, or faces of one cube map, whichever takes less."""
    if not tasks[0].rays.camera.central:
        return [Plan.make(task, modes) for task in tasks]
    # Planned as if captures were new, as when the recording was made; not by the views that it lacks.
    new = [task if task.recorded is None else replace(task, recorded=None) for task in tasks]
    plans = _cheapest_new(new, modes)
    if tasks[0].recorded is None:
        return plans
    replayed = [
        Plan.make(replace(task, options=plan.task.options, shared=plan.task.shared), modes)
        for task, plan in zip(tasks, plans, strict=True)
    ]
    if all(plan.available() for plan in replayed):
        return replayed
    return [Plan.make(task, modes) for task in tasks]


def _cheapest_new(tasks: list[Task], modes: Sequence[str]) -> list[Plan]:
    best = own = [Plan.make(task, modes) for task in tasks]
    least = _work(own)
    # A narrow camera that one view holds may need finer faces than all others.
    wide = [len({request.view for request in plan.requests}) > 1 for plan in own]
    for sharing in dict.fromkeys(((True,) * len(tasks), tuple(wide))):
        if sum(sharing) > 1:
            edge = max(task.edge for task, shares in zip(tasks, sharing, strict=True) if shares)
            plans = list(own)
            for i, task in enumerate(tasks):
                if sharing[i]:
                    options = replace(task.options, face_size=edge)
                    plans[i] = Plan.make(replace(task, options=options, shared=True), modes)
            if (work := _work(plans)) < least:
                best, least = plans, work
    return best


def _work(plans: Sequence[Plan]) -> float:
    """Return what the distinct requests of plans cost a source, in requests."""
    views = [request.view for request in {request: None for plan in plans for request in plan.requests}]
    return len(views) + pixels_of(views) / PIXELS_PER_REQUEST


@dataclass(frozen=True)
class Cost:
    """Captures and time of images: an estimate for a furnished room where they depend on what is captured.

    Attributes:
        way: the strategy's name, or an accuracy such as ``1 %``.
        requests: captures.
        pixels: captured, over all modes.
        seconds: by the price of captures.
        marked: the largest share of an image's pixels that it is expected to mark as inexact or unsure; 1
            where the options have optical centres shared, which nothing is known of.
    """

    way: str
    requests: int
    pixels: int
    seconds: float
    marked: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        """Return the cost of two sets of images that share no captures."""
        return Cost(
            self.way,
            self.requests + other.requests,
            self.pixels + other.pixels,
            self.seconds + other.seconds,
            max(self.marked, other.marked),
        )


def cost(way: str, frames: Iterable[Sequence[Task]], modes: Sequence[str], **changes: Any) -> Cost:
    """Return the cost of images whose views are captured once each.

    Args:
        way: its name.
        frames: for each moment its tasks, which share captures. Those that hardly do so with other moments
            are planned at a few of the poses, and counted for all.
        modes: of the captures.
        changes: of the options of the tasks.

    Raises:
        ArgumentError: the source cannot do what the strategy needs.
    """
    total, price = Cost(way, 0, 0, 0.0), Price(0, 0)
    shared: dict[Request, None] = {}
    apart: dict[ImageRays, dict[tuple[Any, ...], Task]] = defaultdict(dict)
    for tasks in frames:
        changed = [replace(t, options=replace(t.options, **changes), modes=tuple(modes)) for t in tasks]
        price = Price(*changed[0].options.capture_ms)
        for plan in share_captures([task for task in changed if not _is_apart(task)], modes):
            shared |= plan.requests or Plan.make(plan.task, modes).requests
            total = replace(total, marked=max(total.marked, _MARKED))
        for task in filter(_is_apart, changed):
            pose = task.pose.position.tobytes(), task.pose.rotation.tobytes()
            apart[task.rays][*pose, task.state] = task
    for of_camera in apart.values():
        some = list(of_camera.values())[:: math.ceil(len(of_camera) / _PLANNED_POSES)]
        alone = reduce(add, (_cost_alone(task, way, modes) for task in some))
        times = len(of_camera) / len(some)
        total += replace(alone, requests=round(times * alone.requests), pixels=round(times * alone.pixels))
    total += Cost(way, len(shared), pixels_of(request.view for request in shared), 0.0)
    return replace(total, seconds=price.of(total.requests, total.pixels) / 1e3)


def _is_apart(task: Task) -> bool:
    """Return whether a task hardly shares captures with those at other poses."""
    return task.aim is not None or not task.rays.camera.central


def _cost_alone(task: Task, way: str, modes: Sequence[str]) -> Cost:
    if task.aim is not None:
        return Cost(way, *_refinement(task).expected(), 0.0, task.aim)
    requests = Plan.make(task, modes).requests
    known = task.rays.one_center or task.options.viewpoints is None
    return Cost(
        way, len(requests), pixels_of(request.view for request in requests), 0.0, _MARKED if known else 1.0
    )
