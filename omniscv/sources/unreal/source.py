"""The live source: captures from a UE4/UE5 editor or packaged game, whatever the dialect of its plugin."""

from __future__ import annotations

import contextlib
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import accumulate, groupby
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

from omniscv.errors import (
    MisplacedCameraError,
    SceneChangedError,
    ServerConnectionError,
    ServerRefusedError,
    SourceError,
)
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import (
    STATIC_SETTINGS,
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    SourceView,
    View,
    closed_error,
)
from omniscv.sources.scene import room_of
from omniscv.sources.unreal.client import RETRIED, Client, Connection
from omniscv.sources.unreal.driver import SPAWNED, CameraDriver, CameraOptions
from omniscv.sources.unreal.instants import Journal, movable_objects, object_poses
from omniscv.sources.unreal.legacy import LegacyDriver
from omniscv.sources.unreal.modern import ModernDriver
from omniscv.sources.unreal.motionless import Unmoved
from omniscv.sources.unreal.objects import boxes, colors, object_table
from omniscv.sources.unreal.protocol import EXPOSURE_METHOD, checked
from omniscv.sources.unreal.world import UnrealWorld
from omniscv.sources.world import Freeze, SharedExposure, World

if TYPE_CHECKING:
    from mock_server import Scene

T = TypeVar("T")

_TURN_REQUESTS = 96  # of a turn, at least: enough to hide latency, few enough for others to wait for
_IN_FLIGHT_PX = 1 << 24  # pixels that are requested together; a larger picture is requested alone
_TURN_PX = 1 << 27  # pixels of a turn, all of which are held in memory
_MOST_CONNECTIONS = 100  # that break one after the other before the camera is attached


class UnrealSource(Source):
    """Captures by a camera driver over a connection, which is closed with this source.

    After a fault the connection is opened anew, the camera is found and aimed again, and the captures that
    were in flight are requested again. A picture counts once it has the right id, signature, length and size,
    the next reply is in step, and it is no stale frame. Threads take turns: one captures a viewpoint, or
    sends commands that belong together.
    """

    def __init__(
        self,
        connection: Connection,
        driver: CameraDriver,
        freeze: Freeze | None = None,
        scene: Scene | None = None,
    ) -> None:
        self._connection = connection
        self._driver = driver
        self._room = None if scene is None else room_of(scene)
        self._digest = "" if scene is None else scene.digest()
        self._journal = Journal(connection.address)
        self._unmoved = Unmoved(connection.address)
        self._world = UnrealWorld(driver, self._journal, freeze or "auto")
        self._moves = freeze is not None or (scene is not None and bool(scene.moving))
        self._driver.one_tick = self._world.freeze == "batch"
        self._attached: Client | None = None
        self._client()

    @property
    def capabilities(self) -> Capabilities:
        """Those of the driver; the world moves where it was changed, or is to be frozen."""
        return replace(self._driver.capabilities, moves=self._moves or self.state != "")

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._driver.scene_identity

    @property
    def world_digest(self) -> str:
        """That of the mock server's scene; an engine cannot tell."""
        return self._digest

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for turn in turns(requests, self._driver.check, alone=self._driver.one_tick):
            yield from self._captures_of_turn(turn)

    def objects(self) -> ObjectTable:
        with self._journal.turn():
            return self._steady(lambda: object_table(self._connection, self._driver.table.vertex_colors))

    def cover(self, view: View) -> tuple[View, ...]:
        return self._driver.cover(view)

    def geometry(self) -> SceneGeometry:
        """Boxes of the objects, read anew; none of plugin 0.3.10. The room is the mock scene's."""
        with self._journal.turn():
            known = self._steady(lambda: boxes(self._connection, list(colors(self._connection))))
            return SceneGeometry(MappingProxyType(known), self._room)

    def without(self, objects: Iterable[str]) -> Source:
        """As :meth:`Source.without`; the game shows the objects again when either source is closed."""
        with self._journal.turn():
            names = list(dict.fromkeys(objects))
            self._world.check(names)
            return self._changed(lambda: self._world.hide_all(names, "left out"))

    @property
    def instant(self) -> Instant:
        return self._journal.instant

    def at(self, instant: Instant) -> Source:
        """As :meth:`Source.at`; the option ``freeze`` decides how the world is kept at the instant."""
        with self._journal.turn():
            return self._changed(lambda: self._world.set_instant(instant))

    def poses(self, objects: Collection[str] | None = None) -> Mapping[str, Pose]:
        if objects is None:
            return {**self.instant.poses, **self._journal.named("drawn")}
        with self._journal.turn():
            return object_poses(self._connection, objects)

    def variable(self, kind: str) -> Mapping[str, Mapping[str, int]]:
        settings = dict(super().variable(kind))
        with self._journal.turn():
            movable = set(movable_objects(self._connection)) if settings else set()
        for name in settings:
            if name not in movable:
                settings[name] = STATIC_SETTINGS
        return settings

    def command(self, text: str) -> str:
        """Send a command of the plugin, and return its reply; of a binary one, its size and format.

        It is sent between the captures of two viewpoints, and after a fault again only where that is
        harmless. One that may change the world gives it another state, which is not put back. Raises
        ArgumentError for no single line, or ``vbatch``, whose reply depends on what follows,
        ServerRefusedError for an error.
        """
        return self._world.send(checked(text))

    @property
    def world(self) -> World:
        return self._world

    def share_exposure(self, shared: SharedExposure) -> None:
        self._driver.shared_exposure = shared

    def close(self) -> None:
        """As :meth:`Source.close`; changes that are still in force are put back first."""
        with self._journal.lock:
            if not self._journal.closed:
                with contextlib.suppress(*RETRIED, SceneChangedError):  # the game may have ended
                    for layer in reversed(self._journal.layers):
                        with contextlib.suppress(ServerRefusedError):
                            self._world.put_back(layer)
                self._journal.closed = True
                self._driver.release()
                self._connection.close()

    def _changed(self, change: Callable[[], None]) -> Source:
        """Return this source, with a change of the world until it is closed."""
        layer = self._journal.open()
        try:
            change()
            if layer:
                self._driver.settle()
        except BaseException:
            with contextlib.suppress(SourceError):  # the first fault is the one to raise
                self._world.put_back(layer)
            raise
        return SourceView(self, partial(self._world.put_back, layer))

    def _client(self) -> Client:
        """Return a working client, with the camera attached and the world as it was set."""
        for _ in range(_MOST_CONNECTIONS):
            if self._attached is not None and not self._attached.broken:
                return self._attached
            self._driver.stale_frames.reset()
            spawned = self._driver.spawned
            self._driver.attach()
            client = self._connection.client  # a game that has started again since is attached anew
            if self._driver.spawned != spawned or self._attached is None:
                self._driver.verify()
            if self._attached is not None and self._driver.spawned != spawned:
                self._world.check_lost()
            self._world.set_again()
            self._attached = client
        raise self._unsteady()

    def _steady(self, read: Callable[[], T]) -> T:
        """Return what is read over one connection: a game that restarts in between has other mask colours."""
        for _ in range(_MOST_CONNECTIONS):
            client = self._client()
            result = read()
            self._connection.check_scene()
            if client is self._connection.client:
                return result
        raise self._unsteady()

    def _unsteady(self) -> ServerConnectionError:
        expected = f"{self._connection.address}: expected a connection that lasts"
        actual = f"{_MOST_CONNECTIONS} in a row that broke"
        return ServerConnectionError(f"{expected}, got {actual}; is the game restarting?")

    def _captures_of_turn(self, requests: list[Request]) -> Iterator[Capture]:
        """Yield a turn's captures; those from before a fault are kept, and progress resets the retries."""
        captures: list[Capture] = []
        try:
            with self._journal.turn(), self._connection.attempts() as attempted:
                state = self.state  # which does not change within a turn
                for request in requests:
                    request.check_state(state, self._connection.address)
                while left := requests[len(captures) :]:
                    fault: SourceError | None = None
                    batch = left if self._driver.one_tick else in_flight(left)
                    client = self._client()
                    try:
                        self._driver.expose(batch)
                        for capture in self._driver.collect(client, batch):
                            captures.append(capture)
                    except RETRIED as cause:
                        fault = cause
                    if len(captures) > len(requests) - len(left):  # progress: retries are counted anew
                        attempted(None)
                    if fault is not None and len(captures) < len(requests):
                        attempted(fault)
                self._driver.check_scene()  # the level may change behind the same connection
            self._unmoved.check(captures)
        except (SceneChangedError, MisplacedCameraError):
            raise  # which captures of this turn show the other scene, or place, is not known
        except SourceError as last:
            yield from captures
            raise last
        for capture in captures:
            if self._journal.closed:
                raise closed_error(self._connection.address)
            yield capture


def turns(
    requests: Iterable[Request], check: Callable[[Request], None], alone: bool
) -> Iterator[list[Request]]:
    """Yield requests in turns, between which the world may be changed; raise what ``check`` raises for one.

    A turn has whole viewpoints, consecutive requests from one optical centre. Small ones share a turn, unless
    each is ``alone``; one with more pixels than memory should hold is divided.
    """
    turn: list[Request] = []
    pixels = 0
    for _, viewpoint in groupby(requests, lambda request: request.view.key().position):
        for request in viewpoint:
            check(request)
            if turn and not alone and pixels + _pixels(request) > _TURN_PX:
                yield turn
                turn = []
                pixels = 0
            turn.append(request)
            pixels += _pixels(request)
        if alone or len(turn) >= _TURN_REQUESTS or pixels >= _IN_FLIGHT_PX:
            yield turn
            turn = []
            pixels = 0
    if turn:
        yield turn


def in_flight(requests: Sequence[Request]) -> list[Request]:
    """Return the first of some requests, as many as are sent together: one at least, and equal shares."""
    pixels = list(accumulate(map(_pixels, requests)))
    share = pixels[-1] / -(-pixels[-1] // _IN_FLIGHT_PX)
    return list(requests[: max(1, bisect_right(pixels, share))])


def _pixels(request: Request) -> int:
    return request.view.width * request.view.height


def connect(
    connection: Connection,
    options: CameraOptions = SPAWNED,
    freeze: Freeze | None = None,
    scene: Scene | None = None,
) -> UnrealSource:
    """Return a server as a source, whatever its dialect.

    Args:
        connection: to the server; it is closed with the source.
        options: how the camera is exposed.
        freeze: how the world is kept at an instant; None if it is not said, and the world may stand still.
        scene: the mock server's: its room is known, and whether it has objects that move by themselves.
    """
    try:
        return UnrealSource(connection, open_driver(connection, options), freeze, scene)
    except BaseException:
        connection.close()
        raise


def open_driver(connection: Connection, options: CameraOptions = SPAWNED) -> CameraDriver:
    """Return the camera driver of the server of a ``connection``, not yet attached.

    Raises:
        ServerRefusedError: the server lacks what the ``options`` ask for.
    """
    if options.exposure not in (None, "game") and not connection.supports(EXPOSURE_METHOD):
        expected = "expected a server that sets the exposure of one camera (N2 or later)"
        actual = f"dialect {connection.plugin.dialect}"
        raise ServerRefusedError(f"{connection.address}: {expected}, got {actual}; use fix_exposure")
    if connection.plugin.dialect != "0.3.10":
        return ModernDriver(connection, options)
    return LegacyDriver(connection, options)
