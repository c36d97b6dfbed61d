"""Only the faces that rays hit, at every optical centre."""

from omniscv.planning.base import Task, Viewpoint
from omniscv.planning.depth_shell import DepthShell
from omniscv.planning.exact import Exact, face_viewpoints
from omniscv.planning.viewpoints import Groups


class Faces(Exact):
    """Capture the faces of a cube map that the camera's rays hit."""

    name = "faces"

    def viewpoints(self, task: Task, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        return face_viewpoints(task, groups, around)
