"""How many captures a second come from servers that answer once a tick, against what protocols allow.

Mock servers of 60 ticks a second, each in a process of its own, with 5 and 30 ms of latency; faces of 16 px
in colour, mask and depth, so that little is left but the wire. The limit is a client that keeps the rules of
the protocol and does nothing else: plugin 1.x (dialects M, N1, N2) may have any number of requests under way,
0.3.10 (L) needs three exchanges after each move. "4 ms a reply" is an engine that takes 4 ms for every reply,
without the processor: it stands for a game on a machine of its own, and several of them share no core. The
limit of several servers is that of one, times their number.
"""

import time
from collections.abc import Iterator
from itertools import islice

from benches import Figure, Reference
from benches._engines import bare, engines
from benches._views import MODES, requests
from omniscv.sources.registry import open_sources

FACES, WARM_UP = 6 * len(MODES), 2 * len(MODES)
CALM_S = 60.0  # of a machine that others use


def measure(quick: bool) -> Iterator[Figure]:
    wanted = [("N1", 5, 0.0, (1,))] if quick else [*ways()]
    for dialect, latency_ms, reply_s, counts in wanted:
        viewpoints = 1 if quick else 2 if dialect == "L" else 24
        count = FACES * viewpoints
        with engines(max(counts), dialect, latency_ms, 16, reply_s) as addresses:
            limit = max(bare_rate(addresses[0], dialect, count) for _ in range(2))
            for servers in counts:
                ours = max(live_rate(addresses[:servers], servers * count) for _ in range(2))
                work = f"{1e3 * reply_s:.0f} ms a reply" if reply_s else "mock"
                allowed = Reference("protocol", servers * limit)
                name = f"{dialect}, {latency_ms} ms latency, {servers} x {work}"
                yield Figure("live, 60 ticks/s", name, "captures/s", ours, limit=allowed)


def ways() -> Iterator[tuple[str, int, float, tuple[int, ...]]]:
    """Yield dialect, latency, seconds a reply, and numbers of servers."""
    for latency_ms in (5, 30):
        for dialect in ("L", "M", "N1", "N2"):
            yield dialect, latency_ms, 0.0, (1,)
            yield dialect, latency_ms, 0.004, (1, 2, 4) if dialect == "N1" else (1,)


def bare_rate(address: str, dialect: str, count: int) -> float:
    """Return captures a second that the protocol allows."""
    captures = bare(address, dialect, islice(requests(16), count))
    next(captures)
    started = time.perf_counter()
    for _ in captures:
        pass
    return count / (time.perf_counter() - started)


def live_rate(addresses: list[str], count: int) -> float:
    """Return captures a second of omniscv."""
    with open_sources(addresses, timeout_s=CALM_S, patience_s=CALM_S) as source:
        for _ in source.capture(islice(requests(16), WARM_UP)):
            pass
        started = time.perf_counter()
        for _ in source.capture(islice(requests(16), count)):
            pass
        return count / (time.perf_counter() - started)
