"""The live source: captures from a UE4/UE5 editor or packaged game, whatever its plugin speaks.

The dialect is found by probing: versions do not identify it (protocol reference, section 0).
"""

import contextlib
import functools
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from types import MappingProxyType

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, ServerRefusedError, SourceError
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    SourceWrapper,
    View,
    closed_error,
)
from omniscv.sources.unreal.client import Client, Reply
from omniscv.sources.unreal.commands import LEVEL
from omniscv.sources.unreal.connection import RETRIED, Connection
from omniscv.sources.unreal.driver import CameraDriver
from omniscv.sources.unreal.exchange import Exchange
from omniscv.sources.unreal.freezing import Freezing
from omniscv.sources.unreal.journal import Journal
from omniscv.sources.unreal.legacy import LegacyDriver
from omniscv.sources.unreal.mask_colors import colors, object_table
from omniscv.sources.unreal.modern import ModernDriver
from omniscv.sources.unreal.placing import Placing
from omniscv.sources.unreal.putting_back import put_back
from omniscv.sources.unreal.shapes import boxes
from omniscv.sources.unreal.stale_frames import StaleFrames
from omniscv.sources.unreal.turns import in_flight, turns
from omniscv.sources.unreal.world import UnrealWorld
from omniscv.sources.unreal.world_commands import checked
from omniscv.sources.world import Freeze, World

# The starts of replies to commands that a dialect does not know.
_UNKNOWN = re.escape("error Can not find a handler for URI '")
_UNKNOWN_N2 = re.escape("error No handler found for URI '")


class UnrealSource(Source):
    """A connection, which is closed with this, a camera driver, and a detector of stale frames.

    After a fault the connection is made anew, the camera found and aimed again, and the captures that were
    in flight are requested again. A picture counts once it has the right id, signature, length and size, the
    reply behind it is in step, and it is no stale frame. Threads take turns: the captures of a viewpoint, or
    commands that belong together. Too many faults in a row, or a server that refuses what is needed, raise a
    SourceError.
    """

    def __init__(self, connection: Connection, driver: CameraDriver, freeze: Freeze | None = None) -> None:
        self._connection, self._driver = connection, driver
        self._stale_frames = StaleFrames(each_mode=driver.each_mode_lags)
        self._exchange = Exchange(connection, driver, self._stale_frames)
        self._journal = Journal()
        self._world = UnrealWorld(self._exchange, self._journal, self._renew_camera)
        self._placing = Placing(self._exchange, self._journal)
        self._freezing = Freezing(self._exchange, self._journal, self._world, freeze or "auto")
        self._moves = freeze is not None
        self._driver.one_tick = self._freezing.how == "batch"
        self._attached: Client | None = None
        self._client()

    @property
    def capabilities(self) -> Capabilities:
        """Those of the driver; the world moves where it is changed, or is to be frozen."""
        return replace(self._driver.capabilities, moves=self._moves or self.state != "")

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._driver.scene_identity

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for turn in turns(requests, self._driver.check, alone=self._driver.one_tick):
            yield from self._delivered(turn)

    def objects(self) -> ObjectTable:
        with self._exchange.turn():
            return object_table(self._connection, self._driver.table.vertex_colors)

    def cover(self, view: View) -> tuple[View, ...]:
        return self._driver.cover(view)

    def geometry(self) -> SceneGeometry:
        """Boxes of the objects, read anew; none from plugin 0.3.10, which has no command for them."""
        with self._exchange.turn():
            names = colors(self._connection)
            return SceneGeometry(MappingProxyType(boxes(self._connection, list(names))))

    def without(self, objects: Iterable[str]) -> Source:
        """As :meth:`Source.without`; the game shows the objects again when either source is closed."""
        with self._exchange.turn():
            wanted = list(dict.fromkeys(objects))
            self._placing.check(wanted)
            return self._changed(lambda: self._placing.hide(wanted, "left out"))

    @property
    def instant(self) -> Instant:
        return self._journal.instant

    @property
    def state(self) -> str:
        return self._journal.instant.state

    def at(self, instant: Instant) -> Source:
        """As :meth:`Source.at`; the option ``freeze`` decides how the world is kept there."""
        with self._exchange.turn():
            return self._changed(lambda: self._freezing.set(instant))

    def command(self, text: str) -> str:
        """Send a command of the plugin, and return its reply; of a binary one, its size and kind.

        It is sent between the captures of two viewpoints, and after a fault again only where that is
        harmless. One that may change the world gives it another state, which is not put back.

        Raises:
            ArgumentError: no single line, or ``vbatch``, whose reply depends on what follows.
            ServerRefusedError: the reply is an error.
        """
        return self._world.send(checked(text))

    @property
    def world(self) -> World:
        return self._world

    def close(self) -> None:
        """As :meth:`Source.close`; what is to be put back at an end that has not come is put back first."""
        with self._exchange.lock:
            if not self._exchange.closed:
                with contextlib.suppress(*RETRIED):  # the game may have ended
                    for layer in reversed(self._journal.layers):
                        with contextlib.suppress(ServerRefusedError):
                            put_back(self._exchange, self._journal, layer)
                self._exchange.closed = True
                self._driver.release()
                self._connection.close()

    def _changed(self, change: Callable[[], None]) -> Source:
        """Return this source, with a change of the world until it is closed."""
        layer = self._journal.open()
        undo = functools.partial(put_back, self._exchange, self._journal, layer)
        try:
            change()
            if layer:
                self._exchange.settle()
        except BaseException:
            with contextlib.suppress(SourceError):  # the fault that is raised came first
                undo()
            raise
        return ChangedSource(self, undo)

    def _renew_camera(self) -> None:
        self._driver.renew()
        self._attached = None
        self._client()

    def _client(self) -> Client:
        while self._attached is None or self._attached.broken:
            self._stale_frames.reset()
            spawned = self._driver.spawned
            self._driver.attach(self._stale_frames)
            if self._attached is not None and self._driver.spawned != spawned:
                self._world.check_lost()
            self._world.set_again()
            self._attached = self._connection.client
        return self._attached

    def _delivered(self, requests: list[Request]) -> Iterator[Capture]:
        """Yield a turn's captures; those from before a fault are kept, and progress resets the retries."""
        captures: list[Capture] = []
        fault: SourceError | None = None
        try:
            with self._exchange.turn():
                state = self.state  # which does not change within a turn
                for request in requests:
                    request.check_state(state, self._connection.address)
                while len(captures) < len(requests):
                    left = requests[len(captures) :]
                    some, fault = self._some(left if self._driver.one_tick else in_flight(left), fault)
                    captures += some
        except SourceError as last:
            yield from captures
            raise last
        for capture in captures:
            if self._exchange.closed:
                raise closed_error(self._connection.address)
            yield capture

    def _some(
        self, batch: list[Request], fault: SourceError | None
    ) -> tuple[list[Capture], SourceError | None]:
        """Return captures of the first requests, one at least, and the fault that came after them.

        A fault from before is recovered from first.
        """
        with self._connection.attempts() as attempted:
            while True:
                if fault is not None:
                    attempted(fault)
                captures: list[Capture] = []
                client, fault = self._client(), None
                try:
                    for capture in self._driver.collect(client, batch, self._stale_frames):
                        captures.append(capture)
                except RETRIED as cause:
                    fault = cause
                if captures or fault is None:
                    return captures, fault


class ChangedSource(SourceWrapper):
    """A source whose world is changed; closing it puts that back, and leaves the source open."""

    def __init__(self, source: Source, undo: Callable[[], None]) -> None:
        super().__init__(source)
        self._undo = undo

    def close(self) -> None:
        self._undo()


def connect(connection: Connection, fix_exposure: bool = False, freeze: Freeze | None = None) -> UnrealSource:
    """Return a server as a source, whatever its dialect; the connection is closed with it.

    The connection that probes the dialect is the one that is used: some servers serve only one (protocol
    reference, section 1.2). ``fix_exposure`` switches vignette and auto exposure off in the running game.
    """
    try:
        return UnrealSource(connection, open_driver(connection, fix_exposure), freeze)
    except BaseException:
        connection.close()
        raise


def open_driver(connection: Connection, fix_exposure: bool = False) -> CameraDriver:
    """Return the camera driver for a server's dialect, not yet attached; BadReplyError for an unknown one.

    N2 has error texts of its own for unknown commands; only 0.3.10 knows the field of view by this name; M
    does not know the level's name.
    """
    number = r"\d+\.\d+$"
    if _form(connection, "vget /omniscv", _UNKNOWN, _UNKNOWN_N2) == _UNKNOWN_N2:
        dialect = "N2"
    elif _form(connection, "vget /camera/0/horizontal_fieldofview", _UNKNOWN, number) == number:
        return LegacyDriver(connection, "0.3.10", fix_exposure)
    else:
        dialect = "M" if _form(connection, LEVEL, _UNKNOWN, "") == _UNKNOWN else "N1"
    return ModernDriver(connection, dialect, fix_exposure)


def _form(connection: Connection, command: str, *forms: str) -> str:
    """Return which of some patterns, the first that fits, the reply to a command begins with."""

    def match(command: str, reply: Reply) -> str:
        for form in forms:
            if isinstance(reply, str) and re.match(form, reply, re.ASCII):
                return form
        expected = f"expected plugin 0.3.10 or 1.x to answer {command!r}"
        raise BadReplyError(f"{connection.address}: {expected}, got {shown(reply[:100])}")

    (found,) = connection.read([command], match)
    return found
