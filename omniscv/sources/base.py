"""The interface of every source: views, requests, captures, capabilities, the objects of a scene.

A live source belongs to the process that opened it: :class:`ProcessBound`. Scenes and recordings hold no
connection, and work in forked children.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, NoReturn, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.arguments import did_you_mean, shown
from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry import Array, Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.modalities import Transfer
from omniscv.sources.recorded_views import RecordedViews
from omniscv.sources.requests import Capture as Capture
from omniscv.sources.requests import Lens as Lens
from omniscv.sources.requests import Request as Request
from omniscv.sources.requests import Traced as Traced
from omniscv.sources.requests import View as View
from omniscv.sources.world import Color as Color
from omniscv.sources.world import ObjectTable as ObjectTable
from omniscv.sources.world import SceneIdentity as SceneIdentity
from omniscv.sources.world import SharedExposure, World

S = TypeVar("S", bound="Source")
F = TypeVar("F", bound=Callable[..., Any])

OBJECT_SETTINGS = {"shift": 3, "turn_deg": 1, "shown": 1, "clearance": 1}
"""What draws may set of an object, and how many numbers each has."""

STATIC_SETTINGS = {"shown": 1}
"""The same, of an object that cannot be moved."""


@dataclass(frozen=True)
class Capabilities:
    """What a source can do. A live server is probed; its version string is not used.

    Attributes:
        modes: the modalities that it can capture.
        can_set_size, can_set_fov: whether views may differ from ``image_size`` and ``fov_deg``.
        can_set_tall: whether views may be higher than wide.
        can_set_exposure: whether colours can be captured at other exposures (:attr:`Request.stops`).
        image_size: (width, height) of every view, where it cannot be set.
        fov_deg: horizontal field of view of every view, where it cannot be set.
        min_size: the smallest width and height of a view, px.
        dialect: the server's dialect; of other sources, what they are, such as ``recording``.
        near_m: no surface is nearer to an optical centre, metres: bounds the marks of masks at shared centres
            where no depth is captured.
        transfer: what 8-bit colours say of light (:mod:`omniscv.light`).
        depth_error: how far planar depth may be off beside its encoding's digits: metres, and a share of it.
        moves: whether the world may change between two captures; captures that must show one instant are
            then checked for motion (:mod:`omniscv.sources.stillness`).
        varies: what of ``objects``, ``lights``, ``materials`` can be varied (:mod:`omniscv.job.vary`);
            ``commands``: what commands of the job set.
        traces: whether it tells what single rays meet (:meth:`Source.trace`).
        shades: whether it tells the colours that single rays meet (:meth:`Source.shade`).
        float_colors: whether colours are floating-point light, not 8-bit codes; only asked of a source that
            shades.
    """

    modes: frozenset[str] = field(default_factory=lambda: frozenset(modalities.names()))
    can_set_size: bool = True
    can_set_fov: bool = True
    can_set_tall: bool = True
    can_set_exposure: bool = False
    image_size: tuple[int, int] | None = None
    fov_deg: float | None = None
    min_size: int = 1
    dialect: str = ""
    near_m: float = 0.1
    transfer: Transfer = "unknown"
    depth_error: tuple[float, float] = (0.0, 0.0)
    moves: bool = False
    varies: frozenset[str] = frozenset()
    traces: bool = False
    shades: bool = False
    float_colors: bool = False


class Source(ABC):
    """Where captures come from; a context manager.

    Methods may be called from several threads, ``close`` several times. A closed source raises
    :func:`closed_error`.
    """

    def __repr__(self) -> str:
        modes = " ".join(sorted(self.capabilities.modes))
        parts = (self.scene_identity.name, self.capabilities.dialect, modes)
        return f"<{type(self).__name__} {', '.join(filter(None, parts))}>"

    @property
    @abstractmethod
    def capabilities(self) -> Capabilities:
        """What this source can do."""

    @abstractmethod
    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """Yield captures, one per request, in the order of the requests, which are read lazily.

        Raises:
            ArgumentError: the world is in another state than a request's.
            SourceError: a live source could not deliver within its deadlines and retries.
            RecordingError: a recording does not hold a capture, or holds it damaged.
        """

    @abstractmethod
    def objects(self) -> ObjectTable:
        """Return the objects of the scene, and how masks show them."""

    def require_one_numbering(self) -> None:
        """Refuse a source of rays whose masks number objects otherwise than its rays do: by labels.

        ArgumentError: an instance id is not the object's label, its rank among the names in sorted order.
        """
        if not self.capabilities.traces:
            return
        table = self.objects()
        for name, number in table.ids.items():
            label = table.label(name)
            if number != label:
                expected = (
                    "expected ids that count the names in sorted order from 1 of a source that traces rays"
                )
                raise ArgumentError(
                    f"source: {expected}, got {number} for {shown(name)}, whose label is {label}"
                )

    def stated(self, capture: Capture) -> Capture:
        """Return one of its captures with what the capabilities say of it in its provenance."""
        can = self.capabilities
        if capture.mode == "lit" and can.transfer != "unknown":
            return replace(capture, provenance={**capture.provenance, "transfer": can.transfer})
        if capture.mode == "depth" and any(can.depth_error):
            return replace(capture, provenance={**capture.provenance, "depth_error": list(can.depth_error)})
        return capture

    def trace(self, origins_w: Array, directions_w: Array) -> Traced:
        """Return what rays meet, exactly.

        Args:
            origins_w: (..., 3) metres, world frame; or (3,), of all rays.
            directions_w: (..., 3) unit vectors, world frame.

        Raises:
            ArgumentError: :attr:`Capabilities.traces` is False.
        """
        raise ArgumentError(f"source: expected one that traces rays, got {type(self).__name__}")

    def shade(self, origins_w: Array, directions_w: Array) -> NDArray[np.float32]:
        """Return the colours of what rays meet: those that :meth:`capture` shows, before rounding.

        The image's sensor and its mean over several rays act on them, so nothing is clipped or filtered.

        Args:
            origins_w: (N, 3) metres, world frame; or (3,), of all rays.
            directions_w: (N, 3) unit vectors, world frame.

        Returns:
            (N, 3) float32, RGB, where 1 is what an 8-bit capture shows as 255: linear light if
            :attr:`Capabilities.transfer` is ``linear``, else codes of that transfer. The sky has colours,
            too.

        Raises:
            ArgumentError: :attr:`Capabilities.shades` is False.
        """
        raise ArgumentError(f"source: expected one that shades rays, got {type(self).__name__}")

    def cover(self, view: View) -> tuple[View, ...]:
        """Return the views to request so that their captures together cover ``view``; the view itself first.

        There are several where the source captures some views with another orientation than requested.
        """
        return (view,)

    def recorded_views(self) -> tuple[View, ...] | None:
        """Return the views that can be replayed; None for a source that makes new captures."""
        return None

    def recorded_in(self, mode: str) -> tuple[View, ...]:
        """Return those of :meth:`recorded_views` that can be replayed in a mode; all, if not overridden."""
        return self.recorded_views() or ()

    def recorded(self) -> RecordedViews | None:
        """Return the index of :meth:`recorded_views`; None for a source that makes new captures."""
        views = self.recorded_views()
        return None if views is None else RecordedViews(views, self.recorded_in)

    @property
    def scene_identity(self) -> SceneIdentity:
        """The scene: a recording holds captures of one scene only."""
        return SceneIdentity()

    @property
    def world_digest(self) -> str:
        """A digest of all that the world shows; empty where a source cannot tell, as a live engine."""
        return self.scene_identity.content

    @property
    def recorded_origin(self) -> Mapping[str, Any] | None:
        """What a recording's captures are of (:mod:`omniscv.sources.described`); None where it is not known,
        and of a source that makes new captures."""
        return None

    def geometry(self) -> SceneGeometry:
        """Return what is known of the shapes in the scene; empty for sources of pictures only."""
        return SceneGeometry()

    def poses(self, objects: Collection[str] | None = None) -> Mapping[str, Pose]:
        """Return the poses of objects at this source's instant, ``R_w_o`` and position; of those that are
        known. Without names, of those that are known to move.
        """
        return self.instant.poses if objects is None else {}

    def own_poses(self, time_s: float) -> Mapping[str, Pose] | None:
        """Return the poses, at a time of the scene's own clock, of objects that move by themselves.

        None where the source cannot tell. By default nothing moves, unless captures may show motion.
        """
        return None if self.capabilities.moves else {}

    def own_views(self) -> Mapping[str, View]:
        """Return the views of the cameras that the scene itself has, by name, at this source's instant; by
        default none."""
        return {}

    def variable(self, kind: str) -> Mapping[str, Mapping[str, int]]:
        """Return what can be varied of ``objects``, ``lights`` or ``materials``: by name, the settings, and
        how many numbers each has. An object that cannot be moved can only be ``shown``.
        """
        if kind != "objects":
            return {}
        return dict.fromkeys(self.objects().names(), OBJECT_SETTINGS)

    def without(self, objects: Iterable[str]) -> Source:
        """Return a source of the same scene with objects hidden, to be closed before this one is used again.

        Raises ArgumentError if this source cannot hide objects, or has no object of a name.
        """
        raise ArgumentError(f"source: expected one that can hide objects, got {type(self).__name__}")

    @property
    def state(self) -> str:
        """The state of the world that captures show; empty while the world is unchanged."""
        return self.instant.state

    @property
    def instant(self) -> Instant:
        """What was set in the world that captures show, or read from it."""
        return Instant()

    def at(self, instant: Instant) -> Source:
        """Return a source of the same world at an instant; it is closed before this source is used again.

        A live source sets the world so, and closing puts it back; a recording replays what was captured then.

        Raises:
            ArgumentError: this source cannot move objects, or has no object of a name.
            RecordingError: a recording holds nothing of that state.
        """
        if instant.state == "":
            return SourceView(self)
        raise ArgumentError(f"source: expected one whose objects can be moved, got {type(self).__name__}")

    def one_instant(self) -> AbstractContextManager[None]:
        """Return a context for captures of one instant: a recording keeps all, or none after an error."""
        return nullcontext()

    def command(self, text: str) -> str:
        """Send a command of the server's own language, and return its reply.

        Raises ArgumentError if this is no live server, SourceError for an error, or no reply within the
        deadlines.
        """
        expected = f"expected a live server to send {shown(text)} to"
        raise ArgumentError(f"source: {expected}, got {type(self).__name__}")

    @property
    def world(self) -> World:
        """The running world behind a live source; ArgumentError for other sources."""
        expected = "expected a live server, whose world can be changed"
        raise ArgumentError(f"source: {expected}, got {type(self).__name__}")

    def share_exposure(self, shared: SharedExposure) -> None:  # noqa: B027 - most sources set none
        """Use an exposure that other sources use, too, where cameras find the one that matches the game's."""

    def close(self) -> None:  # noqa: B027 - most sources hold nothing
        """Release connections, files and memory."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _forwarded(method: F) -> F:
    """Return a method of a wrapper that calls the wrapped source's."""
    name = method.__name__
    return cast(F, lambda wrapper, *args, **options: getattr(wrapper._source, name)(*args, **options))


def _attribute(name: str) -> Any:
    """Return a property of a wrapper: the wrapped source's."""
    return property(attrgetter(f"_source.{name}"))


class SourceWrapper(Source):
    """A source around another one, which is closed with it; subclasses override what they change.

    Those that change captures override :meth:`around`, which wraps the source elsewhere in the same way.
    """

    def __init__(self, source: Source) -> None:
        self._source = source

    capabilities = _attribute("capabilities")
    scene_identity = _attribute("scene_identity")
    world_digest = _attribute("world_digest")
    recorded_origin = _attribute("recorded_origin")
    state = _attribute("state")
    instant = _attribute("instant")
    world = _attribute("world")
    capture = _forwarded(Source.capture)
    trace = _forwarded(Source.trace)
    shade = _forwarded(Source.shade)
    objects = _forwarded(Source.objects)
    geometry = _forwarded(Source.geometry)
    cover = _forwarded(Source.cover)
    variable = _forwarded(Source.variable)
    poses = _forwarded(Source.poses)
    own_poses = _forwarded(Source.own_poses)
    own_views = _forwarded(Source.own_views)
    recorded_views = _forwarded(Source.recorded_views)
    recorded_in = _forwarded(Source.recorded_in)
    recorded = _forwarded(Source.recorded)
    command = _forwarded(Source.command)
    one_instant = _forwarded(Source.one_instant)
    share_exposure = _forwarded(Source.share_exposure)
    close = _forwarded(Source.close)

    def around(self, source: Source) -> Source:
        """Return a source of the same world, wrapped as this one's is; as it is, if not overridden."""
        return source

    def without(self, objects: Iterable[str]) -> Source:
        return self.around(self._source.without(objects))

    def at(self, instant: Instant) -> Source:
        return self.around(self._source.at(instant))


class CapturesAlone(SourceWrapper):
    """A source whose rays are not used: images take all from captures, as from an engine."""

    @property
    def capabilities(self) -> Capabilities:
        return replace(self._source.capabilities, traces=False, shades=False)

    def around(self, source: Source) -> Source:
        return CapturesAlone(source)


class SourceView(SourceWrapper):
    """A source that stays open when this is closed; ``undo`` is called then."""

    def __init__(self, source: Source, undo: Callable[[], None] = lambda: None) -> None:
        super().__init__(source)
        self._undo = undo

    def close(self) -> None:
        self._undo()


class ProcessBound(SourceWrapper):
    """A live source in the process that opened it; other processes cannot use, pickle or close it.

    ``address`` is for messages; ``host`` is what was started for the source alone, such as a game, and ends
    with it.
    """

    def __init__(self, source: Source, address: str, host: ExitStack | None = None) -> None:
        self._opened = source
        self._address = address
        self._process = os.getpid()
        self._host = host or ExitStack()

    def __repr__(self) -> str:
        return repr(self._opened)

    @property
    def _source(self) -> Source:  # type: ignore[override]
        if self._process != os.getpid():
            expected = "expected to be used by the process that opened it, got a fork of that process"
            raise SourceError(f"{self._address}: {expected}; open it again there")
        return self._opened

    def around(self, source: Source) -> Source:
        return ProcessBound(source, self._address)

    def close(self) -> None:
        if self._process == os.getpid():
            with self._host:
                super().close()

    def __reduce__(self) -> NoReturn:
        raise not_picklable(self._address)


def closed_error(what: str) -> SourceError:
    """Return the error of a closed source that is used."""
    return SourceError(f"{what}: expected an open source, got a closed one; open it again")


def check_modes(source: Source, modes: Iterable[str]) -> None:
    """Raise ArgumentError for ``modes`` that a source does not deliver, before anything is captured.

    Of a modality that is captured as another one, the source must deliver the other.
    """
    offered = source.capabilities.modes
    lacking = []
    for mode in modes:
        captured = modalities.get(mode).captured_as or mode
        if captured not in offered:
            lacking.append(captured)
    if lacking:
        known = f"expected some of {', '.join(sorted(offered))}, which the source delivers"
        raise ArgumentError(f"modes: {known}; got {', '.join(lacking)}")


def known_objects(objects: Iterable[str], known: Collection[str], what: str) -> None:
    """Raise ArgumentError for names of ``objects`` that are not among the ``known`` ones of a scene.

    The message begins with ``what``.
    """
    if unknown := sorted(set(objects) - set(known)):
        name = unknown[0]
        names = sorted(known)
        advice = did_you_mean(name, names) or f"; it has {', '.join(names)}"
        raise ArgumentError(f"{what}: expected objects of the scene, got {shown(name)}{advice}")


def not_picklable(what: str) -> SourceError:
    """Return the error of a source with connections that is pickled, as for a spawned process."""
    expected = "expected a source that can be pickled, got one that holds connections"
    return SourceError(f"{what}: {expected}; open it in each process by its address")


def copy_with(source: S, **changes: object) -> S:
    """Return another source of the same class, which shares all but these attributes."""
    other = object.__new__(type(source))
    vars(other).update(vars(source), **changes)
    return other
