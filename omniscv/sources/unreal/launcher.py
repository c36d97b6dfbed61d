"""Starts a packaged game, opens it as a source once it is reachable, and stops it with the source.

The plugin reads its settings once, from ``unrealcv.ini`` beside the running executable (protocol reference,
section 1.5). The file is written before the game starts, and restored once the game is reachable, so that the
same package can be started again beside it.
"""

import os
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from omniscv.errors import ArgumentError, DeadlineError, ServerConnectionError
from omniscv.sources.base import Source, SourceWrapper
from omniscv.sources.unreal.client import Endpoint

Connect = Callable[[Endpoint], Source]
Game = subprocess.Popen[bytes]
HOST = "127.0.0.1"
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
        ArgumentError: there is no such program, or it cannot be run.
        ServerConnectionError: it ended, or was not reachable in time; the message has its last output.
    """
    path = path.absolute()
    if not path.is_file() or not os.access(path, os.X_OK):
        raise ArgumentError(f"{path}: expected a game that can be run, but there is none")
    port = _free_port() if port is None else port
    with ExitStack() as held:
        with ExitStack() as settings:
            for folder in settings_folders(path):
                settings.enter_context(_settings(folder / "unrealcv.ini", port, size, fov_deg))
            game, output = held.enter_context(_running(path))
            source = _reachable(path, game, output, port, startup_timeout_s, connect)
        return HostedSource(source, held.pop_all())


def settings_folders(path: Path) -> list[Path]:
    """Return where a game reads its settings: beside the executable, which a launcher may start.

    A package is ``Game.sh`` or ``Game.exe`` beside ``Game/Binaries/<Platform>/``.
    """
    if path.parent.parent.name == "Binaries":
        return [path.parent]
    inside = [folder for folder in path.parent.glob("*/Binaries/*/") if folder.parts[-3] != "Engine"]
    return sorted(inside) or [path.parent]


@contextmanager
def _settings(file: Path, port: int, size: tuple[int, int], fov_deg: float) -> Iterator[None]:
    """Write the plugin's settings; restore what was there before at the end."""
    before = file.read_bytes() if file.exists() else None
    file.write_text(
        f"[UnrealCV.Core]\nPort={port}\nWidth={size[0]}\nHeight={size[1]}\nFOV={fov_deg:f}\n"
        "EnableInput=False\nEnableRightEye=False\n",  # a click in the window would break the stream
        encoding="ascii",
    )
    try:
        yield
    finally:
        if before is None:
            file.unlink(missing_ok=True)
        else:
            file.write_bytes(before)


@contextmanager
def _running(path: Path) -> Iterator[tuple[Game, IO[bytes]]]:
    """A game and its output; stopped at the end, with all processes that it has started."""
    with tempfile.TemporaryFile() as output:
        pipes: Any = {"stdin": subprocess.DEVNULL, "stdout": output, "stderr": subprocess.STDOUT}
        try:  # In a session of its own, Ctrl-C does not reach it: it is stopped once its captures are safe.
            game = subprocess.Popen([path], cwd=path.parent, start_new_session=True, **pipes)
        except OSError as cause:
            raise ArgumentError(f"{path}: expected a game that can be run, got: {cause}") from cause
        try:
            yield game, output
        finally:
            _signal(game, signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                game.wait(_GRACE_S)
            _signal(game, signal.SIGKILL if os.name == "posix" else signal.SIGTERM)
            game.wait()


def _reachable(
    path: Path, game: Game, output: IO[bytes], port: int, timeout_s: float, connect: Connect
) -> Source:
    deadline = time.monotonic() + timeout_s
    while True:
        try:  # The first connection is the one that is used: some servers serve only one (reference, 1.2).
            return connect((HOST, port))
        except (ServerConnectionError, DeadlineError) as fault:
            why = f"got none within {timeout_s:g} s; has it the UnrealCV plugin?"
            if (code := game.poll()) is not None:
                why = f"but it ended with code {code}."
            if code is not None or time.monotonic() > deadline:
                wanted = f"{path}: expected a game that is reachable at port {port}"
                last = f"Its last output: {_last_line(output)}"
                raise ServerConnectionError(f"{wanted}, {why} {last}") from fault
            time.sleep(0.25)


def _signal(game: Game, number: int) -> None:
    """Signal a game and a launcher's children, even if the launcher itself has ended."""
    if os.name == "posix":
        with suppress(ProcessLookupError):
            os.killpg(game.pid, number)
    elif game.poll() is None:  # there are no process groups: end the tree
        subprocess.run(["taskkill", "/T", "/F", "/PID", str(game.pid)], check=False)


def _last_line(output: IO[bytes]) -> str:
    output.seek(0)
    lines = output.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "nothing")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
