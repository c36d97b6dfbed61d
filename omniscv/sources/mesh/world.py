"""A mesh at an instant: objects moved and hidden, what rays meet, and the colours there."""

import threading
from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array, Pose
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.sources.base import Traced
from omniscv.sources.mesh.materials import Palette, Skin, codes_of_light, palette, shades
from omniscv.sources.mesh.model import Model
from omniscv.sources.mesh.settings import Settings
from omniscv.sources.mesh.tracing import Hits, JoinedTracers, Tracer

_AMBIENT = 0.25
"""Share of the light that surfaces get that the lamp does not reach."""
_SHADOW_M = 1e-6
"""Shadows begin so far from a surface, as a part of the lamp's distance."""


class Resting(NamedTuple):
    """What all instants of a mesh share.

    Attributes:
        model: the mesh as its file describes it.
        settings: how it is shown.
        palette: its materials.
        one_sided: (M,) whether rays pass a face from behind.
        has_holes: (M,) whether a face has holes by alpha.
        lit_faces: (M,) whether the lamp changes a face's colour.
    """

    model: Model
    settings: Settings
    palette: Palette
    one_sided: NDArray[np.bool_]
    has_holes: NDArray[np.bool_]
    lit_faces: NDArray[np.bool_]

    @classmethod
    def of(cls, model: Model, settings: Settings) -> "Resting":
        """Return what instants of a mesh share."""
        materials = palette(model.materials, settings.alpha == "cut")
        one_sided = np.array([not material.double_sided for material in model.materials])
        lit = np.array([not material.unlit for material in model.materials])
        kind = model.material
        return cls(model, settings, materials, one_sided[kind], materials.cutoff[kind] > 0, lit[kind])


class Part(NamedTuple):
    """Some faces of a mesh that rays can be traced through, and their numbers."""

    tracer: Tracer
    faces: NDArray[np.int32]


def part_of(resting: Resting, vertices: Array, names: Collection[str]) -> Part | None:
    """Return the faces of some objects, with vertices (N, 3) where they are; None for no faces."""
    model = resting.model
    labels = [1 + model.names.index(name) for name in names]
    rows = np.flatnonzero(np.isin(model.label, labels)).astype(np.int32)
    if not len(rows):
        return None
    return Part(Tracer(vertices, model.faces[rows], resting.one_sided[rows]), rows)


class MeshWorld:
    """A mesh with some objects moved and some hidden.

    Args:
        resting: the mesh as its file describes it.
        poses: of the objects that are moved; at rest an object's pose is the middle of its box, not turned.
        hidden: names of the objects that are left out.
        unmoved: returns the mesh at rest without some objects.
    """

    def __init__(
        self,
        resting: Resting,
        poses: Mapping[str, Pose],
        hidden: Collection[str],
        unmoved: Callable[[frozenset[str]], Part | None],
    ) -> None:
        model = resting.model
        self._resting = resting
        self._poses = poses
        self._hidden = frozenset(hidden)
        self._unmoved = unmoved
        self._lock = threading.Lock()
        vertices = model.vertices
        if poses:
            vertices = vertices.copy()
        for name, pose in poses.items():
            rows = rows_of(model, name)
            vertices[rows] = (vertices[rows] - middle(model, name)) @ pose.rotation.T + pose.position
        self._vertices = vertices

    @property
    def _tracer(self) -> JoinedTracers | None:
        """The faces that are shown; None where all are hidden."""
        with self._lock:
            return self._joined

    @cached_property
    def _joined(self) -> JoinedTracers | None:
        """What rests, which instants share, and what is moved, made for the first ray."""
        moved = self._poses.keys() - self._hidden
        parts = [self._unmoved(self._hidden | moved)]
        if moved:
            parts.append(part_of(self._resting, self._vertices, moved))
        shown = [part for part in parts if part is not None]
        if not shown:
            return None
        count = len(self._resting.model.faces)
        return JoinedTracers([part.tracer for part in shown], [part.faces for part in shown], count)

    @cached_property
    def _skin(self) -> Skin:
        model = self._resting.model
        return Skin(model.faces, model.material, model.uv, model.colors)

    def hits(self, origins_w: Array, directions_w: Array) -> Hits:
        """Return what rays meet first, past holes; ``face`` counts the model's faces.

        Args:
            origins_w: (N, 3) metres, world frame; or (3,), of all rays.
            directions_w: (N, 3) unit vectors, world frame.
        """
        tracer = self._tracer
        if tracer is None:
            count = len(directions_w)
            return Hits(np.full(count, np.inf), np.full(count, -1, np.int32), np.zeros((count, 2)))
        hits = tracer.trace(origins_w, directions_w)
        if self._resting.has_holes.any():
            self._pass_holes(tracer, np.broadcast_to(origins_w, directions_w.shape), directions_w, hits)
        return hits

    def _pass_holes(self, tracer: JoinedTracers, origins_w: Array, directions_w: Array, hits: Hits) -> None:
        """Replace hits at holes by what lies behind them, in place."""
        rows = np.flatnonzero(self._in_holes(hits))
        while len(rows):
            met = Hits(hits.distance[rows], hits.face[rows], hits.weights[rows])
            following = tracer.beyond(origins_w[rows], directions_w[rows], met)
            hits.distance[rows] = following.distance
            hits.face[rows] = following.face
            hits.weights[rows] = following.weights
            rows = rows[self._in_holes(following)]

    def _in_holes(self, hits: Hits) -> NDArray[np.bool_]:
        """Return (N,) whether what rays met has a hole there."""
        resting = self._resting
        result = np.zeros(len(hits.face), np.bool_)
        rows = np.flatnonzero((hits.face >= 0) & resting.has_holes.take(hits.face, mode="clip"))
        if len(rows):
            own = np.ascontiguousarray(hits.face[rows])
            alpha = shades(resting.palette, self._skin, own, hits.weights[rows])[:, 3]
            result[rows] = alpha < resting.palette.cutoff[resting.model.material[own]]
        return result

    def traced(self, origins_w: Array, directions_w: Array) -> Traced:
        """Return what rays meet; arguments as of :meth:`hits`."""
        hits = self.hits(origins_w, directions_w)
        return Traced(hits.distance, self.labels(hits), self.normals(hits, directions_w))

    def labels(self, hits: Hits) -> NDArray[np.uint16]:
        """Return (N,) the labels of the objects that were met, 0 for none."""
        label = self._resting.model.label.take(hits.face, mode="clip")
        label[hits.face < 0] = 0
        return label

    def normals(self, hits: Hits, directions_w: Array) -> Array:
        """Return (N, 3) unit normals of the faces that were met, towards the rays; 0 for none."""
        faces = self._resting.model.faces.take(hits.face, axis=0, mode="clip")
        a = self._vertices[faces[:, 0]]
        normal = np.cross(self._vertices[faces[:, 1]] - a, self._vertices[faces[:, 2]] - a)
        along = np.einsum("ij,ij->i", normal, directions_w)
        length = np.sqrt(np.einsum("ij,ij->i", normal, normal))
        scale = np.where(along > 0, -1.0, 1.0) / np.where(length > 0, length, 1)
        scale[hits.face < 0] = 0
        return normal * scale[:, None] + 0.0  # + 0.0: no negative zero

    def colors(self, origins_w: Array, directions_w: Array, hits: Hits) -> NDArray[np.float32]:
        """Return (N, 3) sRGB codes / 255 of what rays met; black where they met nothing."""
        resting = self._resting
        light = shades(resting.palette, self._skin, hits.face, hits.weights)[:, :3]
        if resting.settings.lamp is not None:
            light *= self._lamp_light(origins_w, directions_w, hits)[:, None]
        return codes_of_light(light)

    def _lamp_light(self, origins_w: Array, directions_w: Array, hits: Hits) -> NDArray[np.float32]:
        """Return (N,) the share of its colour that a surface shows: Lambert's cosine, shadows, ambient."""
        resting = self._resting
        result = np.ones(len(hits.face), np.float32)
        met = hits.face >= 0
        rows = np.flatnonzero(met & resting.lit_faces.take(hits.face, mode="clip"))
        directions = directions_w[rows]
        origins = np.broadcast_to(origins_w, directions_w.shape)[rows]
        points = origins + hits.distance[rows, None] * directions
        own = Hits(hits.distance[rows], hits.face[rows], hits.weights[rows])
        normals = self.normals(own, directions)
        toward = np.asarray(resting.settings.lamp) - points
        distance = np.linalg.norm(toward, axis=1)
        toward /= np.maximum(distance, 1e-300)[:, None]
        cosine = np.einsum("ij,ij->i", normals, toward)
        lamp_sees = cosine > 0
        front = np.flatnonzero(lamp_sees)
        starts = points[front] + (_SHADOW_M * distance[front])[:, None] * (normals[front] + toward[front])
        blocked = self.hits(starts, toward[front]).distance < distance[front] * (1 - 2 * _SHADOW_M)
        lamp_sees[front[blocked]] = False
        result[rows] = _AMBIENT + (1 - _AMBIENT) * np.where(lamp_sees, cosine, 0)
        return result

    def pose(self, name: str) -> Pose:
        """Return an object's pose: the middle of its box at rest, and how it is turned."""
        return self._poses.get(name) or Pose(middle(self._resting.model, name), np.eye(3))

    def vertices(self, name: str) -> Array:
        """Return the vertices (N, 3) of an object's faces, metres, world frame."""
        return self._vertices[rows_of(self._resting.model, name)]

    def box(self, name: str) -> ObjectBox:
        """Return the box around an object: along the world's axes at rest, and turned with the object."""
        low, high = bounds(self._resting.model, name)
        pose = self.pose(name)
        return ObjectBox.of(pose.position, pose.rotation.T, high - low, "vertices")


def rows_of(model: Model, name: str) -> NDArray[np.int64]:
    """Return the numbers of the vertices of an object's faces, sorted."""
    label = 1 + model.names.index(name)
    return np.unique(model.faces[model.label == label]).astype(np.int64)


def bounds(model: Model, name: str) -> tuple[Array, Array]:
    """Return the least and the greatest corner of an object at rest, (3,) metres each."""
    vertices = model.vertices[rows_of(model, name)]
    return vertices.min(axis=0), vertices.max(axis=0)


def middle(model: Model, name: str) -> Array:
    """Return the middle of an object's box at rest, (3,) metres."""
    low, high = bounds(model, name)
    return (low + high) / 2
