"""Truth: what every pixel's own ray meets, traced exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.geometry import Pose

if TYPE_CHECKING:
    from mock_server import Hits, Scene


def traced(scene: Scene, camera: Camera, pose: Pose) -> Hits:
    """Return what each pixel's own ray meets: Hits of shape (H, W); pixels without a ray meet nothing."""
    rays = camera.unproject()
    return scene.trace(pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)


def traced_mean(scene: Scene, camera: Camera, pose: Pose, across: int = 4) -> NDArray[np.float64]:
    """Return (H, W, 3) each pixel's colour as the mean over ``across`` x ``across`` rays; NaN outside."""
    total = np.zeros((camera.height, camera.width, 3))
    parts = (np.arange(across) + 0.5) / across - 0.5
    for dv in parts:
        for du in parts:
            rays = camera.unproject(camera.pixels() + np.array([du, dv]))
            hits = scene.trace(pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)
            total += np.where(rays.valid[..., None], hits.color, np.nan)
    return np.asarray(total / across**2)
