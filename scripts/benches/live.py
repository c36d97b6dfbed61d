"""How many captures a second come from servers that answer once a tick, against what protocols allow.

Servers of 60 ticks a second, with 5 and 30 ms of latency, each in a process of its own, that reply with
pictures a mock server made before: their engine costs no processor, so neither other work on the machine nor
their number counts for much. Faces of 16 px in colour, mask and depth, so that little is left but the wire.
The limit is a client that keeps the rules of the protocol and does nothing else: plugin 1.x (M, N1, N2,
N3) may have any number of requests under way, 0.3.10 (L) needs three exchanges after each move. "4 ms" is an
engine that takes as long for every picture. The limit of several servers is that of one, times their number.
"""

import time
from collections.abc import Iterator
from itertools import islice

from benches import Figure, Reference
from benches._bare import bare
from benches._replaying import Replies, learned, servers
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Request, View
from omniscv.sources.registry import open_sources

MODES = ("lit", "object_mask", "depth")
FACES, WARM_UP = 6 * len(MODES), 2 * len(MODES)
CALM_S = 60.0  # of a machine that others use
PICTURE_S = 0.004


def measure(quick: bool) -> Iterator[Figure]:
    for dialect in ("N3",) if quick else ("L", "M", "N1", "N2", "N3"):
        replies = known_replies(dialect)
        count = FACES * (1 if quick else 4 if dialect == "L" else 48)
        for latency_ms in (5,) if quick else (5, 30):
            numbers = (1, 2, 4) if dialect == "N3" and not quick else (1,)
            with servers(max(numbers), dialect, latency_ms / 1e3, PICTURE_S, replies) as addresses:
                limit = max(bare_rate(addresses[0], dialect, count) for _ in range(2))
                for number in numbers:
                    ours = max(live_rate(addresses[:number], number * count) for _ in range(2))
                    name = (
                        f"{dialect}, {latency_ms} ms latency, {number} x {1e3 * PICTURE_S:.0f} ms a picture"
                    )
                    allowed = Reference("protocol", number * limit)
                    yield Figure("live, 60 ticks/s", name, "captures/s", ours, limit=allowed)


def known_replies(dialect: str) -> Replies:
    """Return what a mock server replies to both clients."""

    def drive(address: str) -> None:
        live_rate([address], 3 * FACES)

    def drive_bare(address: str) -> None:
        bare_rate(address, dialect, FACES)

    return learned(dialect, 16, drive_bare) | learned(dialect, 16, drive)


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
    # Replayed pictures do not depend on the exposure, so that none would be found.
    with open_sources(addresses, exposure="game", timeout_s=CALM_S, patience_s=CALM_S) as source:
        for _ in source.capture(islice(requests(16), WARM_UP)):
            pass
        started = time.perf_counter()
        for _ in source.capture(islice(requests(16), count)):
            pass
        return count / (time.perf_counter() - started)


def requests(size: int) -> Iterator[Request]:
    """Yield the faces of viewpoints on a path without end, all modes of a view together."""
    viewpoint = 0
    while True:
        center = (-1 + 0.01 * (viewpoint % 200), 0.1, 1.5)
        for _, R_w_c in cube_rotations():
            view = View(Pose(center, R_w_c), 90.0, size, size)
            for mode in MODES:
                yield Request(view, mode)
        viewpoint += 1
