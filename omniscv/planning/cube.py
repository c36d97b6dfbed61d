"""Six faces at every optical centre, as in the paper."""

from omniscv.planning.base import Task, Viewpoint
from omniscv.planning.depth_shell import DepthShell
from omniscv.planning.exact import Exact, face_viewpoints
from omniscv.planning.viewpoints import Groups


class Cube(Exact):
    """Capture whole cube maps, as in the paper: one set serves every camera at the same centres."""

    name = "cube"

    def viewpoints(self, task: Task, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        return face_viewpoints(task, groups, around, whole=True)
