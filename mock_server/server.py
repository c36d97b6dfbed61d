"""The server: one client at a time, as in the plugin; in each frame all received requests are answered."""

import contextlib
import itertools
import queue
import select
import socket
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np

from mock_server.dialects import BY_NAME
from mock_server.dialects.common import Dialect, Later, OutputFolder
from mock_server.faults import Faults
from mock_server.protocol import FrameError, Transport, read_frame
from mock_server.scene import Scene, load_scene
from mock_server.settings import DialectName, Settings
from mock_server.world import World

Request = tuple[float, bytes]
"""Time of arrival (seconds, monotonic) and payload."""

MAX_WAITING = 1 << 25
"""The most bytes of one client's waiting requests, with ``_OVERHEAD`` for each."""

PATIENCE_S = 10.0
"""How long a client may be silent within a request, and before its first one if another client waits."""

_OVERHEAD = 256  # bytes of memory per request beside its text
_MAX_TEXTS = 100_000
_MAX_TEXT = 200

_GRACE_S = 0.5
_STOP_S = 1.0
"""Seconds that a stopping server waits for a reply to be sent, and for an image to be traced."""

_BACKLOG = 1
_POLL_S = 0.02
_SILENT_S = 0.2


class Requests:
    """The waiting requests of one client."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Request | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._waiting = 0

    def put(self, payload: bytes) -> bool:
        """Add a request; return False if too many wait."""
        with self._lock:
            self._waiting += len(payload) + _OVERHEAD
            if self._waiting > MAX_WAITING:
                return False
        self._queue.put((time.monotonic(), payload))
        return True

    def end(self) -> None:
        """Mark the end of the requests: the client has left."""
        self._queue.put(None)

    def get(self, timeout_s: float) -> Request | None:
        """Return the next request, None at the end; raise queue.Empty if none comes in time."""
        return self._queue.get(timeout=timeout_s) if timeout_s else self._queue.get_nowait()

    def answered(self, payload: bytes) -> None:
        """Forget a request."""
        with self._lock:
            self._waiting -= len(payload) + _OVERHEAD


class Statistics:
    """Counts of received commands, by the starts of their texts; beyond ``_MAX_TEXTS``, by their verbs."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def add(self, text: str) -> None:
        """Count a command."""
        text = text[:_MAX_TEXT]
        known = len(self.counts) < _MAX_TEXTS or text in self.counts
        self.counts[text if known else text.partition(" ")[0][:5]] += 1

    def total(self, start: str) -> int:
        """Return how many commands began with ``start``."""
        total = 0
        for text, count in self.counts.items():
            if text.startswith(start):
                total += count
        return total


class Server:
    """A scene behind the UnrealCV protocol. A context manager; ``stop`` ends it.

    A frame of the engine ends when all received requests are answered, and at the frame rate while there are
    none: poses lag as with an engine, without its waiting times. A client that does not read its replies is
    dropped when ``MAX_WAITING`` bytes of requests wait; one that does not end a request that it has begun, or
    sends none at all while another client waits, after ``PATIENCE_S``. The plugin waits for ever.

    Attributes:
        scene, settings: of the constructor; the scene loaded.
        host, port: where it listens.
        faults: active faults; they can be started and stopped while the server runs.
        statistics: counts of the commands received.
        fault: why it has ended by itself; empty if it has not.

    Raises:
        ValueError: an unknown scene or fault.
        OSError: the address cannot be listened on.
    """

    def __init__(self, scene: Scene | str | Path, settings: Settings) -> None:
        self.scene: Scene = scene if hasattr(scene, "view") else load_scene(scene)  # type: ignore[assignment]
        self.statistics = Statistics()
        self.faults = Faults(settings.faults, settings.seed)
        self.settings = settings
        self.fault = ""
        if isinstance(self.scene, Scene):  # another renderer has no kernels of ours
            _prepare(self.scene)
        world = World(self.scene, settings, self.faults)
        self._tcp = socket.create_server((settings.host, settings.port), backlog=_BACKLOG)
        self._listener: socket.socket = self._tcp
        self.host, self.port = self._tcp.getsockname()[:2]
        self._files = OutputFolder(settings.folder, settings.files == "anywhere")
        self._dialect = BY_NAME[settings.dialect](world, settings, self.port, self._files)
        self._stopping = threading.Event()
        self._connection: socket.socket | None = None
        self._thread = threading.Thread(target=self._listen, name="mock-unrealcv", daemon=True)
        self._thread.start()

    @property
    def world(self) -> World:
        """Cameras and objects of the level that is open."""
        return self._dialect.world

    def open_level(self, name: str) -> None:
        """Open another scene of this package in the next frame, as ``vset /action/game/level`` does."""
        self._dialect.open_level(name)

    @property
    def uri(self) -> str:
        """The address that ``omniscv.open_source`` takes."""
        return f"unreal://{self.host}:{self.port}"

    @property
    def unix_path(self) -> Path:
        """The path of the Unix socket, once the server has left TCP (protocol reference, section 1.2)."""
        return Path(f"/tmp/unrealcv_{self.port}.socket")

    @property
    def running(self) -> bool:
        """Whether it serves; ``fault`` says why it ended by itself."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Disconnect the client and end, within two seconds; may be called twice.

        The tracing of a large image ends in the background.
        """
        self._stopping.set()
        self._thread.join(_GRACE_S)
        if self._connection is not None:  # the client may have stopped reading
            with contextlib.suppress(OSError):
                self._connection.shutdown(socket.SHUT_RDWR)
        self._tcp.close()
        self._thread.join(_STOP_S)
        self._files.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _listen(self) -> None:
        try:
            for connection in self._clients():
                self._dialect.on_unix = connection.family != socket.AF_INET
                with connection:
                    self._connection = connection
                    self._serve(connection)
        except OSError as cause:
            if not self._stopping.is_set():
                self.fault = f"expected to go on listening; {cause}"

    def _clients(self) -> Iterator[socket.socket]:
        """Yield one client after another; others wait in the system's queue without a greeting."""
        with contextlib.ExitStack() as opened:
            listener = self._listener = opened.enter_context(self._tcp)
            while not self._stopping.is_set():
                listener.settimeout(_POLL_S)
                try:
                    connection, _ = listener.accept()
                except (TimeoutError, ConnectionAbortedError):
                    continue
                with contextlib.suppress(OSError):  # a Unix socket, or the client has left
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                yield connection
                # Plugin 1.0 on Linux never listens on TCP again: later TCP clients wait for ever.
                has_unix = self.settings.platform == "linux" and sys.platform != "win32"
                if listener is self._tcp and has_unix and self._dialect.has_unix:
                    listener = self._listener = opened.enter_context(self._unix_listener())
                    opened.callback(self.unix_path.unlink, missing_ok=True)

    def _unix_listener(self) -> socket.socket:
        bound = self.unix_path.with_suffix(".bound")
        bound.unlink(missing_ok=True)
        listener = socket.socket(socket.AF_UNIX)  # type: ignore[attr-defined,unused-ignore]
        try:
            listener.bind(str(bound))
            listener.listen(_BACKLOG)
            bound.replace(self.unix_path)  # visible only when it accepts clients
        except OSError as cause:
            listener.close()
            raise OSError(f"{self.unix_path}: {cause.strerror}") from cause
        return listener

    def _serve(self, connection: socket.socket) -> None:
        """Answer one client until it leaves; another thread reads its requests."""
        requests = Requests()
        reader = threading.Thread(target=self._read, args=(connection, requests), daemon=True)
        transport = Transport(connection, self.faults, self._stopping.wait)
        with contextlib.suppress(OSError):
            reader.start()
            transport.greet(f"connected to {self.scene.name}")
            for received, reply in replies(self._dialect, self.statistics, requests, self._stopping):
                due = received + self.settings.latency_ms / 1000
                self._stopping.wait(max(0.0, due - time.monotonic()))
                transport.send(reply)
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RD)  # wakes the reader; sends nothing
        reader.join()

    def _read(self, connection: socket.socket, requests: Requests) -> None:
        spoken = False

        def wait(begun: bool) -> None:
            """Wait for bytes, but not for ever for the rest of a request, nor for a client's first one."""
            give_up = time.monotonic() + PATIENCE_S
            while not select.select([connection], [], [], _SILENT_S)[0]:
                late = time.monotonic() > give_up
                if late and (begun or (not spoken and self._is_awaited())):
                    raise FrameError(f"expected a request within {PATIENCE_S:g} s")

        with contextlib.suppress(OSError, FrameError, ValueError):  # ValueError: of a closed connection
            while (payload := read_frame(connection, wait)) is not None:
                spoken = True
                if not requests.put(payload):
                    connection.shutdown(socket.SHUT_RDWR)
        requests.end()

    def _is_awaited(self) -> bool:
        """Return whether another client waits."""
        return bool(select.select([self._listener], [], [], 0)[0])


def replies(
    dialect: Dialect, statistics: Statistics, requests: Requests, stopping: threading.Event
) -> Iterator[Request]:
    """Yield one client's replies, with the times of their requests, until the client leaves.

    While no request comes, frames end at the frame rate of the settings.

    Args:
        dialect: answers the requests.
        statistics: counts the commands.
        requests: of the client, as they arrive.
        stopping: ends the replies when it is set.
    """
    pending: deque[tuple[int, float, int, Later]] = deque()  # frame, request's time, id, reply
    batch: list[Request] = []
    dialect.held = 0
    clicked = time.monotonic()
    for frame in itertools.count():
        if stopping.is_set():
            return
        for request in _received(dialect, requests):
            if request is None:
                return
            batch.append(request)
            if len(batch) < dialect.held:
                continue
            dialect.held = 0
            for received, payload in batch:
                requests.answered(payload)
                identity, reply = _reply(dialect, statistics, payload)
                if isinstance(reply, Later):
                    pending.append((frame + reply.frames, received, identity, reply))
                elif reply is not None:
                    yield received, reply
            batch.clear()
        dialect.tick()
        pushed = dialect.world.faults.get("clicked")
        if pushed and 0 < pushed.amount() <= time.monotonic() - clicked:
            clicked = time.monotonic()
            yield clicked, b"clicked"
        while pending and pending[0][0] <= frame:
            _, received, identity, reply = pending.popleft()
            yield received, _payload(identity, reply.make())


def _received(dialect: Dialect, requests: Requests) -> list[Request | None]:
    """Return the requests of the next frame; an empty list if none comes in a frame's time."""
    received: list[Request | None] = []
    most = dialect.requests_per_frame
    with contextlib.suppress(queue.Empty):
        received.append(requests.get(1 / dialect.settings.frames_per_s))
        while most is None or len(received) < most:
            received.append(requests.get(0))
    return received


def _reply(dialect: Dialect, statistics: Statistics, payload: bytes) -> tuple[int, bytes | Later | None]:
    """Return a request's id and reply; None if the plugin does not reply."""
    parsed = dialect.parse(payload)
    if parsed is None:
        return 0, dialect.malformed(payload)
    identity, text = parsed
    statistics.add(text)
    dialect.world.on_command(text)
    reply = dialect.answer(text)
    return identity, reply if isinstance(reply, Later) else _payload(identity, reply)


def _payload(identity: int, body: str | bytes | None) -> bytes:
    if not body:
        body = "ok"  # the plugin's reply to an empty success
    if isinstance(body, str):
        body = body.encode()
    return b"%d:%b" % (identity, body)


def _prepare(scene: Scene) -> None:
    """Draw three rays, so that no request waits for kernels: where none are built, numba takes seconds."""
    seen = scene.view(np.zeros(3), np.eye(3)[None], np.ones((1, 3)))
    seen.codes.sum()  # colours are made when they are asked for


def serve(scene: Scene | str | Path, port: int = 0, dialect: DialectName = "N3", **options: Any) -> Server:
    """Start a server. Use it as a context manager, or call ``stop``.

    Args:
        scene: a Scene, or the name or YAML path of one.
        port: 0 takes any free port.
        dialect: one of ``DIALECTS``.
        options: see :class:`mock_server.settings.Settings`.

    Raises:
        TypeError: an unknown option.
        ValueError: an unknown scene, word or fault, or a number out of its range.
        OSError: the address cannot be listened on.
    """
    return Server(scene, Settings(port=port, dialect=dialect, **options))
