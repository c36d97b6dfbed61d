"""The server: one client at a time, as the plugin, answered once per frame of the engine."""

from __future__ import annotations

import contextlib
import math
import queue
import socket
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mock_server.dialects import BY_NAME
from mock_server.dialects.common import Settings
from mock_server.engine import Engine, Requests, Statistics
from mock_server.faults import Faults
from mock_server.faulty_world import FaultyWorld
from mock_server.files import OutputFolder
from mock_server.line import Line
from mock_server.listener import Listener
from mock_server.protocol import BadFrame, read_frame
from mock_server.scene import Scene, load_scene

DIALECTS = tuple(BY_NAME)
DEPTHS = ("half", "float32")
PLATFORMS = ("windows", "linux")


class Server:
    """A scene behind the UnrealCV protocol. A context manager; ``stop`` ends it.

    A frame of the engine ends whenever the requests that have come are answered, and at the frame rate while
    none comes: so clients that wait for each reply see poses lag as with an engine, without its waiting.

    Args:
        scene: a Scene, or the name or YAML path of one.
        port: 0 takes any free port.
        dialect: one of ``DIALECTS``.
        latency_ms: every reply is held back until this long after its request came, so that
            pipelined requests share the wait, as they share an engine's tick.
        depth: ``half``: depth goes through half floats as in the engine; ``float32``: it does not.
        platform: ``linux``: dialects N1 and N2 leave TCP for ``unix_path`` once their first client has left.
        host: the address to listen on; loopback unless told.
        size: width and height of new cameras, px, as in the plugin's settings.
        fov_deg: horizontal field of view of new cameras.
        window: width and height of the game's window, where dialect 0.3.10 takes its masks; None as ``size``.
        frames_per_s: the frame rate while no request comes.
        folder: where commands that name a file write; None takes a temporary one, removed at the end.
        faults: what goes wrong, such as ``("delay=0.2@0.05", "vignette")``: see ``mock_server.faults``.
        seed: of the faults' dice.

    Raises:
        ValueError: an unknown scene, dialect, depth, platform or fault, or a number out of its range.
    """

    def __init__(
        self,
        scene: Scene | str,
        port: int = 0,
        dialect: str = "1.x",
        *,
        latency_ms: float = 0.0,
        depth: str = "half",
        platform: str = "windows",
        host: str = "127.0.0.1",
        size: tuple[int, int] = (640, 480),
        fov_deg: float = 90.0,
        window: tuple[int, int] | None = None,
        frames_per_s: float = 60.0,
        folder: Path | None = None,
        faults: Iterable[str] = (),
        seed: int = 0,
    ) -> None:
        _check("dialect", dialect, DIALECTS)
        _check("depth", depth, DEPTHS)
        _check("platform", platform, PLATFORMS)
        _check_range("port", port, 0, 65535)
        _check_range("size", min(*size, *(window or size)), 1, math.inf)
        _check_range("fov_deg", fov_deg, 1, 179)
        _check_range("latency_ms", latency_ms, 0, math.inf)
        _check_range("frames_per_s", frames_per_s, 1e-3, math.inf)
        self.scene = scene if isinstance(scene, Scene) else load_scene(scene)
        self.statistics = Statistics()
        self.faults = Faults(faults, seed)
        self._world = FaultyWorld(self.scene, size, fov_deg, self.faults)
        self.files = OutputFolder(folder)
        self._latency_s = latency_ms / 1000
        kind = BY_NAME[dialect]
        self._listener = Listener(host, port, unix=platform == "linux" and kind.has_unix)
        self.host, self.port = self._listener.host, self._listener.port
        half = depth == "half" or self.faults.get("half-depth") is not None
        settings = Settings(self.port, *size, fov_deg, window or size, half, self.files)
        self._dialect = kind(self._world, settings)
        self._engine = Engine(self._dialect, self.statistics, 1 / frames_per_s)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="mock-unrealcv", daemon=True)
        self._thread.start()

    @property
    def uri(self) -> str:
        """What ``omniscv.open_source`` takes."""
        return f"unreal://{self.host}:{self.port}"

    @property
    def unix_path(self) -> Path:
        """Where the Unix socket is, once TCP has been left."""
        return self._listener.unix_path

    def stop(self) -> None:
        """Drops the client and ends; calling it twice is fine."""
        self._stopping.set()
        self._thread.join()
        self._listener.close()
        self.files.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _listen(self) -> None:
        while (connection := self._listener.accept(self._stopping)) is not None:
            self._dialect.on_unix = self._listener.on_unix
            with connection:
                self._serve(connection)

    def _serve(self, connection: socket.socket) -> None:
        """Answers one client until it leaves: this thread answers, another reads."""
        requests: Requests = queue.Queue()
        reader = threading.Thread(target=self._read, args=(connection, requests), daemon=True)
        line = Line(connection, self.faults, self._stopping.wait)
        with contextlib.suppress(OSError):
            reader.start()
            line.greet(f"connected to {self.scene.name}")
            for came, reply in self._engine.replies(requests, self._stopping):
                self._stopping.wait(max(0.0, came + self._latency_s - time.monotonic()))
                line.send(reply)
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RD)  # wakes the reader, and tells the client nothing yet
        reader.join()

    @staticmethod
    def _read(connection: socket.socket, requests: Requests) -> None:
        with contextlib.suppress(OSError, BadFrame):
            while (payload := read_frame(connection)) is not None:
                requests.put((time.monotonic(), payload))
        requests.put(None)


def _check(key: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{key}: expected one of {', '.join(known)}; got {value!r}")


def _check_range(key: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise ValueError(f"{key}: expected {least:g} to {most:g}, got {value!r}")


def serve(scene: Scene | str, port: int = 0, dialect: str = "1.x", **options: Any) -> Server:
    """Starts a server; see :class:`Server`. Use it as a context manager, or call ``stop``."""
    return Server(scene, port, dialect, **options)
