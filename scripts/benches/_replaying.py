"""Servers whose engine costs no processor: they answer once a tick with pictures that a mock server made.

Such a server holds what a mock server has replied to a client, by command; a picture is the next of those.
What was set is read back as it was set. So several of them, and the client, share no core worth mentioning,
and captures a second say what waits: ticks, latency, and what the protocol makes a client wait for.
"""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import mock_server
from mock_server.protocol import frame, read_frame

Replies = dict[str, list[bytes]]

TICK_S = 1 / 60
AT_ONCE = {"N2": 32}  # requests that a tick answers at most (protocol reference, section 1.3)
_NUMBERS = re.compile(r"-?\d+\.\d+")


@contextmanager
def servers(
    count: int, dialect: str, latency_s: float, reply_s: float, replies: Replies
) -> Iterator[list[str]]:
    """Run servers, each in a process of its own, and yield their addresses.

    Args:
        count: of servers.
        dialect: that they speak.
        latency_s: from a request's sending to the earliest tick that may answer it.
        reply_s: how long the engine takes for a picture; a tick lasts at least as long as its pictures.
        replies: by command, of :func:`learned`.
    """
    with ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
        written = {command: [body.hex() for body in bodies] for command, bodies in replies.items()}
        (folder / "replies").write_text(json.dumps(written))
        words = [str(folder / "replies"), str(AT_ONCE.get(dialect, 1 << 30)), str(latency_s), str(reply_s)]
        found = []
        for _ in range(count):
            command = [sys.executable, __file__, *words]
            process = running.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
            running.callback(process.terminate)
            found.append(process)
        yield [f"unreal://127.0.0.1:{process.stdout.readline().strip()}" for process in found]


def learned(dialect: str, size: int, drive: Callable[[str], object]) -> Replies:
    """Return what a mock server replies to a client: ``drive`` is called with an address."""
    replies: Replies = {}
    with (
        mock_server.serve("four-wall", dialect=dialect, size=(size, size)) as server,
        socket.create_server(("127.0.0.1", 0)) as listener,
    ):
        tap = threading.Thread(target=_tap, args=(listener, (server.host, server.port), replies), daemon=True)
        tap.start()
        drive(f"unreal://127.0.0.1:{listener.getsockname()[1]}")
        tap.join(10)
    return replies


def _tap(listener: socket.socket, server: tuple[str, int], replies: Replies) -> None:
    """Pass one client's frames to a server and back, and note which command got which reply."""
    client, _ = listener.accept()
    with client, socket.create_connection(server) as upstream:
        commands: dict[bytes, str] = {}

        def back() -> None:
            while (payload := read_frame(upstream)) is not None:
                number, _, body = payload.partition(b":")
                known = replies.setdefault(commands.pop(number), []) if number in commands else [body]
                if body not in known:  # a picture like the one before would pass for a stale frame
                    known.append(body)
                client.sendall(frame(payload))

        reader = threading.Thread(target=back, daemon=True)
        reader.start()
        while (payload := read_frame(client)) is not None:
            number, _, text = payload.partition(b":")
            commands[number] = text.decode()
            upstream.sendall(frame(payload))
        upstream.shutdown(socket.SHUT_RDWR)
        reader.join()


class Engine:
    """What a server answers.

    Args:
        replies: by command.
    """

    def __init__(self, replies: Replies) -> None:
        self._replies, self._told, self._set = replies, dict.fromkeys(replies, 0), dict[str, str]()

    def answer(self, command: str) -> bytes:
        """Return the reply: what was set, else the next of those that are known, else ok."""
        verb, path, *rest = command.split(" ", 2)
        if verb == "vset" and rest and _NUMBERS.search(rest[0]):
            self._set[path] = " ".join(f"{float(number):.3f}" for number in rest[0].split())
            return b"ok"
        if verb == "vget" and path in self._set:
            return self._set[path].encode()
        known = self._replies.get(command)
        if known is None:
            return b"ok"
        told = self._told[command]
        self._told[command] += 1
        return known[told % len(known)]


def _serve(replies: Replies, most: int, latency_s: float, reply_s: float) -> None:
    """Serve one client after another, for ever."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        while True:
            connection, _ = listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection:
                _answer(connection, Engine(replies), most, latency_s, reply_s)


def _answer(connection: socket.socket, engine: Engine, most: int, latency_s: float, reply_s: float) -> None:
    waiting: deque[tuple[float, bytes]] = deque()
    connection.sendall(frame(b"connected to a replaying server"))
    reader = threading.Thread(target=_read, args=(connection, waiting), daemon=True)
    reader.start()
    tick = time.monotonic()
    while reader.is_alive() or waiting:
        tick = max(tick, time.monotonic())
        time.sleep(max(0.0, tick - time.monotonic()))
        answered, done = 0, tick
        while answered < most and waiting and waiting[0][0] + latency_s <= tick:
            number, _, text = waiting.popleft()[1].partition(b":")
            answered += 1
            body = engine.answer(text.decode())
            if text.endswith((b"png", b"npy")):  # a picture
                done += reply_s
                time.sleep(max(0.0, done - time.monotonic()))
            connection.sendall(frame(number + b":" + body))
        tick = max(tick + TICK_S, done)


def _read(connection: socket.socket, waiting: deque[tuple[float, bytes]]) -> None:
    while (payload := read_frame(connection)) is not None:
        waiting.append((time.monotonic(), payload))


if __name__ == "__main__":
    path, at_once, wait_s, work_s = sys.argv[1:]
    read = {
        key: [*map(bytes.fromhex, bodies)]
        for key, bodies in json.loads(Path(path).read_text("utf-8")).items()
    }
    _serve(read, int(at_once), float(wait_s), float(work_s))
