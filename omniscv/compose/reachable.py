"""Whether an optical centre is in the open, as seen from where the camera is.

A non-central camera's centres lie up to metres from its position: in a small room some are beyond a wall or
inside a cupboard. Engines render those as if nothing were wrong. So a few small depth pictures are taken at
the camera's own position, and centres that lie behind what those show are told.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omniscv.captures.view import Capture
from omniscv.compose.march import Shell, distances, shell
from omniscv.geometry import Array
from omniscv.plan import Plan

_SLACK = 1.01
"""A centre as far as a wall is on it, and between two pixels a wall may be a little nearer."""


def look_around(plan: Plan, captures: dict[str, list[Capture]]) -> Shell:
    """What the plan's probe saw from the camera's position."""
    faces = captures["depth"]
    views = tuple(capture.view for capture in faces)
    return shell(plan.pose.t_w_c, views, [capture.pixels for capture in faces])


def reachable(around: Shell, points_w: Array) -> NDArray[np.bool_]:
    """(N,) whether points (N, 3), world frame, are in the open: nothing stands between."""
    toward = points_w - around.center_w
    away = np.linalg.norm(toward, axis=-1)
    return np.asarray((away == 0) | (away <= distances(around, toward) * _SLACK))
