"""One view for all rays of an optical centre: what a narrow camera needs."""

from dataclasses import replace

from omniscv.geometry import Pose, pinhole
from omniscv.planning import densities
from omniscv.planning.base import Task, Viewpoint
from omniscv.planning.cube_faces import FACE_BORDER_PX
from omniscv.planning.strip_views import STEEPEST, holding_size
from omniscv.planning.viewpoints import RayGroup
from omniscv.sources.base import View

_NARROWEST = 1e-12  # tangent: a view of a single ray


def single_viewpoint(task: Task, group: RayGroup) -> Viewpoint | None:
    """Return the viewpoint of all of a camera's pixels with one view, turned and narrowed to their rays.

    None where no view holds them, and where the source cannot set size and field of view, or is a
    recording without the view.
    """
    R_c_v, half, focal_px = task.rays.frame
    if not task.sets_views or half.max() > STEEPEST:
        return None
    if task.options.face_size != "auto":
        focal_px = task.edge / 2
    focal_px = min(focal_px, densities.LARGEST / 2 / max(half.max(), _NARROWEST))
    pose = Pose(task.pose.to_world(group.center_c), task.pose.R_w_c @ R_c_v)
    # A recording may have been made of a source that captures no view higher than wide.
    for capabilities in (task.capabilities, replace(task.capabilities, can_set_tall=False)):
        size = holding_size(half, focal_px, task.border(FACE_BORDER_PX), capabilities)
        view = View(pose, pinhole.fov_deg(size[0], focal_px), *size)
        if task.available((view,)):
            return Viewpoint(pose.t_w_c, (view,), group.pixels)
    return None
