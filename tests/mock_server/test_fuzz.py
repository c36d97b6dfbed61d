"""Whatever bytes come: no crash, no hang, no memory for what is only claimed."""

import contextlib
import re
import struct
import tracemalloc

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.cases import cases

from mock_server.protocol import MAGIC, MAX_PAYLOAD, FrameError, frame, read_frame
from omniscv.errors import BadReplyError
from omniscv.sources.unreal import protocol

SIZES = st.sampled_from([0, 1, 2, 7, 8, 1 << 20, MAX_PAYLOAD, MAX_PAYLOAD + 1, (1 << 31) - 1, (1 << 32) - 1])
HEADERS = st.builds(
    lambda magic, size: struct.pack("<II", magic, size),
    st.sampled_from([MAGIC, MAGIC, MAGIC, 0, int.from_bytes(struct.pack("<I", MAGIC), "big")]),
    SIZES | st.integers(0, (1 << 32) - 1),
)
FRAMES = st.binary(min_size=1, max_size=40).map(frame)
STREAMS = st.lists(FRAMES | HEADERS | st.binary(max_size=40), max_size=6).map(b"".join)


class Wire:
    """A connection that has received some bytes, handed out in pieces, and then ends."""

    def __init__(self, data, piece=7):
        self.data, self.piece, self.most = data, piece, 0

    def recv(self, most):
        self.most = max(self.most, most)
        block, self.data = self.data[: min(most, self.piece)], self.data[min(most, self.piece) :]
        return block


def by_the_client(wire):
    """As the live source of omniscv reads a frame; None at the end of the stream."""
    try:
        return protocol.read_frame(wire.recv)
    except ConnectionError:
        return None


both = pytest.mark.parametrize(
    ("read", "largest", "at_once"),
    [(read_frame, MAX_PAYLOAD, 1 << 16), (by_the_client, protocol.MAX_PAYLOAD, 1 << 20)],
    ids=["server", "client"],
)
REFUSED = (FrameError, BadReplyError)


@both
@cases(50)
@given(STREAMS, st.integers(1, 50))
def test_any_stream_is_read_to_its_end_or_refused(read, largest, at_once, data, piece):
    wire = Wire(data, piece)
    payloads = []
    with contextlib.suppress(*REFUSED):
        while (payload := read(wire)) is not None:
            payloads.append(payload)
    assert data.startswith(b"".join(map(frame, payloads)))
    assert wire.most <= at_once


@both
def test_memory_follows_what_comes_not_what_is_claimed(read, largest, at_once):
    tracemalloc.start()
    assert read(Wire(struct.pack("<II", MAGIC, largest) + b"x" * 1000, 1000)) is None
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 20


# Commands: templates with arguments of every kind, and sheer nonsense.

NAMES = ["Table", "Vase", "Nobody", "", "../../etc/passwd", "é", "a/b", "FusionCameraActor_0"]
WORDS = st.sampled_from([*NAMES, "png", "npy", "bmp", "x.png", "../x.png", "/x.npy", "lit", "object_mask"])
COUNTS = st.sampled_from(["0", "1", "2", "16", "", "-1", "255", "99999999", "9" * 30])
DECIMALS = st.sampled_from(["0", "-0.0", "1.5", "90", "-90", "1e5", "nan", "inf", ".5", "5.", "9" * 400])


def filled(template):
    """Strategy of commands of a template."""
    parts = re.split(r"(\[\w+\])", template)
    kinds = {"[str]": WORDS, "[uint]": COUNTS, "[float]": DECIMALS}
    return st.tuples(*(kinds.get(part, st.just(part)) for part in parts)).map("".join)


@pytest.mark.parametrize("name", ["L", "N2"])  # N2 has the commands of M and N1
def test_any_command_is_answered(name, start, open_raw):
    """Over a socket, so that a handler that raises ends the connection and is seen."""
    client = open_raw(start(dialect=name, size=(8, 8)))
    templates = client.text("vget /unrealcv/help").split("\n")[::2]
    known = st.sampled_from([t for t in templates if t and "vbatch" not in t]).flatmap(filled)
    anything = st.text(st.characters(exclude_characters="\n\0", exclude_categories=["Cs"]), max_size=30)

    @cases(50)
    @given(known | anything)
    def answered(command):
        assert client.ask(command.encode())

    answered = example("vget /unrealcv/echo ")(answered)  # regression: a late reply was empty on 0.3.10
    answered()
    assert client.text("vget /unrealcv/version") in ("0.3.10", "1.0.1")
