"""Narrow views that hold just the rays of each optical centre."""

from omniscv.errors import ArgumentError
from omniscv.planning.base import Rounds, Task, Viewpoint
from omniscv.planning.depth_shell import DepthShell
from omniscv.planning.exact import Exact, strip_viewpoints
from omniscv.planning.viewpoints import Groups


class Strips(Exact):
    """Capture views turned and narrowed to the rays of each centre; faces where rays fit none."""

    name = "strips"

    def viewpoints(self, task: Task, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        return strip_viewpoints(task, groups, around)

    def rounds(self, task: Task) -> Rounds:
        if not task.sets_views:
            raise ArgumentError(
                "strategy: strips need a source that can set size and field of view; use 'faces'"
            )
        return super().rounds(task)
