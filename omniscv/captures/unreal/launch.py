"""Starts a packaged game, opens it as a source when it answers, and stops it with the source.

The plugin reads its settings once, from ``unrealcv.ini`` beside the running executable (protocol reference,
section 1.5). The file is written before the game starts, and put back as it was when the game answers, so
that the same package can be started again beside it.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from omniscv.captures.opening import size_of
from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.unreal.dialects import open_live
from omniscv.captures.unreal.live import UnrealSource
from omniscv.captures.view import Capture, Request, View
from omniscv.errors import ArgumentError, ConnectionFailed, DeadlineExceeded

HOST = "127.0.0.1"
_PATIENCE_S = 180.0
"""A large game takes minutes to load."""

_TRY_AGAIN_S = 0.25
_LEAVE_S = 10.0
"""How long a game may take to end when it is told to; then it is killed."""


class LaunchedSource(Source):
    """A game that was started for this source alone; closing the source stops it.

    Args:
        path: the game's executable, or the launcher in the folder of the package.
        port: what the plugin shall listen on; None takes one that is free.
        size: width and height of its images, px: in force where a dialect cannot set them.
        fov_deg: horizontal field of view, likewise.
        patience_s: how long it may take until it answers.
        options: for :func:`omniscv.captures.unreal.dialects.open_live`.

    Raises:
        ArgumentError: there is no such program, or it cannot be run.
        ConnectionFailed: it ended, or did not answer in time; the message has its last words.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        port: int | None = None,
        size: tuple[int, int] = (640, 480),
        fov_deg: float = 90.0,
        patience_s: float = _PATIENCE_S,
        **options: Any,
    ) -> None:
        path = Path(path).absolute()
        if not path.is_file() or not os.access(path, os.X_OK):
            raise ArgumentError(f"{path}: expected a game that can be run, but there is none")
        port = _free_port() if port is None else port
        with ExitStack() as held:
            with ExitStack() as settings:
                for folder in settings_folders(path):
                    settings.enter_context(_settings(folder / "unrealcv.ini", port, size, fov_deg))
                self._game = held.enter_context(_running(path))
                self._source = _answering(self._game, path, port, patience_s, options)
            held.callback(self._source.close)
            self._held = held.pop_all()

    @property
    def capabilities(self) -> Capabilities:
        return self._source.capabilities

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        return self._source.capture(requests)

    def objects(self) -> ObjectTable:
        return self._source.objects()

    def recorded_views(self) -> tuple[View, ...] | None:
        return self._source.recorded_views()

    def close(self) -> None:
        self._held.close()


def open_launched(uri: str, **options: Any) -> Source:
    """Starts a game.

    Args:
        uri: ``launch:PATH``; behind a question mark, what :class:`LaunchedSource` takes:
            ``launch:PATH?port=9001&size=1024x1024&fov_deg=90&patience_s=60``.
        options: for :func:`omniscv.captures.unreal.dialects.open_live`.

    Raises:
        ArgumentError: an option that is unknown or wrong.
        ArgumentError, ConnectionFailed: as :class:`LaunchedSource`.
    """
    path, _, query = uri.removeprefix("launch:").partition("?")
    readers: dict[str, Callable[[str], Any]] = {
        "port": int,
        "size": size_of,
        "fov_deg": float,
        "patience_s": float,
    }
    settings: dict[str, Any] = {}
    for key, text in parse_qsl(query, keep_blank_values=True):
        try:
            settings[key] = readers[key](text)
        except (KeyError, ValueError) as cause:
            raise ArgumentError(
                f"source: expected options such as port=9001&size=1024x1024&fov_deg=90&patience_s=60 "
                f"in {uri!r}, got {key}={text}"
            ) from cause
    return LaunchedSource(path, **settings, **options)


def settings_folders(path: Path) -> list[Path]:
    """Where a game reads its settings: beside the executable that a launcher in the package's folder starts.

    A package is ``Game.sh`` or ``Game.exe`` beside ``Game/Binaries/<Platform>/``.
    """
    if path.parent.parent.name == "Binaries":
        return [path.parent]
    inside = [folder for folder in path.parent.glob("*/Binaries/*/") if folder.parts[-3] != "Engine"]
    return sorted(inside) or [path.parent]


@contextmanager
def _settings(file: Path, port: int, size: tuple[int, int], fov_deg: float) -> Iterator[None]:
    """The plugin's settings, for a while; then what was there before."""
    before = file.read_bytes() if file.exists() else None
    file.write_text(
        "[UnrealCV.Core]\n"
        f"Port={port}\nWidth={size[0]}\nHeight={size[1]}\nFOV={fov_deg:f}\n"
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


class _Game:
    """A running game, with all that it has started, and what it says."""

    def __init__(self, path: Path) -> None:
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - closed by stop
        try:
            self.process = subprocess.Popen(
                [path],
                cwd=path.parent,
                stdin=subprocess.DEVNULL,
                stdout=self._words,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is for us: we stop the game when its captures are safe
            )
        except OSError as cause:
            self._words.close()
            raise ArgumentError(f"{path}: expected a game that can be run, got: {cause}") from cause

    def last_words(self) -> str:
        """The last line it printed."""
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "nothing")

    def stop(self) -> None:
        """Tells it to end, then makes it end: a launcher's children too."""
        self._signal(signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(_LEAVE_S)
        self._signal(signal.SIGKILL if os.name == "posix" else signal.SIGTERM)
        self.process.wait()
        self._words.close()

    def _signal(self, number: int) -> None:
        if os.name == "posix":
            with suppress(ProcessLookupError):
                os.killpg(self.process.pid, number)
        elif self.process.poll() is None:  # there are no groups: ends the tree
            subprocess.run(["taskkill", "/T", "/F", "/PID", str(self.process.pid)], check=False)


@contextmanager
def _running(path: Path) -> Iterator[_Game]:
    game = _Game(path)
    try:
        yield game
    finally:
        game.stop()


def _answering(
    game: _Game, path: Path, port: int, patience_s: float, options: dict[str, Any]
) -> UnrealSource:
    """The game as a source, as soon as it answers.

    The connection that first gets through is the one that is used: some servers serve only one
    (protocol reference, section 1.2).
    """
    deadline = time.monotonic() + patience_s
    while True:
        try:
            return open_live((HOST, port), **options)
        except (ConnectionFailed, DeadlineExceeded) as silence:
            if (code := game.process.poll()) is not None:
                raise ConnectionFailed(
                    f"{path}: expected a game that answers at port {port}, but it ended with code {code}; "
                    f"it said: {game.last_words()}"
                ) from silence
            if time.monotonic() > deadline:
                raise ConnectionFailed(
                    f"{path}: expected an answer at port {port} within {patience_s:g} s, got none; has the "
                    f"game the UnrealCV plugin? It said: {game.last_words()}"
                ) from silence
            time.sleep(_TRY_AGAIN_S)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
