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
from omniscv.sources.recorded_views import Shape
from omniscv.sources.recording import inspection
from omniscv.sources.recording.replay import RecordedSource

# By how much two views may differ that count as one:
_SAME_M = 1e-3  # positions
_SAME = 1e-3  # entries of rotations
_SAME_DEG = 1e-3  # fields of view


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
        dialect = "N3"
        for name in inspection.info(self._path).dialects:
            if name in DIALECTS:
                dialect = name
                break
        shapes = Counter(map(Shape.of, self._source.recorded_views()))
        (width, height, fov_deg), _ = shapes.most_common(1)[0]
        return {"dialect": dialect, "size": (width, height), "fov_deg": fov_deg}

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
        """Return the scene as it is: what was recorded is the same at any ``time_s``, whatever ``poses``."""
        return self

    def trace(self, origins: Any, directions: Any, hidden: Iterable[str] = frozenset()) -> Hits:
        """Raise NotShownError: no rays are recorded, whatever ``origins``, ``directions`` and ``hidden``."""
        raise NotShownError("expected pictures of the recording, got a ray")

    def joined(self, name: str, description: object) -> Self:
        """Raise NotShownError: an object ``name`` of a ``description`` was not recorded."""
        raise NotShownError(f"expected the objects of the recording, got {name}")

    def scaled(self, name: str, factors: object) -> Self:
        """Raise NotShownError: the object ``name`` was not recorded scaled by ``factors``."""
        raise NotShownError(f"expected objects as they were recorded, got {name} with another scale")

    def view(
        self,
        center: Array,
        rays: Array,
        length: Array,
        hidden: Iterable[str] = frozenset(),
        near_m: float = 0.0,
    ) -> ViewHits:
        """Return what was recorded of what ``mock_server.Scene.view`` traces, read when it is needed.

        Args:
            center: (3,) the optical centre, metres, world frame.
            rays: (H, W, 3) unit directions, world frame.
            length: (H, W) of the rays per metre of depth.
            hidden: must be empty: NotShownError otherwise.
            near_m: without effect: what was recorded stays.
        """
        if hidden := sorted(hidden):
            raise NotShownError(f"expected all objects, as they were recorded, got {hidden[0]} hidden")
        height, width = length.shape
        points = rays * length[..., None]
        across = (points[0, -1] - points[0, 0]) / max(width - 1, 1)
        down = (points[-1, 0] - points[0, 0]) / max(height - 1, 1)
        x = across / np.linalg.norm(across)
        y = down / np.linalg.norm(down)
        R_w_c = np.stack([x, y, np.cross(x, y)], axis=1)
        fov_deg = 2 * np.degrees(np.arctan(np.linalg.norm(across) * width / 2))
        requested = View(Pose(center, R_w_c), float(fov_deg), width, height)
        return cast(ViewHits, _RecordedView(requested, self._pixels, length))

    def _pixels(self, requested: View, mode: str) -> NDArray[Any]:
        """Return the pixels of a recorded view; NotShownError, with the nearest one, if there is none."""
        recorded = requested
        for view in self._source.recorded_in(mode):
            if _is_same(view, requested):
                recorded = view
                break
        request = Request(recorded, mode, self._source.state)
        try:
            (capture,) = self._source.capture([request])
        except RecordingError as cause:
            raise NotShownError(str(cause)) from cause
        return np.asarray(capture.pixels)


class _RecordedView:
    """A recorded view in the place of ``mock_server.scene.ViewHits``: arrays by its names."""

    def __init__(self, view: View, pixels: Callable[[View, str], NDArray[Any]], length: Array) -> None:
        self._view = view
        self._pixels = pixels
        self._length = length

    @cached_property
    def depth(self) -> Array:
        return self._pixels(self._view, "depth").astype(np.float64)

    @property
    def distance(self) -> Array:
        return self.depth * self._length

    @cached_property
    def normal(self) -> Array:
        return self._pixels(self._view, "normals").astype(np.float64)

    @cached_property
    def codes(self) -> NDArray[np.uint8]:
        lit = self._pixels(self._view, "lit")
        return lit if lit.dtype == np.uint8 else np.round(255 * lit.clip(0, 1)).astype(np.uint8)

    @cached_property
    def mask(self) -> NDArray[np.uint8]:
        return self._pixels(self._view, "object_mask")


def _is_same(view: View, other: View) -> bool:
    """Return whether two views differ by no more than the digits of commands."""
    return (
        (view.width, view.height) == (other.width, other.height)
        and abs(view.fov_deg - other.fov_deg) < _SAME_DEG
        and bool((np.abs(view.pose.position - other.pose.position) < _SAME_M).all())
        and bool((np.abs(view.pose.R_w_c - other.pose.R_w_c) < _SAME).all())
    )
