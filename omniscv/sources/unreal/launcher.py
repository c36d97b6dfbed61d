"""Starts a packaged game, opens it as a source once it is reachable, and stops it with the source.

The game is a child of ``watcher.py``, which stops it when this process ends, however it ends.
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

from omniscv.arguments import number, whole_number
from omniscv.errors import ArgumentError, DeadlineError, ServerConnectionError, SourceError
from omniscv.sources.base import Source
from omniscv.storage.bounded import last_line
from omniscv.storage.local import locked, whole_file

Connect = Callable[..., Source]
"""Opens an endpoint, and of a running game a camera of its level."""
Watcher = subprocess.Popen[bytes]
HOST = "127.0.0.1"
SETTINGS = "unrealcv.ini"
BACKUP = f"{SETTINGS}.omniscv-backup"
_MARK = f"; written by omniscv for one launch; settings from before are in {BACKUP}\n"
_WATCHER = Path(__file__).with_name("watcher.py")
_GRACE_S = 10.0  # how long a game may take to end after SIGTERM, before SIGKILL


def launch(
    path: Path,
    connect: Connect,
    host: ExitStack,
    *,
    port: int | None = None,
    size: tuple[int, int] = (640, 480),
    fov_deg: float = 90.0,
    startup_timeout_s: float = 180.0,
) -> Source:
    """Start a game for one source alone.

    Args:
        path: the game's executable, or the launcher in the folder of the package.
        connect: opens an endpoint as a source.
        host: stops the game, and puts its settings back, when it is closed.
        port: where the plugin listens; None takes a free one.
        size, fov_deg: of its images, px and degrees across: in force where a dialect cannot set them.
        startup_timeout_s: deadline for the game to be reachable; a large one takes minutes to load.

    Raises:
        ArgumentError: there is no such program, or it cannot be run; a number is out of its range.
        SourceError: its settings cannot be written.
        ServerConnectionError: it ended, or was not reachable in time; the message has its last output.
    """
    port = _free_port() if port is None else whole_number("port", port, most=65_535)
    size = (whole_number("size", size[0], "pixels"), whole_number("size", size[1], "pixels"))
    fov_deg = number("fov_deg", fov_deg, above=0, below=180)
    startup_timeout_s = number("startup_timeout_s", startup_timeout_s, above=0)
    path = path.absolute()
    if not path.is_file() or not os.access(path, os.X_OK):
        raise ArgumentError(f"{path}: expected a game that can be run, but there is none")
    with ExitStack() as settings:
        for folder in settings_folders(path):
            # Without input, because a click in the window would break the stream:
            text = (
                f"[UnrealCV.Core]\nPort={port}\nWidth={size[0]}\nHeight={size[1]}\nFOV={fov_deg:f}\n"
                "EnableInput=False\nEnableRightEye=False\n"
            )
            settings.enter_context(temporary_settings(folder, text, startup_timeout_s))
        watcher, output = host.enter_context(_running(path))
        return _reachable(path, watcher, output, port, startup_timeout_s, connect)


def settings_folders(path: Path) -> list[Path]:
    """Return where a game reads its settings: ``Game/Binaries/<Platform>/`` beside ``Game.sh``."""
    if path.parent.parent.name == "Binaries":
        return [path.parent]
    inside = []
    for folder in path.parent.glob("*/Binaries/*/"):
        if folder.parts[-3] != "Engine":
            inside.append(folder)
    return sorted(inside) or [path.parent]


@contextmanager
def temporary_settings(folder: Path, text: str, timeout_s: float) -> Iterator[None]:
    """Write the plugin's settings, and put back the user's file at the end.

    The plugin reads them once, when it starts (protocol reference, section 1.5). The user's file is renamed,
    so that it comes back unchanged; if the process is killed before that, the next launch puts it back.

    Args:
        folder: where the game reads them; it is locked meanwhile.
        text: the settings.
        timeout_s: how long to wait for another launch that has locked the folder.

    Raises:
        DeadlineError: the folder is locked for longer.
        SourceError: it cannot be written, or the user has changed what a killed launch has left.
    """
    file = folder / SETTINGS
    backup = folder / BACKUP
    with ExitStack() as lock:
        try:
            lock.enter_context(locked(folder, timeout_s))
        except TimeoutError as cause:
            raise DeadlineError(f"{folder}: another launch has not started yet") from cause
        _put_back_after_a_kill(file, backup)
        try:
            if os.path.lexists(file):
                file.replace(backup)
            with whole_file(file) as part:
                part.write_text(_MARK + text, encoding="ascii")
        except OSError as cause:
            raise SourceError(f"{file}: expected a file that can be written: {cause.strerror}") from cause
        try:
            yield
        finally:
            if os.path.lexists(backup):
                backup.replace(file)
            else:
                file.unlink(missing_ok=True)


def _put_back_after_a_kill(file: Path, backup: Path) -> None:
    text = file.read_text(encoding="ascii", errors="replace") if file.is_file() else ""
    is_ours = text.startswith(_MARK)
    if os.path.lexists(backup):
        if text and not is_ours:
            files = f"{backup.name}, from a launch that was killed, or {file.name}, changed since"
            raise SourceError(f"{file.parent}: expected either {files}; keep one of them as {file.name}")
        backup.replace(file)
    elif is_ours:
        file.unlink()


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
    """Stop a game by its watcher; or its processes by the group's id, if the watcher was killed."""
    assert watcher.stdin is not None
    with suppress(OSError):  # of a watcher that has ended; a forked process may hold the pipe open, so write
        watcher.stdin.write(b"stop")
    if watcher.wait() < 0 and sys.platform != "win32":
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
                expected = f"{path}: expected a game that is reachable at port {port}"
                last = f"Its last output: {last_line(output)}"
                raise ServerConnectionError(f"{expected}, {why} {last}") from fault
            time.sleep(0.25)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
