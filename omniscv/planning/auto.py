"""The cheapest exact strategy that the source can do."""

from omniscv.planning.base import Task, Viewpoint
from omniscv.planning.depth_marching import DepthShell
from omniscv.planning.exact import Exact, cheapest_viewpoints, face_viewpoints
from omniscv.planning.viewpoints import Groups


class Auto(Exact):
    """The cheapest that the source can do: ``strips`` if there are several optical centres, else ``faces``.

    Also ``faces`` where the source cannot set size and field of view, or is a recording without the strips.
    """

    name = "auto"

    def viewpoints(self, task: Task, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        chosen = cheapest_viewpoints if len(groups) > 1 else face_viewpoints
        return chosen(task, groups, around)
