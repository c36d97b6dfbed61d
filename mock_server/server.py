"""The TCP server: one client at a time, as the plugin, each with a reader and a writer thread."""

from __future__ import annotations

import contextlib
import queue
import re
import socket
import threading
import time
from collections import Counter
from types import TracebackType
from typing import Self

from mock_server.dialects.v1 import Commands
from mock_server.protocol import BadFrame, frame, read_frame
from mock_server.scene import Scene, load_scene
from mock_server.world import World

DIALECTS = ("1.x", "N1")
DEPTHS = ("half", "float32")
_REQUEST = re.compile(rb"(\d+):(.*)")
_BACKLOG = 1
_ACCEPT_S = 0.1


class Statistics:
    """How many requests of each kind came; kinds are commands with their numbers taken out."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def note(self, text: str) -> None:
        """Counts a command."""
        self.counts[text] += 1

    def total(self, start: str) -> int:
        """How many commands began with ``start``."""
        return sum(count for text, count in self.counts.items() if text.startswith(start))


class Server:
    """A scene behind the UnrealCV protocol. A context manager; ``stop`` ends it.

    Args:
        scene: a Scene, or the name or YAML path of one.
        port: 0 takes any free port.
        dialect: one of ``DIALECTS``.
        latency_ms: every reply is held back until this long after its request came, so that
            pipelined requests share the wait, as they share an engine's tick.
        depth: ``half``: depth goes through half floats as in the engine; ``float32``: it does not.
        host: the address to listen on; loopback unless told.

    Raises:
        ValueError: an unknown scene, dialect or depth.
    """

    def __init__(
        self,
        scene: Scene | str,
        port: int = 0,
        dialect: str = "1.x",
        *,
        latency_ms: float = 0.0,
        depth: str = "half",
        host: str = "127.0.0.1",
    ) -> None:
        for key, value, known in (("dialect", dialect, DIALECTS), ("depth", depth, DEPTHS)):
            if value not in known:
                raise ValueError(f"{key}: expected one of {', '.join(known)}; got {value!r}")
        self.scene = scene if isinstance(scene, Scene) else load_scene(scene)
        self.statistics = Statistics()
        self._latency_s = latency_ms / 1000
        self._listener = socket.create_server((host, port), backlog=_BACKLOG)
        self._listener.settimeout(_ACCEPT_S)
        self.host, self.port = self._listener.getsockname()[:2]
        self._commands = Commands(World(self.scene), self.port, depth == "half")
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="mock-unrealcv", daemon=True)
        self._thread.start()

    @property
    def uri(self) -> str:
        """What ``omniscv.open_source`` takes."""
        return f"unreal://{self.host}:{self.port}"

    def stop(self) -> None:
        """Drops the client and ends; calling it twice is fine."""
        self._stopping.set()
        self._thread.join()
        self._listener.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _listen(self) -> None:
        while not self._stopping.is_set():
            try:
                connection, _ = self._listener.accept()
            except TimeoutError:
                continue
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._serve(connection)

    def _serve(self, connection: socket.socket) -> None:
        """Answers one client until it leaves: this thread answers, another reads."""
        requests: queue.Queue[tuple[float, bytes] | None] = queue.Queue()
        reader = threading.Thread(target=self._read, args=(connection, requests), daemon=True)
        with contextlib.suppress(OSError):
            connection.sendall(frame(f"connected to {self.scene.name}".encode()))
            reader.start()
            while (item := self._next(requests)) is not None:
                came, payload = item
                reply = self._reply(payload)
                if reply is not None:
                    self._stopping.wait(max(0.0, came + self._latency_s - time.monotonic()))
                    connection.sendall(frame(reply))
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
        if reader.ident is not None:
            reader.join()

    def _next(self, requests: queue.Queue[tuple[float, bytes] | None]) -> tuple[float, bytes] | None:
        while not self._stopping.is_set():
            with contextlib.suppress(queue.Empty):
                return requests.get(timeout=_ACCEPT_S)
        return None

    @staticmethod
    def _read(connection: socket.socket, requests: queue.Queue[tuple[float, bytes] | None]) -> None:
        with contextlib.suppress(OSError, BadFrame):
            while (payload := read_frame(connection)) is not None:
                requests.put((time.monotonic(), payload))
        requests.put(None)

    def _reply(self, payload: bytes) -> bytes | None:
        """The reply's payload; None where the plugin stays silent."""
        found = _REQUEST.search(payload.partition(b"\0")[0])
        if found is None:
            return None
        text = found[2].decode("latin-1").rstrip("\r")
        self.statistics.note(text)
        body = self._commands.answer(text)
        return found[1] + b":" + (body if isinstance(body, bytes) else body.encode())


def serve(
    scene: Scene | str,
    port: int = 0,
    dialect: str = "1.x",
    *,
    latency_ms: float = 0.0,
    depth: str = "half",
    host: str = "127.0.0.1",
) -> Server:
    """Starts a server; see :class:`Server`. Use it as a context manager, or call ``stop``."""
    return Server(scene, port, dialect, latency_ms=latency_ms, depth=depth, host=host)
