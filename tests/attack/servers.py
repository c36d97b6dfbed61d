"""Hostile servers, over real sockets: connections that fail, and replies that lie."""

import random
import threading
import time
from contextlib import contextmanager

from support.hostile import REPLIES
from support.unreal import relayed

import mock_server
from attack.commands import nothing_left, ran, require
from attack.samples import JOB, SIZE, pictures, sample, server

SECONDS = 25
"""For a command whose server may be silent: timeout 0.4 s, one retry."""

FAULTS = (
    "delay", "drip", "missing", "wrong-id", "no-id", "clicked", "cut", "bad-magic", "zero-size", "huge",
    "reset", "no-greeting", "second-client",
)  # fmt: skip
"""Of the connection. Whatever comes of them, images are the honest ones."""


@contextmanager
def failing(rng):
    """The address of an honest server whose connections fail."""
    share = rng.choice([0.05, 0.3, 1.0])
    faults = [f"{name}@{share}" for name in rng.sample(FAULTS, rng.choice([1, 1, 2]))]
    options = {"port": 0, "size": (SIZE, SIZE), "faults": faults, "seed": rng.randrange(1 << 30)}
    with mock_server.serve(server().scene, **options) as running:
        yield running.uri


def spoiled(rng, body):
    """Another reply: nonsense, another's, or this one cut, doubled, turned round or with bits flipped."""
    flipped = bytearray(body)
    for _ in range(rng.choice([1, 10]) if body else 0):
        flipped[rng.randrange(min(len(body), rng.choice([128, 1 << 30])))] ^= 1 << rng.randrange(8)
    cut = body[: rng.randrange(len(body) + 1)]
    noise = body[:8] + rng.randbytes(300)
    return rng.choice([bytes(flipped), cut, noise, body * 2, body[::-1], *REPLIES.values()])


@contextmanager
def lying(rng):
    """The address of a server that spoils the replies that a seed chooses, all of one kind."""
    seed = rng.random()
    first = rng.choice([0, 0, 3, 10, 20])
    share = rng.choice([0.05, 0.3, 1.0])
    kind = rng.choice([b"\x89PNG", b"\x93NUM", None, None])
    count = iter(range(10**9))
    lock = threading.Lock()

    def change(command, forward):
        body = forward(command)
        with lock:
            number = next(count)
        draw = random.Random(f"{seed} {number}")
        own = body[:4] if body[:4] in (b"\x89PNG", b"\x93NUM") else None
        return spoiled(draw, body) if number >= first and own == kind and draw.random() < share else body

    with relayed(server(), change) as uri:
        yield uri


def case(rng, folder):
    """A hostile server is an error in one line, in time; where only the transport lied, images are right."""
    true = sample()
    honest = rng.random() < 0.5
    with nothing_left(folder) as work, (failing if honest else lying)(rng) as uri:
        (work / "job.yaml").write_text(JOB.format(source=uri))
        started = time.monotonic()
        kind = rng.random()
        if kind < 0.6:
            outcome = ran(["render", "job.yaml"])
            if outcome.code == 0 and honest:
                require(pictures(work / "images") == true.images, "images differ from the honest server's")
            half = [each.name for each in work.rglob("*part*")]
            require(not half, f"half files are left: {half}")
        elif kind < 0.7:
            ran(["doctor", uri, "--timeout", "0.1", "--patience", "1"])
        else:
            ran(["record", "job.yaml", "--out", "room.sqlite"])
            if (work / "room.sqlite").exists():
                verified = ran(["recording", "check", "room.sqlite"])
                require(verified.code == 0, f"the recording does not verify: {verified.out}{verified.err}")
        took = time.monotonic() - started  # the doctor makes hundreds of exchanges, and may lose many
        require(took < SECONDS or 0.6 <= kind < 0.7, f"{took:.1f} s")
