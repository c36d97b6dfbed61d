"""The engine's frames: the requests received are answered together, then the world moves on."""

import contextlib
import itertools
import queue
import threading
from collections import Counter, deque
from collections.abc import Iterator

from mock_server.dialects.common import Dialect, Later

Request = tuple[float, bytes]
"""Time of arrival (seconds, monotonic) and payload."""

Requests = queue.Queue[Request | None]
"""None: the client has left."""


class Statistics:
    """Counts the commands received, by their texts."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def total(self, start: str) -> int:
        """Return how many commands began with ``start``."""
        return sum(count for text, count in self.counts.items() if text.startswith(start))


def replies(
    dialect: Dialect, statistics: Statistics, requests: Requests, stopping: threading.Event
) -> Iterator[Request]:
    """Yield one client's replies, each with the time of its request, until the client leaves.

    Frames end by themselves, at the frame rate of the settings, while no request comes.
    """
    pending: deque[tuple[int, float, int, Later]] = deque()  # frame, request's time, id, reply
    held: list[Request] = []
    dialect.held = 0
    for frame in itertools.takewhile(lambda _: not stopping.is_set(), itertools.count()):
        for request in _received(dialect, requests):
            if request is None:
                return
            held.append(request)
            if len(held) < dialect.held:
                continue
            dialect.held = 0
            for received, payload in held:
                identity, reply = _reply(dialect, statistics, payload)
                if isinstance(reply, Later):
                    pending.append((frame + reply.frames, received, identity, reply))
                elif reply is not None:
                    yield received, reply
            held.clear()
        dialect.tick()
        while pending and pending[0][0] <= frame:
            _, received, identity, reply = pending.popleft()
            yield received, _payload(identity, reply.make())


def _received(dialect: Dialect, requests: Requests) -> list[Request | None]:
    """Return the requests of the next frame; none if none comes within a frame's time."""
    received: list[Request | None] = []
    most = dialect.requests_per_frame
    with contextlib.suppress(queue.Empty):
        received.append(requests.get(timeout=1 / dialect.settings.frames_per_s))
        while most is None or len(received) < most:
            received.append(requests.get_nowait())
    return received


def _reply(dialect: Dialect, statistics: Statistics, payload: bytes) -> tuple[int, bytes | Later | None]:
    """Return a request's id and reply; None where the plugin does not reply."""
    parsed = dialect.parse(payload)
    if parsed is None:
        return 0, dialect.malformed(payload)
    identity, text = parsed
    statistics.counts[text] += 1
    dialect.world.on_command(text)
    reply = dialect.answer(text)
    return identity, reply if isinstance(reply, Later) else _payload(identity, reply)


def _payload(identity: int, body: str | bytes | None) -> bytes:
    body = body or "ok"  # the plugin replies this to an empty success, early or late
    return b"%d:%b" % (identity, body if isinstance(body, bytes) else body.encode())
