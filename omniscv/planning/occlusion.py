"""Whether an optical centre is visible from the camera's position.

A non-central camera's centres lie up to metres from its position: in a small room some are beyond a wall
or inside a cupboard. Engines render from there, too. So small depth pictures are captured at the
camera's position, and the pixels of centres behind their surfaces are flagged.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.planning.cube_faces import ALL_FACES, CubeFaces
from omniscv.planning.depth_shell import DepthShell, depth_shell, distances
from omniscv.planning.rays import Groups
from omniscv.planning.rounds import Kept, Round, Viewpoint
from omniscv.planning.strategy import Task

_EDGE_PX = 64
"""px of a face that shows where optical centres are occluded."""


def capture_around(
    task: Task, groups: Groups, shared: bool = False
) -> Generator[Round, Kept | None, DepthShell | None]:
    """Yield a round of depth pictures at the camera's position, and return the captured depth.

    They are small where each pixel is captured from its own optical centre. Where pixels share centres, they
    also show what rays meet, and are as fine as the image needs; a recording may only have those of another
    size. None where every ray starts at one centre, where a recording has no such pictures, and where nothing
    is captured.
    """
    if len(groups) < 2 and (task.rays.origins is None or len(task.rays.own_viewpoints.centers) < 2):
        return None
    center_w = task.pose.t_w_c
    fine, small = max(task.edge, _EDGE_PX), _EDGE_PX
    edges = [small] if task.options.viewpoints is None else [fine, small] if shared else [small, fine]
    sizes = [CubeFaces(task, edge, 0).views(center_w, ALL_FACES) for edge in edges]
    available = [views for views in sizes if task.available(views)]
    if not available:
        return None
    views = available[0]
    kept = yield Round((Viewpoint(center_w, views, np.zeros(0, np.int64), modes=("depth",), keep=True),))
    return None if kept is None else depth_shell(center_w, kept[0]["depth"])


class Occlusion(NamedTuple):
    """Whether points are visible from the camera's position. Points near an edge may be neither.

    Attributes:
        visible, occluded: (N,) bool.
    """

    visible: Mask
    occluded: Mask

    @classmethod
    def of(cls, around: DepthShell, points_w: Array) -> Occlusion:
        """Compare points (N, 3), world frame, with the depth around the camera."""
        toward = points_w - around.center_w
        away = np.linalg.norm(toward, axis=-1)
        least, most = distances(around, toward)
        return cls((away == 0) | (away < least), (away > 0) & (away > most))
