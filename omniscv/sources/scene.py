"""``scene://NAME-or-PATH``: a scene of the mock server, traced in this process, without server and wire."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import ObjectBox, Room, SceneGeometry
from omniscv.parallel import row_blocks, side_by_side
from omniscv.sources.base import (
    STATIC_SETTINGS,
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    Traced,
    View,
    closed_error,
    known_objects,
)
from omniscv.sources.registry import split_address

if TYPE_CHECKING:
    from mock_server import Scene

Lit = Literal["uint8", "float32"]
Masks = Literal["colors", "ids"]
Paint = Callable[[], Array]
"""Makes the colours of rays that have been traced."""

_START = Instant()
_BLOCK_PX = 1 << 13
"""Pixels traced together: their arrays stay in a core's cache, and one thread traces at most as many."""
_UNPAINTED_PX = 1 << 20  # of a view whose rays are kept until its colours are requested: 88 bytes a pixel
_CAPABILITIES = Capabilities(
    frozenset(("lit", "object_mask", "depth", "normals")),
    dialect="scene",
    transfer="linear",
    varies=frozenset(("objects",)),
)


class SceneSource(Source):
    """Captures by exact tracing. A view is traced once for all modes.

    Args:
        scene: what to trace.
        capabilities: what the source declares; everything that it can do if not given.
        lit: dtype of colours: uint8, or float32 0..1.
        masks: object masks as colours, or as uint16 instance ids, which are the labels.
        cached_views: how many views are kept, those used last, of 22 to 31 bytes a pixel.
        hidden: names of objects to leave out of every view.
        instant: what is shown: the scene at its time, with some objects at its poses. A pose is the middle of
            the object's box, and the identity for an object as the scene describes it.

    Attributes:
        scene: as it is traced, at the instant.
        made: how many views were traced.
    """

    def __init__(  # noqa: PLR0915 - attributes alone
        self,
        scene: Scene,
        capabilities: Capabilities | None = None,
        lit: Lit = "uint8",
        masks: Masks = "colors",
        cached_views: int = 32,
        hidden: Iterable[str] = (),
        instant: Instant = _START,
    ) -> None:
        one_of("lit", lit, get_args(Lit))
        one_of("masks", masks, get_args(Masks))
        self.made = 0
        self._instant = instant
        named = {*instant.hidden, *hidden, *instant.poses, *instant.varied.get("objects", {})}
        known_objects(named, scene.objects, f"scene {scene.name}")
        try:
            self.scene = scene if instant.time is None else scene.at(instant.time)
            drawn, undrawn = instant.placed(self.poses)
            self._moved = {**instant.poses, **drawn}
            if static := sorted(self._moved.keys() & scene.static):
                raise ValueError(f"expected objects that can be moved, got {static[0]}, which is static")
            if self._moved:
                self.scene = self.scene.at(self.scene.time, _rotations_and_positions(self._moved))
        except ValueError as wrong:
            raise ArgumentError(f"scene {scene.name}: {wrong}") from wrong
        self._without = frozenset(hidden)  # by without()
        self._hidden = instant.hidden.union(hidden, undrawn)
        self._capabilities = capabilities or _CAPABILITIES
        self._lit = lit
        self._closed = False
        self._identity = SceneIdentity(scene.name, content=scene.digest())
        ids = {name: scene.label(name) for name in scene.objects}
        colors = ObjectTable({}, ids=ids).colors
        self._objects = ObjectTable(colors, ids=ids if masks == "ids" else {})
        palette = np.array([(0, 0, 0), *(colors[name] for name in scene.objects)], np.uint8)
        self._mask_values = np.arange(len(palette), dtype=np.uint16) if masks == "ids" else palette
        self._pixels_of = lru_cache(cached_views)(lambda view: dict[str, NDArray[Any]]())
        self._unpainted: tuple[dict[str, NDArray[Any]], list[Paint]] = ({}, [])
        """The pixels of the view that was traced last, by mode, and what makes its colours."""
        self._copy = partial(SceneSource, scene, capabilities, lit, masks, cached_views)

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._identity

    def objects(self) -> ObjectTable:
        self._check_open()
        return self._objects

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; ArgumentError for a modality that scenes do not have."""
        provenance = {"server": "in-process", "scene": self.scene.name, "dialect": "scene"}
        for request in requests:
            self._check_open()
            request.check_state(self.state, f"scene {self.scene.name}")
            if request.mode not in _CAPABILITIES.modes:
                known = ", ".join(sorted(_CAPABILITIES.modes))
                raise ArgumentError(f"mode: expected one of {known} of a scene, got {request.mode!r}")
            yield Capture(request, request.view, self._pixels(request), provenance)

    def trace(self, origins_w: Array, directions_w: Array) -> Traced:
        """As :meth:`Source.trace`: from ``origins_w`` along ``directions_w``, past what is hidden."""
        self._check_open()
        hits = self.scene.trace(origins_w, directions_w, self._hidden)
        return Traced(hits.distance, hits.label.astype(np.uint16), hits.normal)

    def shade(self, origins_w: Array, directions_w: Array) -> NDArray[np.float32]:
        """As :meth:`Source.shade`."""
        self._check_open()
        return self.scene.trace(origins_w, directions_w, self._hidden).color.astype(np.float32)

    def geometry(self) -> SceneGeometry:
        """Return the boxes of all objects, each turned as its object, and the room."""
        self._check_open()
        scene = self.scene
        boxes = {}
        for name in scene.objects:
            center, axes, size = scene.box(name)
            boxes[name] = ObjectBox.of(center, axes, size, "scene")
        return SceneGeometry(MappingProxyType(boxes), room_of(scene))

    def poses(self, objects: Collection[str] | None = None) -> dict[str, Pose]:
        """As :meth:`Source.poses`: of objects that move by themselves, and that the instant moves."""
        names = {*self.scene.moving, *self._moved} if objects is None else objects
        poses = {}
        for name in sorted(names):
            R_w_o, position = self.scene.pose(name)
            poses[name] = Pose(position, R_w_o)
        return poses

    def own_poses(self, time_s: float) -> Mapping[str, Pose]:
        with self.at(Instant(time=time_s)) as there:
            return there.poses()

    def variable(self, kind: str) -> dict[str, Mapping[str, int]]:
        settings = dict(super().variable(kind))
        for name in settings:
            if name in self.scene.static:
                settings[name] = STATIC_SETTINGS
        return settings

    def without(self, objects: Iterable[str]) -> SceneSource:
        """As :meth:`Source.without`; both may be used at the same time."""
        self._check_open()
        return self._copy(self._without.union(objects), self._instant)

    @property
    def instant(self) -> Instant:
        return self._instant

    def at(self, instant: Instant) -> SceneSource:
        """As :meth:`Source.at`; both may be used at the same time. Without a time: at the scene's start."""
        self._check_open()
        return self._copy(self._without, instant)

    def close(self) -> None:
        self._closed = True
        self._unpainted = ({}, [])
        self._pixels_of.cache_clear()

    def __reduce__(self) -> tuple[Any, ...]:
        return self._copy, (self._without, self._instant)

    def _check_open(self) -> None:
        if self._closed:
            raise closed_error(f"scene {self.scene.name}")

    def _pixels(self, request: Request) -> NDArray[Any]:
        """Return a mode's pixels (H, W, ...). Colours cost as much as all others, and are made on request;
        of a small view that was traced last, from its rays."""
        view = request.view
        pixels = self._pixels_of(request.view)
        if request.mode in pixels:
            return pixels[request.mode]
        traced_last, paints = self._unpainted
        if traced_last is pixels and request.mode == "lit":
            images = {"lit": np.concatenate(side_by_side(lambda paint: self._codes(paint()), paints))}
            self._unpainted = ({}, [])
        else:
            if not pixels:
                self.made += 1
            images, paints = self._trace(view, colored=request.mode == "lit")
            self._unpainted = (pixels, paints) if paints else ({}, [])
        for mode, image in images.items():
            image.flags.writeable = False
            pixels.setdefault(mode, image)
        return pixels[request.mode]

    def _codes(self, color: Array) -> NDArray[Any]:
        if self._lit == "float32":
            return color.astype(np.float32)
        lit = np.clip(color, 0, 1)
        lit *= 255
        return np.round(lit, out=lit).astype(np.uint8)

    def _trace(self, view: View, *, colored: bool) -> tuple[dict[str, NDArray[Any]], list[Paint]]:
        """Return all modes (H, W, ...), colours only if ``colored``; of a small view else what makes them."""
        from mock_server.pixels import pinhole_rays

        kept = not colored and view.width * view.height <= _UNPAINTED_PX

        def block(rows: slice) -> tuple[dict[str, NDArray[Any]], Paint | None]:
            size = (view.width, view.height)
            lens = view.projection if view.lens else None
            rays, lengths = pinhole_rays(view.pose.R_w_c, view.fov_deg, size, rows=rows, projection=lens)
            hits = self.scene.trace(view.pose.position, rays, self._hidden)
            pixels: dict[str, NDArray[Any]] = {
                "object_mask": self._mask_values.take(hits.label, axis=0),
                "depth": (hits.distance / lengths).astype(np.float32),
                "normals": hits.normal.astype(np.float32),
            }
            if colored:
                pixels["lit"] = self._codes(hits.color)
            return pixels, hits.paint if kept else None

        parts: dict[str, list[NDArray[Any]]] = {}
        paints: list[Paint] = []
        for pixels, paint in row_blocks(block, view.height, view.width, _BLOCK_PX):
            for mode, part in pixels.items():
                parts.setdefault(mode, []).append(part)
            if paint:
                paints.append(paint)
        return {mode: np.concatenate(parts[mode]) for mode in parts}, paints


def _rotations_and_positions(poses: Mapping[str, Pose]) -> dict[str, tuple[Array, Array]]:
    """Return the rotation and the position of each object, by its name."""
    parts = {}
    for name, pose in poses.items():
        parts[name] = (pose.rotation, pose.position)
    return parts


def room_of(scene: Scene) -> Room | None:
    """Return the room of a scene of the mock server; None for one without."""
    room = scene.room
    if room is None:
        return None
    return Room(room.corners, 0.0, room.height, room.walls, room.floor, room.ceiling)


def open_scene(address: str) -> SceneSource:
    """Open ``scene://NAME-or-PATH?lit=float32&masks=ids&time=1.5``; all options may be left out.

    With ``traces=0`` ground truth and colours come by captures alone, as from an engine.
    """
    import mock_server

    name, options = split_address(address, {"lit": str, "masks": str, "time": float, "traces": int})
    time_s = options.pop("time", None)
    traces = bool(options.pop("traces", 1))
    floats = options.get("lit") == "float32"
    can = replace(_CAPABILITIES, traces=traces, shades=traces, float_colors=floats)
    try:
        return SceneSource(mock_server.load_scene(name), can, **options, instant=Instant(time=time_s))
    except ValueError as wrong:
        raise ArgumentError(f"source: {address!r}: {wrong}") from wrong
