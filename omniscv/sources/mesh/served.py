"""A mesh behind the mock server: any UnrealCV client gets pictures of it.

:class:`MeshScene` has the methods of ``mock_server.Scene`` that a running world calls.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from mock_server.scene import Hits as SceneHits
from mock_server.scene import NotShownError, Poses, ViewHits
from omniscv.geometry import Array, Pose
from omniscv.sources.mesh.settings import Settings
from omniscv.sources.mesh.source import MeshSource
from omniscv.sources.mesh.world import MeshWorld


class MeshScene:
    """The mesh of a file as a scene of the mock server: each of its objects can be moved and hidden.

    Raises ArgumentError for a file that is no mesh, SourceError where embreex is not installed.
    """

    moving = ()
    static = frozenset[str]()
    time = 0.0
    room = None

    def __init__(self, path: Path, settings: Settings) -> None:
        self._source = MeshSource(path, settings)
        self._poses: dict[str, Pose] = {}
        self.name = path.stem
        table = self._source.objects()
        self.objects = tuple(table.names())
        self.colors = table.colors

    def label(self, name: str) -> int:
        """Return an object's label: 1 + its place in ``objects``."""
        return 1 + self.objects.index(name)

    def pose(self, name: str) -> tuple[Array, Array]:
        """Return how an object is turned, (3, 3), and the middle of its box, (3,) metres, world frame."""
        pose = self._world(()).pose(name)
        return pose.rotation, pose.position

    def bounds(self, name: str) -> tuple[Array, Array]:
        """Return the least and the greatest corner of an object's box, (3,) metres, world frame."""
        points = self.vertices(name)
        return points.min(axis=0), points.max(axis=0)

    def vertices(self, name: str) -> Array:
        """Return the vertices (N, 3) of an object, metres, world frame."""
        return self._world(()).vertices(name)

    def at(self, time_s: float, poses: Poses | None = None) -> Self:
        """Return the scene with some objects moved; nothing in it depends on ``time_s``.

        Args:
            time_s: seconds.
            poses: by object, its rotation (3, 3) and its position (3,).
        """
        moved = {}
        for name, (R_w_o, position) in (poses or {}).items():
            moved[name] = Pose(np.asarray(position, np.float64), np.asarray(R_w_o, np.float64))
        result = copy.copy(self)
        result._poses = {**self._poses, **moved}
        return result

    def scaled(self, name: str, factors: object) -> Self:
        """Raise NotShownError: the object ``name`` is not scaled by ``factors``."""
        raise NotShownError(f"expected objects as the mesh has them, got {name} with another scale")

    def joined(self, name: str, description: object) -> Self:
        """Raise NotShownError: an object ``name`` of a ``description`` is not in the mesh."""
        raise NotShownError(f"expected the objects of the mesh, got {name}")

    def trace(
        self, origins: ArrayLike, directions: ArrayLike, hidden: Iterable[str] = frozenset()
    ) -> SceneHits:
        """Return what rays meet, as ``mock_server.Scene.trace``.

        Args:
            origins: (..., 3) metres, world frame.
            directions: (..., 3), of any length but zero.
            hidden: names of objects to omit.
        """
        d = np.asarray(directions, np.float64)
        shape = np.broadcast_shapes(np.shape(origins), d.shape)
        rays = np.broadcast_to(d, shape).reshape(-1, 3)
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        starts = np.broadcast_to(np.asarray(origins, np.float64), shape).reshape(-1, 3)
        world = self._world(tuple(hidden))
        hits = world.hits(starts, rays)
        normals = world.normals(hits, rays).reshape(shape)

        def paint() -> Array:
            return world.colors(starts, rays, hits).astype(np.float64).reshape(shape)

        outer = shape[:-1]
        return SceneHits(world.labels(hits).reshape(outer), hits.distance.reshape(outer), normals, paint)

    def view(
        self,
        center: Array,
        rays: Array,
        length: Array,
        hidden: Iterable[str] = frozenset(),
        near_m: float = 0.0,
    ) -> ViewHits:
        """Return what a camera sees, as ``mock_server.Scene.view``.

        Args:
            center: (3,) the optical centre, metres, world frame.
            rays: (H, W, 3) unit directions, world frame.
            length: (H, W) of the rays per metre of depth.
            hidden: names of objects to omit.
            near_m: the least planar depth at which surfaces are seen, metres.
        """
        skipped = near_m * length
        hits = self.trace(center + skipped[..., None] * rays, rays, hidden)
        distance = hits.distance + skipped
        return ViewHits(hits.label, distance, hits.normal, hits.paint, distance / length)

    def _world(self, hidden: Collection[str]) -> MeshWorld:
        return self._source.world_with(self._poses, hidden)


def served(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a server with the mesh of a file in the place of its name."""
    return {**options, "scene": MeshScene(path, Settings())}
