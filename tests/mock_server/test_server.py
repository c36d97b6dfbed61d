"""What ``serve`` accepts, whatever bytes and commands come, and how a server ends."""

import contextlib
import re
import socket
import struct
import threading
import time
import tracemalloc

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.cases import cases

import mock_server
from mock_server.protocol import MAGIC, MAX_PAYLOAD, FrameError, frame, read_frame
from mock_server.scene import Scene
from mock_server.server import MAX_WAITING, Statistics
from omniscv.errors import BadReplyError
from omniscv.sources.unreal import protocol

NO_SECONDS = [float("inf"), float("nan"), -1, True, "x"]
WRONG = {
    **{key: [None, "double", 3] for key in ("dialect", "depth", "platform", "shared_memory", "files")},
    **dict.fromkeys(("latency_ms", "frames_per_s", "time_step_s"), NO_SECONDS),
    "port": [65536, 0.5, -1, "9000"],
    "fov_deg": [180.0, 0, None],
    "size": [(64, 0), (64,), (1 << 16, 8), 64],
    "host": ["", "é" * 64, "a b", None],
    "seed": ["x", 0.5],
    "folder": ["x"],
    "faults": ["reset"],
}


@pytest.mark.parametrize("key", WRONG)
def test_a_wrong_option_is_named(key):
    for value in WRONG[key]:
        with pytest.raises(ValueError, match=rf"^{key}: expected [^\n]+ got [^\n]+$"):
            mock_server.serve("direction", **{key: value})
    with pytest.raises(ValueError, match=r"^files: expected one of folder; got 'anywhere'$"):
        mock_server.serve("direction", host="0.0.0.0", files="anywhere")


def test_stopping_waits_for_no_client_that_does_not_read_and_for_no_slow_frame(start, open_raw):
    server = start(size=(512, 512))
    client = open_raw(server)
    client.send(*(b"%d:vget /camera/0/lit bmp" % number for number in range(20)))
    client.bytes(100)  # the first of 20 MB is on its way
    server.stop()  # a server that waits exceeds the suite's time limit
    server.stop()
    server = start(frames_per_s=0.01)
    open_raw(server).text("vget /scene/name")
    server.stop()  # a hundred seconds later the suite's time limit is over
    assert not server.running


@pytest.mark.parametrize(
    "sent",
    [b"", frame(b"0:vget /unrealcv/status")[:3], frame(b"0:vget /unrealcv/status")[:20]],
    ids=["nothing", "part of a header", "part of a request"],
)
def test_a_silent_client_does_not_keep_others_out_for_ever(sent, start, open_raw, monkeypatch):
    """The limit is stated, PATIENCE_S; one that has asked something may be silent, as with the plugin."""
    monkeypatch.setattr(mock_server.server, "PATIENCE_S", 0.3)
    server = start()
    silent = open_raw(server)
    silent.socket.sendall(sent)
    second = open_raw(server)
    assert second.text("vget /unrealcv/status")
    waiting = socket.create_connection((server.host, server.port), timeout=1.0)
    with waiting, pytest.raises(TimeoutError):
        waiting.recv(1)
    assert second.text("vget /unrealcv/status")


def test_a_client_that_sends_and_does_not_read_is_dropped_within_a_bound(start, open_raw):
    """The bound is stated: MAX_WAITING. The next client is served."""
    server = start()
    rude = open_raw(server)
    rude.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)  # replies wait in the server
    rude.socket.settimeout(None)  # a server that keeps it waiting exceeds the suite's time limit
    # its reply is as long
    request = b"2:vget /unrealcv/echo " + b"x" * (1 << 20)
    sent = 0
    with contextlib.suppress(ConnectionError):
        while sent < 1 << 30:
            rude.send(request)
            sent += len(request)
    assert sent < 2 * MAX_WAITING  # the system's own buffers hold some
    assert open_raw(server).text("vget /scene/name") == "four-wall"


def test_very_many_different_commands_are_counted_in_little_memory():
    statistics = Statistics()
    for number in range(100_050):
        statistics.add(f"vget /object/{number}/color")
    statistics.add("vget " + "x" * 1000)
    assert len(statistics.counts) == 100_001
    assert statistics.counts["vget"] == 51
    assert statistics.total("vget") == 100_051


DIGITS = "1" * 200_000
LONG = [
    "vset /camera/0/fov {}x",
    "vset /camera/0/location {0} {0} {0}x",
    "vset /object/Table/color {0} {0} {0}x",
    "vget /object/{}/color",
    "vget /object//color{}",
    "vrun {0} {0} {0} {0} x\t",
    "vrun " * 50_000 + "\t",
    "vget /viewmode" + " " * 200_000 + "x",
    "{}",
    "0:" + "vget /camera/" * 20_000,
]


@pytest.mark.parametrize("dialect", ["L", "N2"])  # N2 has the commands of M and N1
def test_long_commands_take_a_time_in_proportion_to_their_length(dialect, start, open_raw):
    """A pattern that tries every split of 200,000 digits takes minutes; this takes milliseconds."""
    client = open_raw(start(dialect=dialect, size=(8, 8)))
    started = time.process_time()
    for text in LONG:
        assert client.ask(text.format(DIGITS))
    client.send(DIGITS.encode())  # without a colon it has no id
    if dialect == "L":
        assert client.frame().startswith(b"error: Malformat raw message '111")
    assert client.text("vget /scene/name") == "four-wall"
    assert time.process_time() - started < 10


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
        self.data = data
        self.piece = piece
        self.most = 0

    def recv(self, most):
        self.most = max(self.most, most)
        block = self.data[: min(most, self.piece)]
        self.data = self.data[min(most, self.piece) :]
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


def test_kernels_are_ready_before_the_first_request(monkeypatch):
    """Where none are built, numba compiles them for longer than clients wait."""
    seen = []
    view = Scene.view
    monkeypatch.setattr(Scene, "view", lambda *given: seen.append(threading.current_thread()) or view(*given))
    with mock_server.serve("four-wall"):
        assert seen == [threading.main_thread()]
