"""Several cameras at one moment: what they can share is captured once.

Central cameras at one optical centre share a cube map, made for the finest of them, where that takes less
than views of each one's own. Cameras of which each needs a narrow view of its own do not gain from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from omniscv.geometry import Pose
from omniscv.planning.base import Round, Task, drive
from omniscv.planning.registry import rounds
from omniscv.planning.strip_views import PIXELS_PER_REQUEST
from omniscv.sources.base import Request

_SAME_M = 1e-9
"""Optical centres nearer to each other than this are one."""

Wanted = dict[Request, None]


def together(tasks: Sequence[Task], modes: Sequence[str]) -> tuple[list[Task], list[Wanted]]:
    """Return the tasks of several cameras at one moment with options by which they share captures.

    Args:
        tasks: in any order; of one source.
        modes: what is captured.

    Returns:
        The tasks in their order, and what each of them needs as far as it does not depend on captured depth;
        nothing for a task that shares no optical centre.

    Raises:
        ArgumentError: the source cannot do what a task's strategy needs.
    """
    found, needed = list(tasks), [Wanted() for _ in tasks]
    for group in _groups(tasks):
        center_w = tasks[group[0]].pose.position
        mine = [replace(tasks[i], pose=Pose(center_w, tasks[i].pose.rotation)) for i in group]
        mine, wanted = _cheapest(mine, modes)
        for i, task, requests in zip(group, mine, wanted, strict=True):
            found[i], needed[i] = task, requests
    return found, needed


def _groups(tasks: Sequence[Task]) -> list[list[int]]:
    """The tasks, by index, whose cameras share an optical centre, several each; central ones apart from
    others, which are captured from elsewhere."""
    groups: list[list[int]] = []
    for i, task in enumerate(tasks):
        for group in groups:
            first = tasks[group[0]]
            apart = np.abs(first.pose.position - task.pose.position).max()
            alike = first.rays.camera.central == task.rays.camera.central and first.state == task.state
            if apart < _SAME_M and alike:
                group.append(i)
                break
        else:
            groups.append([i])
    return [group for group in groups if len(group) > 1]


def _cheapest(tasks: list[Task], modes: Sequence[str]) -> tuple[list[Task], list[Wanted]]:
    """Tasks at one centre, as they are or with the faces of one cube map, whichever takes less; what each
    of them needs."""
    shared = tasks
    if tasks[0].rays.camera.central:
        # As if captures were new: else what a recording lacks would decide, and not as when it was made.
        shared = _with_one_cube(tasks, _sharing([replace(task, recorded=None) for task in tasks], modes))
    wanted = [_requests(task, modes) for task in shared]
    if shared is not tasks and not all(map(_available, shared, wanted)):
        return tasks, [_requests(task, modes) for task in tasks]
    return shared, wanted


def _sharing(tasks: Sequence[Task], modes: Sequence[str]) -> list[bool]:
    """Which of the tasks at one centre share a cube map."""
    own = [_requests(task, modes) for task in tasks]
    # A narrow camera that one view holds may need finer faces than all others.
    wide = [len({request.view for request in each}) > 1 for each in own]
    best, least = [False] * len(tasks), _work(own)
    for sharing in ([True] * len(tasks), wide):
        if sum(sharing) > 1:
            work = _work([_requests(task, modes) for task in _with_one_cube(tasks, sharing)])
            if work < least:
                best, least = sharing, work
    return best


def _available(task: Task, wanted: Wanted) -> bool:
    return task.available([request.view for request in wanted])


def _with_one_cube(tasks: Sequence[Task], sharing: Sequence[bool]) -> list[Task]:
    """The tasks, with options by which some of them take the faces of one cube map."""
    edge = max((task.edge for task, shares in zip(tasks, sharing, strict=True) if shares), default=0)
    found = list(tasks)
    for i, task in enumerate(tasks):
        if sharing[i]:
            strategy = "faces" if task.options.strategy == "auto" else task.options.strategy
            options = replace(task.options, strategy=strategy, face_size=edge)
            found[i] = replace(task, options=options)
    return found


def _requests(task: Task, modes: Sequence[str]) -> Wanted:
    """What a task needs, as far as that does not depend on what is captured."""
    found: Wanted = {}

    def plan(round_: Round) -> None:
        found.update(dict.fromkeys(round_.requests(modes)))

    drive(rounds(task), plan)
    return found


def _work(wanted: Sequence[Wanted]) -> float:
    """What distinct requests cost a source, in requests."""
    views = [request.view for request in {request: None for each in wanted for request in each}]
    return len(views) + sum(view.width * view.height for view in views) / PIXELS_PER_REQUEST
