"""A recording behind the mock server: any UnrealCV client gets the pictures that were recorded.

:class:`RecordedScene` has the methods of ``mock_server.Scene`` that a running world calls.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from mock_server import DIALECTS
from mock_server.scene import Hits, NotShownError, Poses, ViewHits
from omniscv.errors import RecordingError
from omniscv.geometry import Array, Pose
from omniscv.sources.base import Request, View
from omniscv.sources.recording import inspection
from omniscv.sources.recording.replay import RecordedSource

# positions, entries of rotations, fields of view
_SAME_M = 1e-3
_SAME = 1e-3
_SAME_DEG = 1e-3


class RecordedScene:
    """The scene of a recording, RecordingError if it cannot be read. Nothing in it can be moved or hidden."""

    moving = ()
    time = 0.0
    room = None

    def __init__(self, path: Path) -> None:
        self._source = RecordedSource(path)
        self._path = path
        self.name = self._source.scene_identity.name or path.stem
        table = self._source.objects()
        self.objects = tuple(table.names())
        self.colors = table.colors
        self.static = frozenset(self.objects)
        self._boxes = self._source.geometry().boxes

    def settings(self) -> dict[str, Any]:
        """Return settings of a server as it was recorded: dialect, and the size and field of view of most
        views."""
        dialects = [name for name in inspection.info(self._path).dialects if name in DIALECTS]
        views = Counter((v.width, v.height, round(v.fov_deg, 6)) for v in self._source.recorded_views())
        (width, height, fov_deg), _ = views.most_common(1)[0]
        return {"dialect": (dialects or ["N3"])[0], "size": (width, height), "fov_deg": fov_deg}

    def label(self, name: str) -> int:
        return 1 + self.objects.index(name)

    def pose(self, name: str) -> tuple[Array, Array]:
        """Return the middle of an object's box, which is not turned; the origin where it has none."""
        low, high = self.bounds(name)
        return np.eye(3), (low + high) / 2

    def bounds(self, name: str) -> tuple[Array, Array]:
        points = self.vertices(name)
        return points.min(axis=0), points.max(axis=0)

    def vertices(self, name: str) -> Array:
        return self._boxes[name].corners_w() if name in self._boxes else np.zeros((8, 3))

    def at(self, time_s: float, poses: Poses | None = None) -> Self:
        return self

    def trace(self, origins: Any, directions: Any, hidden: Iterable[str] = frozenset()) -> Hits:
        raise NotShownError("expected pictures of the recording, got a ray")

    def joined(self, name: str, description: object) -> Self:
        raise NotShownError(f"expected the objects of the recording, got {name}")

    def scaled(self, name: str, factors: object) -> Self:
        raise NotShownError(f"expected objects as they were recorded, got {name} with another scale")

    def view(
        self,
        center: Array,
        rays: Array,
        length: Array,
        hidden: Iterable[str] = frozenset(),
        near_m: float = 0.0,
    ) -> ViewHits:
        """Return what was recorded of what ``mock_server.Scene.view`` traces, read when it is needed."""
        if hidden := sorted(hidden):
            raise NotShownError(f"expected all objects, as they were recorded, got {hidden[0]} hidden")
        (height, width) = length.shape
        points = rays * length[..., None]
        across = (points[0, -1] - points[0, 0]) / max(width - 1, 1)
        down = (points[-1, 0] - points[0, 0]) / max(height - 1, 1)
        x, y = (step / np.linalg.norm(step) for step in (across, down))
        fov_deg = 2 * np.degrees(np.arctan(np.linalg.norm(across) * width / 2))
        asked = View(Pose(center, np.stack([x, y, np.cross(x, y)], axis=1)), float(fov_deg), width, height)
        return cast(ViewHits, _RecordedView(asked, self._pixels, length))

    def _pixels(self, asked: View, mode: str) -> NDArray[Any]:
        """Return the pixels of a recorded view; NotShownError, with the nearest one, if there is none."""
        views = (view for view in self._source.recorded_in(mode) if _is_same(view, asked))
        request = Request(next(views, asked), mode, self._source.state)
        try:
            (capture,) = self._source.capture([request])
        except RecordingError as cause:
            raise NotShownError(str(cause)) from cause
        return np.asarray(capture.pixels)


class _RecordedView:
    """A recorded view in the place of ``mock_server.scene.ViewHits``: arrays by its names."""

    def __init__(self, asked: View, pixels: Callable[[View, str], NDArray[Any]], length: Array) -> None:
        self._asked = asked
        self._pixels = pixels
        self._length = length

    @cached_property
    def depth(self) -> Array:
        return self._pixels(self._asked, "depth").astype(np.float64)

    @property
    def distance(self) -> Array:
        return self.depth * self._length

    @cached_property
    def normal(self) -> Array:
        return self._pixels(self._asked, "normals").astype(np.float64)

    @cached_property
    def codes(self) -> NDArray[np.uint8]:
        lit = self._pixels(self._asked, "lit")
        return lit if lit.dtype == np.uint8 else np.round(255 * lit.clip(0, 1)).astype(np.uint8)

    @cached_property
    def mask(self) -> NDArray[np.uint8]:
        return self._pixels(self._asked, "object_mask")


def _is_same(view: View, asked: View) -> bool:
    """Return whether two views differ by no more than the digits of commands."""
    return (
        (view.width, view.height) == (asked.width, asked.height)
        and abs(view.fov_deg - asked.fov_deg) < _SAME_DEG
        and bool((np.abs(view.pose.position - asked.pose.position) < _SAME_M).all())
        and bool((np.abs(view.pose.R_w_c - asked.pose.R_w_c) < _SAME).all())
    )
