"""Exact truth of an image by tracing: what the ray of each pixel meets."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.geometry import Pose

if TYPE_CHECKING:
    from mock_server import Scene


class Tracer(Protocol):
    """A scene of the mock server, or a source that traces (:meth:`omniscv.sources.Source.trace`)."""

    def trace(self, origins: Any, directions: Any, /) -> Any: ...


def traced(scene: Tracer, camera: Camera, pose: Pose) -> Any:
    """Return what the ray of each pixel meets: distance, label and normal of shape (H, W).

    Pixels without a ray meet nothing.

    Args:
        scene: that is traced.
        camera: whose rays are traced.
        pose: of the camera.
    """
    rays = camera.unproject()
    return scene.trace(pose.to_world(rays.origins), rays.directions @ pose.rotation.T)


def traced_mean(scene: Scene, camera: Camera, pose: Pose, across: int = 4) -> NDArray[np.float64]:
    """Return the mean colour of each pixel's rays, (H, W, 3); NaN if invalid.

    Args:
        scene: that is traced.
        camera: whose rays are traced.
        pose: of the camera.
        across: rays of a pixel in each direction.
    """
    total = np.zeros((camera.height, camera.width, 3))
    offsets = (np.arange(across) + 0.5) / across - 0.5
    for dv, du in product(offsets, offsets):
        rays = camera.unproject(camera.pixels() + np.array([du, dv]))
        hits = scene.trace(pose.to_world(rays.origins), rays.directions @ pose.rotation.T)
        total += np.where(rays.valid[..., None], hits.color, np.nan)
    return np.asarray(total / across**2)
