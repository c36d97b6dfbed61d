"""The interface of every source: views, requests, captures, capabilities, the objects of a scene."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv import modalities
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry import Array, Pose, pinhole
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.world import World

_POSE_DECIMALS = 7
"""Of metres, degrees and matrix entries: views that agree to these decimals are equal. 1e-7 rad is a
ten-thousandth of a pixel at f = 1024; servers print three decimals of a centimetre."""

_LONGEST_PART = 150  # characters of a part of a scene's identity

Color = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class View:
    """One perspective picture: a pose, a horizontal field of view in (0, 180), a size of at least 1 x 1 px.

    The picture's frame is the pose's camera frame (x right, y down, z forward); a point is seen at
    ``u = W/2 + f x/z``, ``v = H/2 + f y/z`` with ``f = (W/2) / tan(fov/2)``, pixel centres at +0.5.

    Raises:
        ArgumentError: a field of view or size outside its domain.
    """

    pose: Pose
    fov_deg: float
    width: int
    height: int

    def __post_init__(self) -> None:
        if not 0 < self.fov_deg < 180:
            raise ArgumentError(f"fov_deg: expected 0 < fov_deg < 180, got {self.fov_deg!r}")
        if not (self.width >= 1 and self.height >= 1):
            raise ArgumentError(f"size: expected at least 1 x 1 px, got {self.width} x {self.height}")

    @property
    def focal_px(self) -> float:
        """Focal length in px, the same across and down."""
        return pinhole.focal_px(self.width, self.fov_deg)

    def scaled(self, factor: int) -> Self:
        """Return the view with ``factor`` times as many pixels each way."""
        return self if factor == 1 else replace(self, width=factor * self.width, height=factor * self.height)

    def project(self, points_w: ArrayLike) -> Array:
        """(..., 3) world points to (..., 3): u, v in px, z planar depth in m (z <= 0: behind)."""
        return pinhole.project(self.pose.to_camera(points_w), self.focal_px, self.width, self.height)

    def ray_lengths(self) -> Array:
        """(H, W): length of the ray to each pixel's centre per metre of planar depth, ``|(x/z, y/z, 1)|``."""
        return pinhole.ray_lengths(self.focal_px, self.width, self.height)

    def key(self) -> tuple[Any, ...]:
        """Width, height, position (3), rotation (9) and ``fov_deg``, rounded: equal views have equal keys."""
        return self._key

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        numbers = np.concatenate([self.pose.position, self.pose.rotation.ravel(), [self.fov_deg]])
        rounded = np.round(numbers, _POSE_DECIMALS) + 0.0  # + 0.0: no negative zero
        return (self.width, self.height, *rounded.tolist())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, View) and self.key() == other.key()

    def __hash__(self) -> int:
        return hash(self.key())


@dataclass(frozen=True)
class Request:
    """A view in a mode, of the world in a state.

    Attributes:
        view: what is captured.
        mode: a modality that sources deliver; of an alias, the modality's name is kept.
        state: of the world (:attr:`omniscv.geometry.instant.Instant.state`); empty for a still one.

    Raises:
        ArgumentError: no such modality.
    """

    view: View
    mode: str
    state: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "mode", *modalities.chosen((self.mode,)))


@dataclass(frozen=True, eq=False)
class Capture:
    """What a source delivers for a request.

    Attributes:
        request: what was requested.
        view: what was captured, the view that rays are looked up in. It differs from ``request.view`` where
            the source cannot capture exactly that.
        pixels: read-only, (H, W) or (H, W, C) as :mod:`omniscv.modalities` has it. Depth is planar, in
            metres, +inf for no surface; normals are unit vectors in the world frame, 0 where unknown. Object
            masks are RGB colours, or uint16 (H, W) instance ids that the source's :class:`ObjectTable` names.
        provenance: server, scene, command, time: plain JSON values.
        payload: the bytes as received, for sources with a wire.
        encoding: the codec of :mod:`omniscv.sources.codecs` that decodes ``payload`` to ``pixels``.
    """

    request: Request
    view: View
    pixels: NDArray[Any]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    payload: bytes | None = None
    encoding: str | None = None

    @property
    def mode(self) -> str:
        """The request's mode."""
        return self.request.mode


@dataclass(frozen=True)
class Capabilities:
    """What a source can do; of a live server as probed, never from a version string.

    Attributes:
        modes: the modalities that it can capture.
        can_set_size, can_set_fov: whether views may differ from ``image_size`` and ``fov_deg``.
        can_set_tall: whether views may be higher than wide.
        image_size: (width, height) of every view, where it cannot be set.
        fov_deg: horizontal field of view of every view, where it cannot be set.
        min_size: the smallest width and height of a view, px.
        dialect: the server's dialect; the kind of other sources.
    """

    modes: frozenset[str] = field(default_factory=lambda: frozenset(modalities.names()))
    can_set_size: bool = True
    can_set_fov: bool = True
    can_set_tall: bool = True
    image_size: tuple[int, int] | None = None
    fov_deg: float | None = None
    min_size: int = 1
    dialect: str = ""


@dataclass(frozen=True)
class ObjectTable:
    """The objects of a scene, and how its object masks show them.

    Labels: 1 + the rank of the name in sorted order; 0 = nothing known.

    Attributes:
        colors: name to the colour that masks show, RGB 0..255; made up where only ``ids`` are given.
        tolerance: how far a channel of a mask may be off its object's colour.
        ids: name to the instance id that masks hold in place of colours.
    """

    colors: dict[str, Color]
    tolerance: int = 0
    ids: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.ids and not self.colors:
            object.__setattr__(self, "colors", {name: _color_of(each) for name, each in self.ids.items()})

    def label(self, name: str) -> int:
        """The label of an object; ValueError for a name that the table does not have."""
        return 1 + self.names().index(name)

    def names(self) -> list[str]:
        """All names in sorted order: label - 1 is the index."""
        return sorted(self.colors)


def _color_of(instance: int) -> Color:
    """The colour made up for an instance id: unique, never black. A multiple of an odd number modulo 2^24."""
    code = (1 + instance) * 0x9E3779 % (1 << 24)
    return code >> 16, code >> 8 & 255, code & 255


@dataclass(frozen=True)
class SceneIdentity:
    """What identifies the scene that a source shows; a part that the source does not know is empty.

    Attributes:
        name: of the project or scene.
        level: of the level, or map, in it.
        content: a digest of all there is to see.
    """

    name: str = ""
    level: str = ""
    content: str = ""

    def __post_init__(self) -> None:
        for part in fields(self):
            object.__setattr__(self, part.name, str(getattr(self, part.name))[:_LONGEST_PART])

    def differs(self, other: Self) -> bool:
        """Whether a part that both know is another: then both cannot be the same scene."""
        return any(a and b and a != b for a, b in zip(astuple(self), astuple(other), strict=True))

    def merged(self, other: Self) -> Self:
        """Return this identity, with what only the other knows."""
        return type(self)(*(a or b for a, b in zip(astuple(self), astuple(other), strict=True)))


class Source(ABC):
    """Where captures come from; a context manager.

    Every method may be called from several threads, and ``close`` several times. A closed source raises
    :func:`closed_error`.
    """

    @property
    @abstractmethod
    def capabilities(self) -> Capabilities:
        """What this source can do."""

    @abstractmethod
    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """Captures, one per request, in the order of the requests; ``requests`` is read lazily.

        Raises:
            SourceError: a live source could not deliver within its deadlines and retries.
            RecordingError: a recording does not hold a capture, or holds it damaged.
        """

    @abstractmethod
    def objects(self) -> ObjectTable:
        """The objects of the scene, and how masks show them."""

    def cover(self, view: View) -> tuple[View, ...]:
        """The views to request so that their captures together cover ``view``; the view itself first.

        More than one where the source captures some views with another orientation than requested.
        """
        return (view,)

    def recorded_views(self) -> tuple[View, ...] | None:
        """The views that can be replayed, for a source that cannot make new ones; None otherwise."""
        return None

    @property
    def scene_identity(self) -> SceneIdentity:
        """What identifies the scene: captures of two scenes do not belong in one recording."""
        return SceneIdentity()

    def geometry(self) -> SceneGeometry:
        """What is known of the shapes in the scene; empty for sources that only give pictures."""
        return SceneGeometry()

    def object_poses(self) -> Mapping[str, Pose]:
        """The poses of the objects that move, at this source's instant: ``R_w_o`` and position; those that
        are not known are left out."""
        return self.instant.poses

    def without(self, objects: Iterable[str]) -> Source:
        """Return a source of the same scene in which objects are hidden.

        The caller closes it before this source is used again; closing it shows the objects again.

        Raises:
            ArgumentError: this source cannot hide objects, or has no object of a name.
        """
        raise ArgumentError(f"source: expected one that can hide objects, got {type(self).__name__}")

    @property
    def state(self) -> str:
        """The state of the world that captures show; empty while nothing was changed in it."""
        return ""

    @property
    def instant(self) -> Instant:
        """What is known of the world that captures show: what was set in it, or read from it."""
        return Instant()

    def at(self, instant: Instant) -> Source:
        """Return a source of the same world at an instant.

        A live source sets the world so, a recording replays what was captured then. The caller closes what
        is returned before this source is used again; closing it puts the world back.

        Raises:
            ArgumentError: this source cannot move objects, or has no object of a name.
            RecordingError: a recording holds nothing of that state.
        """
        if instant.state == "":
            return SourceView(self)
        raise ArgumentError(f"source: expected one whose objects can be moved, got {type(self).__name__}")

    def command(self, text: str) -> str:
        """Send a command of the server's own language, and return its reply.

        Raises:
            ArgumentError: this source is no live server.
            SourceError: no reply within the deadlines, or the reply is an error.
        """
        raise ArgumentError(
            f"source: expected a live server to send {shown(text)} to, got {type(self).__name__}"
        )

    @property
    def world(self) -> World:
        """The running world behind a live source; ArgumentError for other sources."""
        raise ArgumentError(
            f"source: expected a live server, whose world can be changed, got {type(self).__name__}"
        )

    def close(self) -> None:  # noqa: B027 - most sources hold nothing
        """Release connections, files and memory."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class SourceWrapper(Source):
    """A source around another one, closed with it; subclasses override what they change."""

    def __init__(self, source: Source) -> None:
        self._source = source

    @property
    def capabilities(self) -> Capabilities:
        return self._source.capabilities

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        return self._source.capture(requests)

    def objects(self) -> ObjectTable:
        return self._source.objects()

    def cover(self, view: View) -> tuple[View, ...]:
        return self._source.cover(view)

    def recorded_views(self) -> tuple[View, ...] | None:
        return self._source.recorded_views()

    def geometry(self) -> SceneGeometry:
        return self._source.geometry()

    def object_poses(self) -> Mapping[str, Pose]:
        return self._source.object_poses()

    def without(self, objects: Iterable[str]) -> Source:
        return self._source.without(objects)

    @property
    def state(self) -> str:
        return self._source.state

    @property
    def instant(self) -> Instant:
        return self._source.instant

    def at(self, instant: Instant) -> Source:
        return self._source.at(instant)

    def command(self, text: str) -> str:
        return self._source.command(text)

    @property
    def world(self) -> World:
        return self._source.world

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._source.scene_identity

    def close(self) -> None:
        self._source.close()


class SourceView(SourceWrapper):
    """A source that stays open when this is closed."""

    def close(self) -> None:
        pass


def closed_error(what: str) -> SourceError:
    """The error to raise where a closed source is used."""
    return SourceError(f"{what}: expected an open source, got a closed one; open it again")


def known_objects(objects: Iterable[str], known: Collection[str], what: str) -> None:
    """Raise ArgumentError for names of objects that are not known."""
    if strange := sorted(set(objects) - set(known)):
        raise ArgumentError(f"{what}: expected objects of the scene, got {shown(strange[0])}")


def not_picklable(what: str) -> SourceError:
    """The error to raise where a source that holds connections is pickled, as for a spawned process."""
    wanted = "expected a source that can be pickled, got one that holds connections"
    return SourceError(f"{what}: {wanted}; open it in each process by its address")
