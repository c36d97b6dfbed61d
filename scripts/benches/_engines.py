"""Servers that answer once a tick, and the fewest exchanges that their protocol allows for a view."""

import contextlib
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import groupby

from omniscv.sources import Request
from omniscv.sources.unreal.commands import LEGACY, LIT_VIEW_MODE
from omniscv.sources.unreal.connection import Connection
from omniscv.sources.unreal.legacy import LegacyDriver
from omniscv.sources.unreal.modern import ModernDriver
from omniscv.sources.unreal.stale_frames import StaleFrames

POSE = "vget /camera/0/pose"
SETTLES = 3  # sequential exchanges that a move of plugin 0.3.10 needs (protocol reference, section 7.2)


@contextmanager
def engines(count: int, dialect: str, latency_ms: float, size: int, reply_s: float) -> Iterator[list[str]]:
    """Run mock servers of 60 ticks a second, each in a process of its own, and yield their addresses.

    A reply keeps the engine for ``reply_s`` without its processor.
    """
    words = ["--port", "0", "--paced", "--dialect", dialect, "--latency-ms", str(latency_ms)]
    words += ["--size", f"{size}x{size}", *(["--fault", f"delay={reply_s}"] if reply_s else [])]
    with ExitStack() as running:
        found = []
        for _ in range(count):
            command = [sys.executable, "-m", "mock_server", *words]
            process = running.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
            running.callback(process.terminate)
            found.append(process)
        yield [process.stdout.readline().split()[0] for process in found]


def bare(address: str, dialect: str, stream: Iterable[Request]) -> Iterator[None]:
    """Yield once a capture, of a client that keeps the protocol's rules, and decodes and compares nothing.

    The first is the camera's start. Plugin 1.x may have any number of requests under way; 0.3.10 needs
    ``SETTLES`` exchanges after a move, and one for the mask, which is answered out of order.
    """
    host, _, port = address.removeprefix("unreal://").rpartition(":")
    with contextlib.closing(Connection((host, int(port)))) as connection:
        driver = (LegacyDriver if dialect == "L" else ModernDriver)(connection, dialect)
        driver.attach(StaleFrames(each_mode=driver.each_mode_lags))
        client = connection.connected()
        yield
        if dialect == "L":
            for view, requests in groupby(stream, lambda request: request.view):
                images = [LEGACY.image(0, request.mode) for request in requests]
                masks = [image for image in images if "mask" in image]
                moves = driver.aim(None, view)
                others = [image for image in images if image not in masks]
                for commands in (moves, *[[POSE]] * SETTLES, masks, [LIT_VIEW_MODE, *others, POSE]):
                    list(client.stream(commands))
                yield from [None] * len(images)
        else:
            commands, before = [], None
            for request in stream:
                commands += driver.aim(before, request.view)
                commands.append(driver.table.image(driver.camera, request.mode))
                before = request.view
            for command, _ in zip(commands, client.stream(commands), strict=True):
                if command.startswith("vget"):
                    yield
        driver.release()
