"""The live source: captures from a UE4/UE5 editor or packaged game, whatever its plugin speaks.

The dialect is found by probing: versions do not identify it (protocol reference, section 0).
"""

import contextlib
import functools
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from types import MappingProxyType
from typing import Literal

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, ServerRefusedError, SourceError
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
    known_objects,
)
from omniscv.sources.unreal.client import Client, Reply
from omniscv.sources.unreal.commands import LEVEL, VERSION
from omniscv.sources.unreal.connection import RETRIED, Connection
from omniscv.sources.unreal.driver import CameraDriver
from omniscv.sources.unreal.legacy import LegacyDriver
from omniscv.sources.unreal.mask_colors import colors, object_table
from omniscv.sources.unreal.modern import ModernDriver
from omniscv.sources.unreal.shapes import boxes
from omniscv.sources.unreal.stale_frames import SETTLED, StaleFrames

_BATCH = 24  # requests in flight at once: enough to hide latency, few enough to wait in memory
_BATCH_PX = 1 << 24  # pixels in flight at once; a larger picture is requested alone
# The starts of replies to commands that a dialect does not know.
_UNKNOWN = re.escape("error Can not find a handler for URI '")
_UNKNOWN_N2 = re.escape("error No handler found for URI '")


class UnrealSource(Source):
    """A connection, which is closed with this, a camera driver, and a detector of stale frames.

    After a fault the connection is made anew, the camera found and aimed again, and the captures that were
    in flight are requested again. A picture counts once it has the right id, signature, length and size, the
    reply behind it is in step, and it is no stale frame. Threads take turns, one exchange at a time.
    Too many faults in a row, or a server that refuses what is needed, raise a SourceError.
    """

    def __init__(self, connection: Connection, driver: CameraDriver) -> None:
        self._connection, self._driver = connection, driver
        self._stale_frames = StaleFrames(each_mode=driver.each_mode_lags)
        self._attached: Client | None = None
        self._closed = False
        self._hidden: list[str] = []
        self._lock = threading.RLock()
        self._client()

    @property
    def capabilities(self) -> Capabilities:
        return self._driver.capabilities

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._driver.scene_identity

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        batch: list[Request] = []
        for request in requests:
            request.check_state(self.state, self._connection.address)
            self._driver.check(request)
            pixels = sum(each.view.width * each.view.height for each in (*batch, request))
            if batch and (len(batch) == _BATCH or pixels > _BATCH_PX):
                yield from self._delivered(batch)
                batch = []
            batch.append(request)
        yield from self._delivered(batch)

    def objects(self) -> ObjectTable:
        with self._lock:
            self._check_open()
            return object_table(self._connection, self._driver.table.vertex_colors)

    def cover(self, view: View) -> tuple[View, ...]:
        return self._driver.cover(view)

    def geometry(self) -> SceneGeometry:
        """Boxes of the objects, read anew; none from plugin 0.3.10, which has no command for them."""
        with self._lock:
            self._check_open()
            names = colors(self._connection)
            return SceneGeometry(MappingProxyType(boxes(self._connection, list(names))))

    def without(self, objects: Iterable[str]) -> Source:
        """As :meth:`Source.without`; the game shows the objects again when either source is closed."""
        with self._lock:
            self._check_open()
            wanted = list(dict.fromkeys(objects))
            known_objects(wanted, colors(self._connection), self._connection.address)
            hiding = [name for name in wanted if name not in self._hidden]
            self._hidden += hiding
            try:
                self._set_visible("hide", hiding)
            except BaseException:
                with contextlib.suppress(SourceError):  # the fault that is raised came first
                    self._show(hiding)
                raise
            return HiddenObjects(self, functools.partial(self._show, hiding))

    def close(self) -> None:
        with self._lock:
            if not self._closed:
                with contextlib.suppress(SourceError):  # the game may have ended
                    self._show(self._hidden)
                self._closed = True
                self._driver.release()
                self._connection.close()

    def _set_visible(self, how: Literal["hide", "show"], objects: Iterable[str]) -> None:
        """Hide or show objects; frames from before are stale."""
        commands = [f"vset /object/{name}/{how}" for name in objects]
        for command, reply in zip(commands, self._connection.texts(commands), strict=True):
            if reply != "ok":
                expected = f"expected a server that answers {shown(command)} with ok"
                raise ServerRefusedError(f"{self._connection.address}: {expected}, got {shown(reply)}")
        if commands:
            self._stale_frames.reset()
            self._connection.texts([VERSION] * SETTLED)  # each reply is a frame later at least

    def _show(self, objects: Iterable[str]) -> None:
        with self._lock:
            gone = [name for name in objects if name in self._hidden]
            if gone and not self._closed:
                self._hidden = [name for name in self._hidden if name not in gone]
                self._set_visible("show", gone)

    def _check_open(self) -> None:
        if self._closed:
            raise closed_error(self._connection.address)

    def _client(self) -> Client:
        while self._attached is None or self._attached.broken:
            self._stale_frames.reset()
            self._driver.attach(self._stale_frames)
            self._attached = self._connection.client
        return self._attached

    def _delivered(self, batch: list[Request]) -> Iterator[Capture]:
        """Yield a batch's captures; those from before a fault are kept, and progress resets the retries."""
        fault: SourceError | None = None
        while batch:
            with self._lock:
                self._check_open()
                captures, fault = self._some(batch, fault)
            yield from captures
            batch = batch[len(captures) :]

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


class HiddenObjects(SourceWrapper):
    """A source in which objects are hidden; closing it shows them, and leaves the source open."""

    def __init__(self, source: Source, show: Callable[[], None]) -> None:
        super().__init__(source)
        self._show = show

    def close(self) -> None:
        self._show()


def connect(connection: Connection, fix_exposure: bool = False) -> UnrealSource:
    """Return a server as a source, whatever its dialect; the connection is closed with it.

    The connection that probes the dialect is the one that is used: some servers serve only one (protocol
    reference, section 1.2). ``fix_exposure`` switches vignette and auto exposure off in the running game.
    """
    try:
        return UnrealSource(connection, open_driver(connection, fix_exposure))
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
