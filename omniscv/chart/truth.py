"""Truth: a source that traces in this process, and what every pixel's own ray meets."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mock_server import Hits, Scene
from mock_server.render import pinhole_rays
from omniscv.cameras import Camera
from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.view import Capture, Request, View
from omniscv.geometry import Pose


def mask_color(label: Any) -> NDArray[np.uint8]:
    """(..., 3) a colour of its own for each label; the sky is black."""
    label = np.asarray(label, dtype=np.uint32)
    return np.stack([label * 37 % 256, label * 101 % 256, label % 256], axis=-1).astype(np.uint8)


class TracedSource(Source):
    """Captures by exact tracing, without a server, an encoding or half floats. Keeps what it made.

    Args:
        scene: what is there.
        capabilities: what it pretends to be able to do; everything if not given.
        lit: dtype of colours: float32 0..1, or uint8.

    Attributes:
        made: how many views were traced.
    """

    def __init__(
        self, scene: Scene, capabilities: Capabilities | None = None, lit: DTypeLike = np.float32
    ) -> None:
        self.scene, self.made = scene, 0
        self._lit, self._capabilities = np.dtype(lit), capabilities or Capabilities()
        self._kept: dict[View, dict[str, NDArray[Any]]] = {}

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def objects(self) -> ObjectTable:
        colors = {name: mask_color(self.scene.label(name)).tolist() for name in self.scene.objects}
        return ObjectTable({name: (r, g, b) for name, (r, g, b) in colors.items()})

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for request in requests:
            if request.view not in self._kept:
                self._kept[request.view] = self._trace(request.view)
                self.made += 1
            yield Capture(request, request.view, self._kept[request.view][request.mode], b"", "npy")

    def _trace(self, view: View) -> dict[str, NDArray[Any]]:
        rays, length = pinhole_rays(view.pose.R_w_c, view.fov_deg, view.width, view.height)
        hits = self.scene.trace(view.pose.t_w_c, rays)
        lit = hits.color if self._lit.kind == "f" else np.round(255 * np.clip(hits.color, 0, 1))
        return {
            "lit": lit.astype(self._lit),
            "object_mask": mask_color(hits.label),
            "depth": (hits.distance / length).astype(np.float32),
            "normal": hits.normal.astype(np.float32),
        }


def traced(scene: Scene, camera: Camera, pose: Pose) -> Hits:
    """What each pixel's own ray meets: Hits of shape (H, W); pixels without a ray meet nothing."""
    rays = camera.unproject()
    return scene.trace(pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)


def traced_mean(scene: Scene, camera: Camera, pose: Pose, across: int = 4) -> NDArray[np.float64]:
    """(H, W, 3) the colour of each pixel as the mean over ``across`` x ``across`` rays; NaN outside."""
    total = np.zeros((camera.height, camera.width, 3))
    parts = (np.arange(across) + 0.5) / across - 0.5
    for dv in parts:
        for du in parts:
            rays = camera.unproject(camera.pixels() + np.array([du, dv]))
            hits = scene.trace(pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)
            total += np.where(rays.valid[..., None], hits.color, np.nan)
    return np.asarray(total / across**2)
