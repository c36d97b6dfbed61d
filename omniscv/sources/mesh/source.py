"""Captures and rays of a mesh."""

from __future__ import annotations

import hashlib
import logging
import threading
from collections import OrderedDict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.records import read
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Traced,
    View,
    closed_error,
    copy_with,
)
from omniscv.sources.mesh.files import read_mesh
from omniscv.sources.mesh.model import Model, digest, open_edges
from omniscv.sources.mesh.settings import Settings
from omniscv.sources.mesh.tracing import Hits, require_embree
from omniscv.sources.mesh.world import MeshWorld, Part, Resting, part_of
from omniscv.sources.registry import split_address
from omniscv.sources.rendered import Rendered

LOGGER = logging.getLogger(__name__)

CAPABILITIES = Capabilities(
    frozenset(("lit", "object_mask", "depth", "normals")),
    dialect="mesh",
    transfer="srgb",
    near_m=0.001,
    varies=frozenset(("objects",)),
)
_KEPT_WORLDS = 2  # instants whose tracers are kept: some 300 bytes a triangle
_BLOCK = 1 << 16  # rays that are shaded together, so that arrays stay small


class MeshSource(Rendered):
    """Captures of one mesh, which several threads and instants share.

    Args:
        path: of its file.
        settings: how it is shown.

    Attributes:
        model: the mesh as its file describes it.
        holes: how many edges bound one triangle alone.
    """

    def __init__(self, path: Path, settings: Settings) -> None:
        require_embree()
        with within(str(path)):
            model = Model.of(read_mesh(path, settings.labels), settings)
            appearance = {option.name: getattr(settings, option.name) for option in fields(settings)}
            del appearance["traces"]  # no capture depends on it
            lamp = settings.lamp
            appearance["lamp"] = None if lamp is None else lamp.tolist()
            shown_as = repr(sorted(appearance.items()))
            content = hashlib.sha256((digest(model) + shown_as).encode()).hexdigest()[:16]
        self._path = path
        self._settings = settings
        self._name = path.stem
        self._identity = SceneIdentity(path.stem, content=content)
        self._objects = ObjectTable({}, ids={name: 1 + rank for rank, name in enumerate(model.names)})
        self._worlds = _Worlds(Resting.of(model, settings))
        self._colorless = model.colorless
        for what, count in sorted(model.notes.items()):
            _say_once(f"{path}: left out {count} {what}")
        self.model = model
        self.holes = open_edges(model)
        if self.holes:
            _say_once(
                f"{path}: not closed: {self.holes} edges bound one triangle alone; through holes is sky"
            )
        if model.colorless:
            _say_once(f"{path}: no colours: {model.colorless}")

    @property
    def capabilities(self) -> Capabilities:
        """Without colours where the file's pictures cannot be read."""
        traces = self._settings.traces
        modes = CAPABILITIES.modes - ({"lit"} if self._colorless else set())
        return replace(CAPABILITIES, modes=modes, traces=traces, shades=traces and not self._colorless)

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; a view is traced once for all modes that are requested in a row."""
        provenance = {"server": "in-process", "scene": self._name, "dialect": "mesh"}
        last: View | None = None
        pixels: dict[str, NDArray[Any]] = {}
        for request in requests:
            self._check_open()
            self._check(request)
            if request.view != last or request.mode not in pixels:
                pixels = self._pixels(request.view, colored=request.mode == "lit")
                last = request.view
            yield Capture(request, request.view, pixels[request.mode], provenance)

    def trace(self, origins_w: Array, directions_w: Array) -> Traced:
        """As :meth:`Source.trace`."""
        self._check_open()
        directions = np.asarray(directions_w, np.float64)
        shape = directions.shape[:-1]
        origins = _rows(origins_w, shape)
        hits = self._world().traced(origins, directions.reshape(-1, 3))
        return Traced(hits.distance.reshape(shape), hits.label.reshape(shape), hits.normal.reshape(*shape, 3))

    def shade(self, origins_w: Array, directions_w: Array) -> NDArray[np.float32]:
        """As :meth:`Source.shade`."""
        self._check_open()
        if self._colorless:
            raise ArgumentError(f"{self._path}: {self._colorless}")
        world = self._world()
        directions = np.asarray(directions_w, np.float64)
        origins = np.broadcast_to(origins_w, directions.shape)
        colors = np.empty(directions.shape, np.float32)
        for first in range(0, len(directions), _BLOCK):
            block = slice(first, first + _BLOCK)
            hits = world.hits(origins[block], directions[block])
            colors[block] = world.colors(origins[block], directions[block], hits)
        return colors

    def geometry(self) -> SceneGeometry:
        """Return the boxes of all objects: along the world's axes at rest, turned with what is moved."""
        self._check_open()
        world = self._world()
        return SceneGeometry({name: world.box(name) for name in self._objects.names()})

    def poses(self, objects: Collection[str] | None = None) -> Mapping[str, Pose]:
        """As :meth:`Source.poses`; at rest, an object's is the middle of its box, not turned."""
        world = self._world()
        names = self._moved if objects is None else objects
        return {name: world.pose(name) for name in sorted(names)}

    def close(self) -> None:
        self._worlds.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return _reopened, (self._path, self._settings, self._instant, self._hidden, dict(self._moved))

    def _check_open(self) -> None:
        if self._worlds.closed:
            raise closed_error(str(self._path))

    def world_with(self, poses: Mapping[str, Pose], hidden: Collection[str]) -> MeshWorld:
        """Return the mesh with some objects moved, by name, and some hidden."""
        self._check_open()
        return self._worlds.get(poses, hidden)

    def _world(self) -> MeshWorld:
        """Return the mesh at this source's instant."""
        return self._worlds.get(self._moved, self._hidden)

    def _pixels(self, view: View, *, colored: bool) -> dict[str, NDArray[Any]]:
        """Return the pixels of a view in all modes, (H, W, ...); colours if ``colored``."""
        world = self._world()
        rays = view.directions_w().reshape(-1, 3)
        center = view.pose.position
        images: dict[str, list[NDArray[Any]]] = {mode: [] for mode in sorted(self.capabilities.modes)}
        if not colored:
            images.pop("lit", None)
        for first in range(0, len(rays), _BLOCK):
            block = rays[first : first + _BLOCK]
            hits = world.hits(center, block)
            for mode, parts in images.items():
                parts.append(_image(world, mode, center, block, hits))
        pixels = {}
        lengths = view.ray_lengths()
        for mode, parts in images.items():
            image = np.concatenate(parts)
            image = image.reshape(view.height, view.width, *image.shape[1:])
            if mode == "depth":
                image = (image / lengths).astype(np.float32)
            image.flags.writeable = False
            pixels[mode] = image
        return pixels


def _image(world: MeshWorld, mode: str, center: Array, rays: Array, hits: Hits) -> NDArray[Any]:
    """Return what rays (N, 3) of one centre show in a mode; of depth, distances."""
    if mode == "depth":
        return hits.distance
    if mode == "object_mask":
        return world.labels(hits)
    if mode == "normals":
        return world.normals(hits, rays).astype(np.float32)
    return np.round(255 * world.colors(center, rays, hits)).astype(np.uint8)


class _Worlds:
    """The instants of a mesh that were used last; threads share them."""

    def __init__(self, resting: Resting) -> None:
        self.closed = False
        self._resting = resting
        self._lock = threading.Lock()
        self._resting_lock = threading.Lock()
        self._kept: OrderedDict[Any, MeshWorld] = OrderedDict()
        self._unmoved: OrderedDict[frozenset[str], Part | None] = OrderedDict()

    def get(self, poses: Mapping[str, Pose], hidden: Collection[str]) -> MeshWorld:
        """Return the mesh with some objects moved and some hidden."""
        moved = []
        for name, pose in sorted(poses.items()):
            moved.append((name, pose.position.tobytes(), pose.rotation.tobytes()))
        key = (tuple(moved), frozenset(hidden))
        with self._lock:
            if key not in self._kept:
                self._kept[key] = MeshWorld(self._resting, poses, hidden, self._without)
                if len(self._kept) > _KEPT_WORLDS:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(key)
            return self._kept[key]

    def _without(self, names: frozenset[str]) -> Part | None:
        """Return the mesh at rest without some objects: instants that move the same ones share it."""
        with self._resting_lock:
            if names not in self._unmoved:
                model = self._resting.model
                others = set(model.names) - names
                self._unmoved[names] = part_of(self._resting, model.vertices, others)
                if len(self._unmoved) > _KEPT_WORLDS:
                    self._unmoved.popitem(last=False)
            self._unmoved.move_to_end(names)
            return self._unmoved[names]

    def close(self) -> None:
        self.closed = True
        self._kept.clear()
        self._unmoved.clear()


def open_mesh(address: str, **options: Any) -> MeshSource:
    """Open ``mesh://ROOM.glb?unit=cm&labels=material``, a file of triangles.

    Options, behind the question mark or by name, are :class:`omniscv.sources.mesh.settings.Settings`.

    Raises:
        ArgumentError: a wrong option, or a file that is no mesh.
        SourceError: embreex is not installed.
    """
    readers = {option.name: str for option in fields(Settings)}
    path, written = split_address(address, readers)
    if twice := sorted(options.keys() & written.keys()):
        expected = f"expected it once, in the address or beside it, got {shown(written[twice[0]])} and"
        raise ArgumentError(f"{twice[0]}: {expected} {shown(options[twice[0]])}")
    with within(path):
        settings = read(Settings, {**options, **written}, "options")
    return MeshSource(Path(path), settings)


@cache
def _say_once(text: str) -> None:
    """Log a warning, the first time that this process has it."""
    LOGGER.warning("%s", text)


def _reopened(
    path: Path, settings: Settings, instant: Instant, hidden: frozenset[str], moved: Mapping[str, Pose]
) -> MeshSource:
    """Return the source of another process at its instant."""
    return copy_with(MeshSource(path, settings), _instant=instant, _hidden=hidden, _moved=moved)


def _rows(origins_w: Array, shape: tuple[int, ...]) -> Array:
    """Return origins (N, 3), one for each ray; one of all rays as it is."""
    origins = np.asarray(origins_w, np.float64)
    if origins.ndim == 1:
        return origins
    return np.broadcast_to(origins, (*shape, 3)).reshape(-1, 3)
