"""Faces of noise, and the map that an image samples them by."""

from collections.abc import Iterable, Iterator

import numpy as np

from omniscv import RenderOptions
from omniscv.compose.atlas import FILTER_SUPPORT_PX, Atlas
from omniscv.depth.ray_lookup import look_up
from omniscv.geometry import Pose
from omniscv.planning import ImageRays, Plan
from omniscv.sources import Capabilities, Capture, ObjectTable, Request, Source, View


class Noise(Source):
    """Faces of noise at a depth of 3 m, made once for each size: they take no time."""

    capabilities = Capabilities()

    def __init__(self) -> None:
        self._faces: dict[int, np.ndarray] = {}

    def face(self, edge: int) -> np.ndarray:
        """Return (edge, edge, 3) noise, uint8."""
        if edge not in self._faces:
            self._faces[edge] = np.random.default_rng(1).integers(0, 256, (edge, edge, 3), dtype=np.uint8)
        return self._faces[edge]

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for request in requests:
            edge = request.view.width
            depth = request.mode == "depth"
            yield Capture(request, request.view, np.full((edge, edge), 3.0) if depth else self.face(edge))

    def objects(self) -> ObjectTable:
        return ObjectTable({})


def made_map(rays: ImageRays, pose: Pose, face_size: int) -> tuple[list[View], Atlas, np.ndarray, np.ndarray]:
    """Return views, an atlas, and where an image samples its picture: what a renderer keeps for bilinear."""
    plan = Plan(rays, pose, Noise.capabilities, RenderOptions("cube", face_size=face_size))
    views = next(plan.rounds()).viewpoints[0].views
    lookup = look_up(rays.directions.reshape(-1, 3), views, pose.R_w_c)
    atlas = Atlas(views, range(1), FILTER_SUPPORT_PX if lookup.margin < FILTER_SUPPORT_PX else 0)
    return views, atlas, *atlas.coordinates(lookup)
