"""The engine's frames: what requests have come is answered together, then the world moves on."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from mock_server.dialects.common import Dialect, Later

Requests = queue.Queue[tuple[float, bytes] | None]
"""Times and payloads of requests; None says that the client has left."""


class Statistics:
    """How many requests of each command came."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def note(self, text: str) -> None:
        """Counts a command."""
        self.counts[text] += 1

    def total(self, start: str) -> int:
        """How many commands began with ``start``."""
        return sum(count for text, count in self.counts.items() if text.startswith(start))


@dataclass
class _Pending:
    """A reply that waits for frames to pass."""

    frames: int
    identity: int
    make: Callable[[], str | bytes]
    came: float = 0.0


class Engine:
    """Answers requests in a dialect, frame after frame.

    Args:
        dialect: the commands.
        statistics: told of every command.
        frame_s: seconds after which a frame ends though no request has come.
    """

    def __init__(self, dialect: Dialect, statistics: Statistics, frame_s: float) -> None:
        self._dialect, self._statistics, self._frame_s = dialect, statistics, frame_s

    def replies(self, requests: Requests, stopping: threading.Event) -> Iterator[tuple[float, bytes]]:
        """One client's replies, each with the time its request came, until the client leaves."""
        pending: list[_Pending] = []
        held: list[tuple[float, bytes]] = []
        self._dialect.held = 0
        while not stopping.is_set():
            for request in self._come(requests):
                if request is None:
                    return
                held.append(request)
                if len(held) < self._dialect.held:
                    continue
                self._dialect.held = 0
                for came, payload in held:
                    reply = self._reply(payload)
                    if isinstance(reply, _Pending):
                        pending.append(replace(reply, came=came))
                    elif reply is not None:
                        yield came, reply
                held.clear()
            self._dialect.tick()
            for each in pending:
                each.frames -= 1
            while pending and pending[0].frames < 0:
                done = pending.pop(0)
                yield done.came, _payload(done.identity, done.make())

    def _come(self, requests: Requests) -> list[tuple[float, bytes] | None]:
        """The requests that a frame begins with; none if none comes for a frame's time."""
        come: list[tuple[float, bytes] | None] = []
        most = self._dialect.requests_per_frame
        with contextlib.suppress(queue.Empty):
            come.append(requests.get(timeout=self._frame_s))
            while most is None or len(come) < most:
                come.append(requests.get_nowait())
        return come

    def _reply(self, payload: bytes) -> bytes | _Pending | None:
        """The reply's payload, what becomes one later, or None where the plugin stays silent."""
        parsed = self._dialect.parse(payload)
        if parsed is None:
            return self._dialect.malformed(payload)
        identity, text = parsed
        self._statistics.note(text)
        self._dialect.world.hear(text)
        reply = self._dialect.answer(text)
        if isinstance(reply, Later):
            return _Pending(reply.frames, identity, reply.make)
        return _payload(identity, reply)


def _payload(identity: int, body: str | bytes) -> bytes:
    body = body or "ok"  # what the plugin makes of an empty success, early or late
    return b"%d:%b" % (identity, body if isinstance(body, bytes) else body.encode())
