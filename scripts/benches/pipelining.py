"""How many captures a second come with requests under way together, by the server's latency.

Faces of the room in colour, mask and depth, over TCP from the mock server, whose every reply comes 5 ms after
its request and, to compare, at once. The peers send each command once the one before it has been answered, as
with the official client alone, or each capture once the one before it has come.
"""

import contextlib
import time
from collections.abc import Iterable, Iterator

import mock_server
import omniscv
from benches import Figure, Reference
from benches._views import requests
from omniscv.sources import Capture, Request, Source
from omniscv.sources.codecs import decode
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.commands import MODERN
from omniscv.sources.unreal.modern import ModernDriver

BY_COMMAND, BY_CAPTURE = "command by command", "capture by capture"


def measure(quick: bool) -> Iterator[Figure]:
    seconds = 0.02 if quick else 3.0
    for size in (8,) if quick else (64, 256):
        for latency_ms in (0, 5):
            with mock_server.serve("four-wall", latency_ms=latency_ms) as server:
                peers = {BY_COMMAND: rate(command_by_command(server, requests(size)), seconds)}
                with omniscv.open_source(server.uri) as source:
                    peers[BY_CAPTURE] = rate(capture_by_capture(source, requests(size)), seconds)
                    ours = rate(source.capture(requests(size)), seconds)
            title = f"faces of {size} px, {latency_ms} ms"
            for name, value in peers.items():
                yield Figure(title, "pipelined", "captures/s", ours, Reference(name, value))


def rate(captures: Iterator[Capture], seconds: float) -> float:
    """Return captures a second."""
    next(captures)  # the first waits for the engine's warm-up
    count, began = 0, time.perf_counter()
    while time.perf_counter() < began + seconds:
        next(captures)
        count += 1
    result = count / (time.perf_counter() - began)
    captures.close()
    return result


def command_by_command(server: mock_server.Server, stream: Iterable[Request]) -> Iterator[Capture]:
    with contextlib.closing(Connection((server.host, server.port))) as connection:
        driver, before = ModernDriver(connection), None
        for request in stream:
            picture = MODERN.image(driver.camera, request.mode)
            for command in (*driver.aim(before, request.view), picture):
                (reply,) = connection.read([command], lambda _, reply: reply)
            before = request.view
            yield decode(reply, MODERN.images[request.mode][1], request.mode, request.view)


def capture_by_capture(source: Source, stream: Iterable[Request]) -> Iterator[Capture]:
    for request in stream:
        yield from source.capture([request])
