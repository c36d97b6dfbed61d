"""``scene://NAME-or-PATH``: a scene of the mock server, traced in this process, without server and wire."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import BOX_EDGES, ObjectBox, Room, SceneGeometry
from omniscv.parallel import row_blocks
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    View,
    closed_error,
    known_objects,
)
from omniscv.sources.registry import split_address

if TYPE_CHECKING:
    from mock_server import Hits, Scene

Lit = Literal["uint8", "float32"]
Masks = Literal["colors", "ids"]

_START = Instant()
_BLOCK_PX = 1 << 13
"""Pixels traced together: their arrays stay in a core's cache, and one thread traces at most as many."""
_NEAR = 1e-3
"""Least planar depth of projected boxes, metres."""
_CAPABILITIES = Capabilities(
    frozenset(("lit", "object_mask", "depth", "normals")), dialect="scene", transfer="linear"
)


@dataclass
class _Traced:
    """A traced view: the pixels (H, W) that are kept (None: all), and their values by mode."""

    where: NDArray[np.bool_] | None
    pixels: dict[str, NDArray[Any]] = field(default_factory=dict)


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

    Raises:
        ArgumentError: another ``lit`` or ``masks``, an unknown object, or a time out of bounds.
    """

    def __init__(
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
        self.made, self._instant = 0, instant
        self._left_out, self._hidden = frozenset(hidden), instant.hidden.union(hidden)
        known_objects(self._hidden.union(instant.poses), scene.objects, f"scene {scene.name}")
        self.scene = scene if instant.state == "" else _scene_at(scene, instant)
        self._capabilities, self._lit, self._closed = capabilities or _CAPABILITIES, lit, False
        self._identity = SceneIdentity(scene.name, content=scene.digest())
        ids = {name: scene.label(name) for name in scene.objects}
        colors = ObjectTable({}, ids=ids).colors
        self._objects = ObjectTable(colors, ids=ids if masks == "ids" else {})
        palette = np.array([(0, 0, 0), *(colors[name] for name in scene.objects)], np.uint8)
        self._mask_values = np.arange(len(palette), dtype=np.uint16) if masks == "ids" else palette
        self._traced = lru_cache(cached_views)(self._new_view)
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
            image, where = self._pixels(request)
            if where is not None:
                image = _spread(image, where, self._background[request.mode])
            yield Capture(request, request.view, image, provenance)

    def geometry(self) -> SceneGeometry:
        """Return the boxes of all objects, each turned as its object, and the room."""
        self._check_open()
        scene = self.scene
        boxes = {name: ObjectBox.of(*scene.box(name), "scene") for name in scene.objects}
        return SceneGeometry(MappingProxyType(boxes), room_of(scene))

    def object_poses(self) -> dict[str, Pose]:
        """Return the poses of objects that move by themselves, and of those that the instant moves."""
        poses = {name: self.scene.pose(name) for name in {*self.scene.moving, *self._instant.poses}}
        return {name: Pose(position, R_w_o) for name, (R_w_o, position) in sorted(poses.items())}

    def without(self, objects: Iterable[str]) -> SceneSource:
        """As :meth:`Source.without`; both may be used at the same time."""
        self._check_open()
        return self._copy(self._left_out.union(objects), self._instant)

    @property
    def state(self) -> str:
        return self._instant.state

    @property
    def instant(self) -> Instant:
        return self._instant

    def at(self, instant: Instant) -> SceneSource:
        """As :meth:`Source.at`; both may be used at the same time. Without a time: at the scene's start."""
        self._check_open()
        return self._copy(self._left_out, instant)

    def close(self) -> None:
        self._closed = True
        self._traced.cache_clear()

    def __reduce__(self) -> tuple[Any, ...]:
        return self._copy, (self._left_out, self._instant)

    def _check_open(self) -> None:
        if self._closed:
            raise closed_error(f"scene {self.scene.name}")

    def _pixels(self, request: Request) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
        """Return a mode's pixels (H, W, ...); where objects are hidden, only those (N, ...) that may show
        other objects, and which these are. Colours cost as much as all other modes together, so they are
        computed only when they are requested.
        """
        traced = self._traced(request.view)
        if request.mode not in traced.pixels:
            self.made += not traced.pixels
            pixels = self._trace(request.view, traced.where, colored=request.mode == "lit")
            traced.pixels = pixels | traced.pixels
        return traced.pixels[request.mode], traced.where

    def _trace(
        self, view: View, where: NDArray[np.bool_] | None, *, colored: bool
    ) -> dict[str, NDArray[Any]]:
        """Return all modes, colours only if ``colored``, (H, W, ...), or (N, ...) of the pixels ``where``."""
        from mock_server.render import pinhole_rays

        def block(rows: slice) -> dict[str, NDArray[Any]]:
            rays, lengths = pinhole_rays(
                view.pose.R_w_c,
                view.fov_deg,
                (view.width, view.height),
                rows=rows,
                where=where,
                projection=view.projection if view.lens else None,
            )
            hits = self.scene.trace(view.pose.position, rays, self._hidden)
            pixels: dict[str, NDArray[Any]] = {
                "object_mask": self._mask_values.take(hits.label, axis=0),
                "depth": (hits.distance / lengths).astype(np.float32),
                "normals": hits.normal.astype(np.float32),
            }
            return pixels | {"lit": self._lit_of(hits)} if colored else pixels

        blocks = row_blocks(block, view.height, view.width, _BLOCK_PX)
        return {mode: _frozen(np.concatenate([pixels[mode] for pixels in blocks])) for mode in blocks[0]}

    def _lit_of(self, hits: Hits) -> NDArray[Any]:
        """Return colours as captures have them."""
        if self._lit == "float32":
            return hits.color.astype(np.float32)
        lit = np.clip(hits.color, 0, 1)
        lit *= 255
        return np.round(lit, out=lit).astype(np.uint8)

    @cached_property
    def _background(self) -> dict[str, Any]:
        """The value of pixels that show no object, by mode."""
        sky = np.zeros(3) if self.scene.sky is None else self.scene.sky
        lit = sky if self._lit == "float32" else np.round(255 * sky)
        return {"lit": lit, "object_mask": self._mask_values[0], "depth": np.inf, "normals": 0.0}

    def _new_view(self, view: View) -> _Traced:
        if not self._hidden or self.scene.sky is None:
            return _Traced(None)
        may_show_object = np.zeros((view.height, view.width), bool)
        for corners_w in self._visible_corners:
            may_show_object[_rectangle_around(view, corners_w)] = True
        return _Traced(may_show_object)

    @cached_property
    def _visible_corners(self) -> list[NDArray[np.float64]]:
        """The corners (8, 3) of the boxes of objects that are not hidden."""
        names = set(self.scene.objects) - self._hidden
        return [ObjectBox.of(*self.scene.box(name), "scene").corners_w() for name in names]


def _frozen(pixels: NDArray[Any]) -> NDArray[Any]:
    pixels.flags.writeable = False
    return pixels


def _rectangle_around(view: View, corners_w: NDArray[np.float64]) -> tuple[slice, slice]:
    """Return rows and columns of a view that hold all of a box in front of it, by its corners (8, 3)."""
    points_c = view.pose.to_camera(corners_w)
    ends = points_c[BOX_EDGES]  # (12, 2, 3)
    a, b = ends[:, 0, 2] - _NEAR, ends[:, 1, 2] - _NEAR
    crossed = a * b < 0
    share = (a / np.where(crossed, a - b, 1.0))[crossed, None]
    points = np.concatenate(
        [points_c[points_c[:, 2] >= _NEAR], ends[crossed, 0] * (1 - share) + ends[crossed, 1] * share]
    )
    if not len(points):
        return slice(0), slice(0)
    size, of = np.array([view.width, view.height]), view.projection
    pixels = np.clip(of[2:] + of[:2] * points[:, :2] / points[:, 2:], -1, size + 1)
    (u0, v0), (u1, v1) = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 1
    return slice(max(0, int(v0)), max(0, int(v1))), slice(max(0, int(u0)), max(0, int(u1)))


def _spread(pixels: NDArray[Any], where: NDArray[np.bool_], background: Any) -> NDArray[Any]:
    """Return an image (H, W, ...) of pixels (N, ...) ``where`` they are known, and of one value elsewhere."""
    image = np.empty((*where.shape, *pixels.shape[1:]), pixels.dtype)
    image[...] = background
    image[where] = pixels
    image.flags.writeable = False
    return image


def _scene_at(scene: Scene, instant: Instant) -> Scene:
    """Return the scene at an instant's time, with its poses."""
    if instant.time is None and not instant.poses:
        return scene
    poses = {name: (pose.rotation, pose.position) for name, pose in instant.poses.items()}
    try:
        return scene.at(scene.time if instant.time is None else instant.time, poses)
    except ValueError as wrong:
        raise ArgumentError(f"scene {scene.name}: {wrong}") from wrong


def room_of(scene: Scene) -> Room | None:
    """Return the room of a scene of the mock server; None for one without."""
    room = scene.room
    if room is None:
        return None
    return Room(room.corners, 0.0, room.height, room.walls, room.floor, room.ceiling)


def open_scene(address: str) -> SceneSource:
    """Open ``scene://NAME-or-PATH?lit=float32&masks=ids&time=1.5``; all options may be left out."""
    import mock_server

    name, options = split_address(address, {"lit": str, "masks": str, "time": float})
    time_s = options.pop("time", None)
    try:
        return SceneSource(mock_server.load_scene(name), **options, instant=Instant(time=time_s))
    except ValueError as wrong:
        raise ArgumentError(f"source: {address!r}: {wrong}") from wrong


open_scene.capabilities = lambda address: _CAPABILITIES  # type: ignore[attr-defined]  # for the registry
