"""Whether an optical centre is visible from the camera's position.

A non-central camera's centres lie up to metres from its position: in a small room some are beyond a wall
or inside a cupboard. Engines render from there, too. So small depth pictures are captured at the
camera's position, and the pixels of centres behind their surfaces are flagged.
"""

from collections.abc import Generator

import numpy as np

from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.planning.cube_faces import ALL_FACES, CubeFaces
from omniscv.planning.ray_marching import DepthShell, depth_shell, distances
from omniscv.planning.rays import Groups, RayGroup
from omniscv.planning.rounds import Kept, Round, Viewpoint
from omniscv.planning.strategy import Task

_EDGE_PX = 64
"""px of a face."""

_SLACK = 1.01
"""A centre on a wall counts as visible, up to this multiple of the captured distance."""


def capture_around(task: Task, groups: Groups) -> Generator[Round, Kept | None, DepthShell | None]:
    """Yield a round of small depth pictures at the camera's position, and return the captured depth.

    None for a single centre, where a recording has no such pictures, and where nothing is captured.
    """
    if len(groups) < 2:
        return None
    center_w = task.pose.t_w_c
    views = CubeFaces(task, _EDGE_PX, 0).views(center_w, ALL_FACES)
    if not task.available(views):
        return None
    kept = yield Round((Viewpoint(center_w, views, np.zeros(0, np.int64), modes=("depth",), keep=True),))
    return None if kept is None else depth_shell(center_w, kept[0]["depth"])


def visible(around: DepthShell, points_w: Array) -> Mask:
    """Return (N,) bool, whether no surface lies between the shell's centre and points (N, 3), world frame."""
    toward = points_w - around.center_w
    away = np.linalg.norm(toward, axis=-1)
    return np.asarray((away == 0) | (away <= distances(around, toward) * _SLACK))


def occluded(around: DepthShell | None, center_w: Array, group: RayGroup) -> Mask | None:
    """Return (N,) bool, True for all pixels of a centre that is not visible; None where that is unknown."""
    if around is None:
        return None
    return np.full(len(group.pixels), not visible(around, center_w[None])[0])
