"""``scene://NAME-or-PATH``: a scene of the mock server, traced in this process, without server and wire."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import BOX_EDGES, ObjectBox, Room, SceneGeometry
from omniscv.parallel import side_by_side
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
"""Pixels traced together: their arrays stay in a core's cache, and scenes trace no more in one thread."""
_NEAR = 1e-3
"""Metres in front of a camera from which on boxes are projected."""
_CAPABILITIES = Capabilities(frozenset(("lit", "object_mask", "depth", "normals")), dialect="scene")


@dataclass
class _Traced:
    """A view: which of all its pixels (H, W) are kept (None: all), and these by mode."""

    where: NDArray[np.bool_] | None
    pixels: dict[str, NDArray[Any]] = field(default_factory=dict)


class SceneSource(Source):
    """Captures by exact tracing. A view is traced once for all modes.

    Args:
        scene: what to trace.
        capabilities: what the source declares; all that it can do if not given.
        lit: dtype of colours: uint8, or float32 0..1.
        masks: object masks as colours, or as uint16 instance ids, which are the labels.
        cached_views: how many views are kept, those used last, of 22 to 31 bytes a pixel.
        hidden: names of objects to leave out of every view.
        instant: what is shown: the scene at its time, with some objects at its poses. A pose is the place of
            the middle of the object's box, and the identity for an object as it is described.

    Attributes:
        scene: as it is traced, at the instant.
        made: how many views were traced.

    Raises:
        ArgumentError: another ``lit`` or ``masks``, no object of a name, or a time out of bounds.
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
        for name, value, kind in (("lit", lit, Lit), ("masks", masks, Masks)):
            if value not in get_args(kind):
                raise ArgumentError(f"{name}: expected one of {', '.join(get_args(kind))}; got {value!r}")
        self.made, self._instant = 0, instant
        self._asked_hidden, self._hidden = frozenset(hidden), instant.hidden.union(hidden)
        known_objects(self._hidden.union(instant.poses), scene.objects, f"scene {scene.name}")
        self.scene = scene if instant.state == "" else _placed(scene, instant)
        self._capabilities, self._lit, self._closed = capabilities or _CAPABILITIES, lit, False
        self._identity = SceneIdentity(scene.name, content=scene.digest())
        ids = {name: scene.label(name) for name in scene.objects}
        colors = ObjectTable({}, ids=ids).colors
        self._objects = ObjectTable(colors, ids=ids if masks == "ids" else {})
        palette = np.array([(0, 0, 0), *(colors[name] for name in scene.objects)], np.uint8)
        self._shown = np.arange(len(palette), dtype=np.uint16) if masks == "ids" else palette
        self._traced = lru_cache(cached_views)(self._untraced)
        self._like = partial(SceneSource, scene, capabilities, lit, masks, cached_views)

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
                image = _spread(image, where, self._beyond[request.mode])
            yield Capture(request, request.view, image, provenance)

    def geometry(self) -> SceneGeometry:
        """The boxes of all objects, each turned as its object, and the room."""
        self._check_open()
        return geometry_of(self.scene)

    def object_poses(self) -> dict[str, Pose]:
        """The poses of objects that move by themselves, and of those that the instant places."""
        found = {name: self.scene.pose(name) for name in {*self.scene.moving, *self._instant.poses}}
        return {name: Pose(position, R_w_o) for name, (R_w_o, position) in sorted(found.items())}

    def without(self, objects: Iterable[str]) -> SceneSource:
        """As :meth:`Source.without`; both may be used at the same time."""
        self._check_open()
        return self._like(self._asked_hidden.union(objects), self._instant)

    @property
    def state(self) -> str:
        return self._instant.state

    @property
    def instant(self) -> Instant:
        return self._instant

    def at(self, instant: Instant) -> SceneSource:
        """As :meth:`Source.at`; both may be used at the same time. No time is the scene's start."""
        self._check_open()
        return self._like(self._asked_hidden, instant)

    def close(self) -> None:
        self._closed = True
        self._traced.cache_clear()

    def __reduce__(self) -> tuple[Any, ...]:
        now = self._instant
        # What is read only, as the poses of an instant may be, cannot be pickled.
        return self._like, (self._asked_hidden, Instant(dict(now.poses), now.hidden, now.time, now.name))

    def _check_open(self) -> None:
        if self._closed:
            raise closed_error(f"scene {self.scene.name}")

    def _pixels(self, request: Request) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
        """A mode's pixels (H, W, ...); where objects are hidden, only those (N, ...) that may show another,
        and which these are. Colours cost as much as all else: they are computed where they are wanted first,
        or in another pass.
        """
        traced = self._traced(request.view)
        if request.mode not in traced.pixels:
            self.made += not traced.pixels
            found = self._trace(request.view, traced.where, colored=request.mode == "lit")
            traced.pixels = found | traced.pixels
        return traced.pixels[request.mode], traced.where

    def _trace(
        self, view: View, where: NDArray[np.bool_] | None, *, colored: bool
    ) -> dict[str, NDArray[Any]]:
        """All modes, colours only if they are wanted, (H, W, ...), or (N, ...) of the pixels ``where``."""
        from mock_server.render import pinhole_rays

        def block(rows: slice) -> dict[str, NDArray[Any]]:
            rays, lengths = pinhole_rays(
                view.pose.R_w_c, view.fov_deg, (view.width, view.height), rows=rows, where=where
            )
            hits = self.scene.trace(view.pose.position, rays, self._hidden)
            found: dict[str, NDArray[Any]] = {
                "object_mask": self._shown.take(hits.label, axis=0),
                "depth": (hits.distance / lengths).astype(np.float32),
                "normals": hits.normal.astype(np.float32),
            }
            return found | {"lit": self._lit_of(hits)} if colored else found

        step = max(1, _BLOCK_PX // view.width)
        blocks = side_by_side(block, [slice(start, start + step) for start in range(0, view.height, step)])
        return {mode: _frozen(np.concatenate([each[mode] for each in blocks])) for mode in blocks[0]}

    def _lit_of(self, hits: Hits) -> NDArray[Any]:
        """Colours as captures have them."""
        if self._lit == "float32":
            return hits.color.astype(np.float32)
        lit = np.clip(hits.color, 0, 1)
        lit *= 255
        return np.round(lit, out=lit).astype(np.uint8)

    @cached_property
    def _beyond(self) -> dict[str, Any]:
        """What pixels show that show no object, by mode."""
        sky = np.zeros(3) if self.scene.sky is None else self.scene.sky
        lit = sky if self._lit == "float32" else np.round(255 * sky)
        return {"lit": lit, "object_mask": self._shown[0], "depth": np.inf, "normals": 0.0}

    def _untraced(self, view: View) -> _Traced:
        return _Traced(None if not self._hidden or self.scene.sky is None else self._reached(view))

    def _reached(self, view: View) -> NDArray[np.bool_]:
        """(H, W) the pixels whose rays may meet an object that is not hidden: around the boxes' corners."""
        found = np.zeros((view.height, view.width), bool)
        for corners_w in self._shown_corners:
            found[_around(view, corners_w)] = True
        return found

    @cached_property
    def _shown_corners(self) -> list[NDArray[np.float64]]:
        """The corners (8, 3) of the boxes of objects that are not hidden."""
        names = set(self.scene.objects) - self._hidden
        return [ObjectBox.of(*self.scene.box(name), "scene").corners_w() for name in names]


def _frozen(pixels: NDArray[Any]) -> NDArray[Any]:
    pixels.flags.writeable = False
    return pixels


def _around(view: View, corners_w: NDArray[np.float64]) -> tuple[slice, slice]:
    """Rows and columns of a view that hold all of a box that is in front, by its corners (8, 3)."""
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
    size = np.array([view.width, view.height])
    pixels = np.clip(size / 2 + view.focal_px * points[:, :2] / points[:, 2:], -1, size + 1)
    (u0, v0), (u1, v1) = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 1
    return slice(max(0, int(v0)), max(0, int(v1))), slice(max(0, int(u0)), max(0, int(u1)))


def _spread(some: NDArray[Any], where: NDArray[np.bool_], beyond: Any) -> NDArray[Any]:
    """An image (H, W, ...) of pixels ``some`` where they are known, and of one value elsewhere."""
    image = np.empty((*where.shape, *some.shape[1:]), some.dtype)
    image[...] = beyond
    image[where] = some
    image.flags.writeable = False
    return image


def _placed(scene: Scene, instant: Instant) -> Scene:
    """The scene at an instant's time, with its poses."""
    if instant.time is None and not instant.poses:
        return scene
    poses = {name: (pose.rotation, pose.position) for name, pose in instant.poses.items()}
    try:
        return scene.at(scene.time if instant.time is None else instant.time, poses)
    except ValueError as wrong:
        raise ArgumentError(f"scene {scene.name}: {wrong}") from wrong


def geometry_of(scene: Scene) -> SceneGeometry:
    """Return what is known of the shapes in a scene of the mock server."""
    boxes = {name: ObjectBox.of(*scene.box(name), "scene") for name in scene.objects}
    return SceneGeometry(MappingProxyType(boxes), room_of(scene))


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
