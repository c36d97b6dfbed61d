"""The cheapest exact strategy that the source can do."""

from omniscv.planning.adaptive import Adaptive
from omniscv.planning.base import Rounds, Task, Viewpoint
from omniscv.planning.depth_shell import DepthShell
from omniscv.planning.exact import Exact, cheapest_viewpoints, face_viewpoints
from omniscv.planning.single_view import single_viewpoint
from omniscv.planning.viewpoints import Groups


class Auto(Exact):
    """``strips`` where there are several optical centres; at one, a single view if it holds all rays, else
    ``faces``.

    ``adaptive`` where nearly every pixel has an optical centre of its own.
    Also ``faces`` where the source cannot set size and field of view, or is a recording without those views.
    """

    name = "auto"

    def viewpoints(self, task: Task, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        if len(groups) > 1:
            return cheapest_viewpoints(task, groups, around)
        single = [found for group in groups if (found := single_viewpoint(task, group))]
        return tuple(single) or face_viewpoints(task, groups, around)

    def rounds(self, task: Task) -> Rounds:
        return Adaptive().rounds(task) if task.scattered else super().rounds(task)

    def further_views(self, task: Task) -> tuple[int, int]:
        return Adaptive().further_views(task) if task.scattered else (0, 0)
