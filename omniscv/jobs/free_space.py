"""Free space in a scene, found by looking: nothing is known of a scene but its depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import number, numbers
from omniscv.cameras import create
from omniscv.compose.renderer import Renderer
from omniscv.geometry import Array, Pose
from omniscv.planning import RenderOptions
from omniscv.sources.base import Source

_WIDTH = 256
_FACE_PX = 128
_NEAREST_LOOKS = 8


class _Look(NamedTuple):
    """A panorama of depth: (3,) where from, world frame, and (H, W) metres."""

    position_w: Array
    depth: NDArray[np.float32]


class FreeSpace:
    """The places of a scene that are at least a distance away from every surface.

    A place counts as free if it is seen from a place that is known to be free, and if no surface seen from
    it is nearer than the clearance. So nothing inside a solid, below the floor or beyond a wall is found,
    and what is found does not depend on anything but the places that were asked about, in their order.
    Things narrower than 1/60 of the clearance may be missed.

    Args:
        source: of the scene; panoramas of depth are captured from it.
        start: (3,) metres, world frame: a place that is free.
        clearance: metres, from every surface.

    Raises:
        ArgumentError: a place or distance that is none.
    """

    def __init__(self, source: Source, start: ArrayLike, clearance: float) -> None:
        self.clearance = number("clearance", clearance, above=0)
        self._renderer = Renderer(source)
        self._camera = create("equirectangular", width=_WIDTH, height=_WIDTH // 2)
        self._looks = [self._look(numbers("start", start, (3,)))]

    def holds(self, position_w: Array) -> bool:
        """Return whether a place (3,), metres, world frame, is free.

        Raises:
            SourceError, RecordingError: its depth cannot be captured.
        """
        away = [float(np.linalg.norm(position_w - look.position_w)) for look in self._looks]
        order = np.argsort(away, kind="stable")[:_NEAREST_LOOKS]
        if not any(self._sees(self._looks[i], position_w, away[i]) for i in order):
            return False
        look = self._look(position_w)
        if look.depth.min() < self.clearance:
            return False
        self._looks.append(look)
        return True

    def _look(self, position_w: Array) -> _Look:
        options = RenderOptions(face_size=_FACE_PX)
        pose = Pose.from_angles(position_w)
        depth = self._renderer.render(self._camera, pose, ("depth",), options).depth
        assert depth is not None
        return _Look(position_w, depth)

    def _sees(self, look: _Look, position_w: Array, away: float) -> bool:
        """Whether the ways to a place, and its pixel's neighbours', are free."""
        if away == 0:
            return True
        point_c = Pose.from_angles(look.position_w).to_camera(position_w)
        (u, v), _ = self._camera.project(point_c)
        rows = np.clip(int(v) + np.arange(-1, 2), 0, self._camera.height - 1)
        columns = (int(u) + np.arange(-1, 2)) % self._camera.width
        return bool(look.depth[np.ix_(rows, columns)].min() > away)
