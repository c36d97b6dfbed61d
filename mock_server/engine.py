"""The engine's frames: all received requests are answered, then the world advances."""

import contextlib
import itertools
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator

from mock_server.dialects.common import Dialect, Later

Request = tuple[float, bytes]
"""Time of arrival (seconds, monotonic) and payload."""

MAX_WAITING = 1 << 25
"""The most bytes of one client's waiting requests, with ``_OVERHEAD`` for each."""

_OVERHEAD = 256  # bytes of memory per request beside its text
_MAX_TEXTS, _MAX_TEXT = 100_000, 200


class Requests:
    """The waiting requests of one client."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Request | None] = queue.SimpleQueue()
        self._lock, self._waiting = threading.Lock(), 0

    def put(self, payload: bytes) -> bool:
        """Add a request; return False if too many wait."""
        with self._lock:
            self._waiting += len(payload) + _OVERHEAD
            if self._waiting > MAX_WAITING:
                return False
        self._queue.put((time.monotonic(), payload))
        return True

    def end(self) -> None:
        """Mark the end of the requests: the client has left."""
        self._queue.put(None)

    def get(self, timeout_s: float) -> Request | None:
        """Return the next request, None at the end; raise queue.Empty if none comes in time."""
        return self._queue.get(timeout=timeout_s) if timeout_s else self._queue.get_nowait()

    def answered(self, payload: bytes) -> None:
        """Forget a request."""
        with self._lock:
            self._waiting -= len(payload) + _OVERHEAD


class Statistics:
    """Counts of received commands, by the starts of their texts; beyond ``_MAX_TEXTS``, by their verbs."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def add(self, text: str) -> None:
        """Count a command."""
        text = text[:_MAX_TEXT]
        known = len(self.counts) < _MAX_TEXTS or text in self.counts
        self.counts[text if known else text.partition(" ")[0][:5]] += 1

    def total(self, start: str) -> int:
        """Return how many commands began with ``start``."""
        return sum(count for text, count in self.counts.items() if text.startswith(start))


def replies(
    dialect: Dialect, statistics: Statistics, requests: Requests, stopping: threading.Event
) -> Iterator[Request]:
    """Yield one client's replies, with the times of their requests, until the client leaves.

    While no request comes, frames end at the frame rate of the settings.
    """
    pending: deque[tuple[int, float, int, Later]] = deque()  # frame, request's time, id, reply
    batch: list[Request] = []
    dialect.held = 0
    for frame in itertools.takewhile(lambda _: not stopping.is_set(), itertools.count()):
        for request in _received(dialect, requests):
            if request is None:
                return
            batch.append(request)
            if len(batch) < dialect.held:
                continue
            dialect.held = 0
            for received, payload in batch:
                requests.answered(payload)
                identity, reply = _reply(dialect, statistics, payload)
                if isinstance(reply, Later):
                    pending.append((frame + reply.frames, received, identity, reply))
                elif reply is not None:
                    yield received, reply
            batch.clear()
        dialect.tick()
        while pending and pending[0][0] <= frame:
            _, received, identity, reply = pending.popleft()
            yield received, _payload(identity, reply.make())


def _received(dialect: Dialect, requests: Requests) -> list[Request | None]:
    """Return the requests of the next frame; an empty list if none comes in a frame's time."""
    received: list[Request | None] = []
    most = dialect.requests_per_frame
    with contextlib.suppress(queue.Empty):
        received.append(requests.get(1 / dialect.settings.frames_per_s))
        while most is None or len(received) < most:
            received.append(requests.get(0))
    return received


def _reply(dialect: Dialect, statistics: Statistics, payload: bytes) -> tuple[int, bytes | Later | None]:
    """Return a request's id and reply; None if the plugin does not reply."""
    parsed = dialect.parse(payload)
    if parsed is None:
        return 0, dialect.malformed(payload)
    identity, text = parsed
    statistics.add(text)
    dialect.world.on_command(text)
    reply = dialect.answer(text)
    return identity, reply if isinstance(reply, Later) else _payload(identity, reply)


def _payload(identity: int, body: str | bytes | None) -> bytes:
    body = body or "ok"  # the plugin's reply to an empty success
    return b"%d:%b" % (identity, body if isinstance(body, bytes) else body.encode())
