"""Starts a packaged game, opens it as a source once it is reachable, and stops it with the source.

The plugin's settings are written before the game starts, and put back once it is reachable. The game is a
child of a watching process, which stops it when this process ends, however it ends.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from omniscv.arguments import number, shown, whole_number
from omniscv.errors import ArgumentError, DeadlineError, ServerConnectionError
from omniscv.sources.base import Source, SourceWrapper
from omniscv.sources.unreal.client import Endpoint
from omniscv.sources.unreal.settings_file import borrowed

Connect = Callable[[Endpoint], Source]
Watcher = subprocess.Popen[bytes]
HOST = "127.0.0.1"
_WATCHER = Path(__file__).with_name("watcher.py")
_GRACE_S = 10.0  # how long a game may take to end after SIGTERM, before SIGKILL


class HostedSource(SourceWrapper):
    """A source and what serves it, a game or a mock server, which is stopped with it."""

    def __init__(self, source: Source, host: ExitStack) -> None:
        super().__init__(source)
        self._host = host

    def close(self) -> None:
        with self._host:
            super().close()


def launch(
    path: Path,
    connect: Connect,
    *,
    port: int | None = None,
    size: tuple[int, int] = (640, 480),
    fov_deg: float = 90.0,
    startup_timeout_s: float = 180.0,
) -> Source:
    """Start a game for one source alone; closing the source stops it.

    Args:
        path: the game's executable, or the launcher in the folder of the package.
        port: where the plugin listens; None takes a free one.
        size: width and height of its images, px: in force where a dialect cannot set them.
        fov_deg: horizontal field of view, likewise.
        startup_timeout_s: deadline for the game to be reachable; a large one takes minutes to load.

    Raises:
        ArgumentError: there is no such program, or it cannot be run; a number is out of its range.
        SourceError: its settings cannot be written.
        ServerConnectionError: it ended, or was not reachable in time; the message has its last output.
    """
    port = None if port is None else whole_number("port", port, most=65_535)
    size = (whole_number("size", size[0], "pixels"), whole_number("size", size[1], "pixels"))
    fov_deg = number("fov_deg", fov_deg, above=0, below=180)
    startup_timeout_s = number("startup_timeout_s", startup_timeout_s, above=0)
    path = path.absolute()
    if not path.is_file() or not os.access(path, os.X_OK):
        raise ArgumentError(f"{path}: expected a game that can be run, but there is none")
    port = _free_port() if port is None else port
    with ExitStack() as held:
        with ExitStack() as settings:
            for folder in settings_folders(path):
                settings.enter_context(borrowed(folder, _settings(port, size, fov_deg), startup_timeout_s))
            watcher, output = held.enter_context(_running(path))
            source = _reachable(path, watcher, output, port, startup_timeout_s, connect)
        return HostedSource(source, held.pop_all())


def settings_folders(path: Path) -> list[Path]:
    """Return where a game reads its settings: beside the executable, which a launcher may start.

    A package is ``Game.sh`` or ``Game.exe`` beside ``Game/Binaries/<Platform>/``.
    """
    if path.parent.parent.name == "Binaries":
        return [path.parent]
    inside = [folder for folder in path.parent.glob("*/Binaries/*/") if folder.parts[-3] != "Engine"]
    return sorted(inside) or [path.parent]


def _settings(port: int, size: tuple[int, int], fov_deg: float) -> str:
    return (
        f"[UnrealCV.Core]\nPort={port}\nWidth={size[0]}\nHeight={size[1]}\nFOV={fov_deg:f}\n"
        "EnableInput=False\nEnableRightEye=False\n"  # a click in the window would break the stream
    )


@contextmanager
def _running(path: Path) -> Iterator[tuple[Watcher, IO[bytes]]]:
    """A game's watcher and its output; stopped at the end, with all processes that it has started."""
    command = [sys.executable, "-I", "-S", str(_WATCHER), str(_GRACE_S), str(path)]
    pipe = subprocess.PIPE
    with (
        tempfile.TemporaryFile() as output,
        # In a session of its own, Ctrl-C does not reach it: it is stopped once its captures are safe.
        subprocess.Popen(
            command, 0, stdin=pipe, stdout=pipe, stderr=output, start_new_session=True
        ) as watcher,
    ):
        assert watcher.stdout is not None
        first = watcher.stdout.readline().decode(errors="replace").strip()
        if not first.isdecimal():
            raise ArgumentError(f"{path}: expected a game that can be run, got: {first[:100]}")
        try:
            yield watcher, output
        finally:
            _stop(watcher, int(first))


def _stop(watcher: Watcher, game: int) -> None:
    """Stop a game by its watcher; or its processes by the group's id, where the watcher was killed."""
    assert watcher.stdin is not None
    with suppress(OSError):  # of a watcher that has ended; a forked process may hold the pipe open, so write
        watcher.stdin.write(b"stop")
    if watcher.wait() < 0 and os.name == "posix":
        with suppress(ProcessLookupError):
            os.killpg(game, signal.SIGKILL)


def _reachable(
    path: Path, watcher: Watcher, output: IO[bytes], port: int, timeout_s: float, connect: Connect
) -> Source:
    deadline = time.monotonic() + timeout_s
    while True:
        try:  # The first connection is the one that is used: some servers serve only one (reference, 1.2).
            return connect((HOST, port))
        except (ServerConnectionError, DeadlineError) as fault:
            why = f"got none within {timeout_s:g} s; has it the UnrealCV plugin?"
            if (code := watcher.poll()) is not None:
                why = f"but it ended with code {code}."
            if code is not None or time.monotonic() > deadline:
                wanted = f"{path}: expected a game that is reachable at port {port}"
                last = f"Its last output: {_last_line(output)}"
                raise ServerConnectionError(f"{wanted}, {why} {last}") from fault
            time.sleep(0.25)


def _last_line(output: IO[bytes]) -> str:
    output.seek(max(0, output.seek(0, os.SEEK_END) - 10_000))
    lines = output.read().decode(errors="replace").split("\n")
    return next((shown(line.strip())[1:-1] for line in reversed(lines) if line.strip()), "nothing")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
