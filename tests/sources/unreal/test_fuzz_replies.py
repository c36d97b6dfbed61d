"""Whatever a server sends, the live source answers with a capture or an error of omniscv, in time."""

import contextlib
import io
import socket
import struct
import threading

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases
from support.unreal import MODES, frame

from omniscv.errors import BadReplyError, ServerConnectionError
from omniscv.geometry import Pose
from omniscv.sources import View
from omniscv.sources.codecs import decode, encodings
from omniscv.sources.unreal.client import Client
from omniscv.sources.unreal.objects import parse_color
from omniscv.sources.unreal.protocol import MAGIC

VIEW = View(Pose.from_angles((0.3, 0.2, 1.3), 40, 10), 90.0, 9, 7)


# Payloads: true ones, spoiled, and nonsense that starts well.


def true_payloads():
    """Pictures with all of PNG's kinds of colour, and arrays of depth and of colours."""
    rng = np.random.default_rng(3)
    for channels in ((), (3,), (4,)):
        yield bytes(cv2.imencode(".png", rng.integers(0, 255, (7, 9, *channels), dtype=np.uint8))[1])
    for array in (rng.random((7, 9), dtype=np.float32), rng.integers(0, 255, (7, 9, 3), dtype=np.uint8)):
        stream = io.BytesIO()
        np.save(stream, array)
        yield stream.getvalue()


TRUE = list(true_payloads())


@st.composite
def spoiled(draw):
    """A true payload with bytes changed, cut, doubled, or swapped against those of another."""
    data = bytearray(draw(st.sampled_from(TRUE)))
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(0, 60) | st.integers(0, len(data) - 1))  # headers more often
        data[at] = draw(st.integers(0, 255))
    start = draw(st.integers(0, len(data)))
    other = bytes(draw(st.sampled_from(TRUE)))
    kind = draw(st.sampled_from(["as it is", "as it is", "cut", "doubled", "swapped"]))
    tails = {"as it is": data[start:], "cut": b"", "doubled": data + data, "swapped": other[start:]}
    return bytes(data[:start] + tails[kind])


def npy(header):
    """An array's header, as text, and a few bytes."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 32


SHAPES = st.lists(st.sampled_from([0, 1, 7, 9, -1, 1 << 40]), max_size=4).map(tuple)
HEADERS_NPY = st.builds(
    "{{'descr': {!r}, 'fortran_order': {}, 'shape': {}, }}\n".format,
    st.sampled_from(["<f4", "<f8", "|u1", "|O", ">f4", "<U9", "junk", [("a", "<f4")], "<c8", "|V4", "<m8"]),
    st.sampled_from([True, False, 1, None]),
    SHAPES | st.just("((7, 9)"),
)
ARRAYS = (HEADERS_NPY | st.text(max_size=60)).map(lambda text: npy(text.encode()))
STARTS = st.builds(
    lambda start, rest: start + rest,
    st.sampled_from(
        [b"\x89PNG\r\n\x1a\n", b"\x93NUMPY", b"\x93NUMPY\x02\0", b"\x93NUMPY\x03\0", b"\x93NUMPY\x09\0"]
    ),
    st.binary(max_size=60),
)


@cases(60)
@given(
    spoiled() | ARRAYS | STARTS | st.binary(max_size=60), st.sampled_from(encodings()), st.sampled_from(MODES)
)
def test_any_payload_is_pixels_of_the_right_size_or_refused(payload, encoding, mode):
    with contextlib.suppress(BadReplyError):
        pixels = decode(payload, encoding, mode, VIEW)
        assert pixels.shape[:2] == (7, 9)
        assert not pixels.flags.writeable
        if mode == "depth":
            assert pixels.dtype == np.float32
            assert (pixels >= 0).all()


def test_no_picture_survives_a_changed_byte_unseen():
    """PNG has checksums. Raw depth has none: TCP's and the record's guard it."""
    payload = TRUE[2]
    true = decode(payload, "png", "lit", VIEW)
    for at in range(0, len(payload), 5):
        changed = payload[:at] + bytes([payload[at] ^ 0x40]) + payload[at + 1 :]
        with contextlib.suppress(BadReplyError):
            assert np.array_equal(decode(changed, "png", "lit", VIEW), true)


@pytest.mark.parametrize("claimed", [1 << 28, (1 << 32) - 1])
@pytest.mark.parametrize("chunk", [b"IDAT", b"IHDR", b"IEND"])
def test_a_chunk_that_claims_4_gb_is_refused_before_it_is_decoded(chunk, claimed):
    """Regression: OpenCV allocated and cleared all of it, for 12 s, before it found bytes missing."""
    payload = bytearray(TRUE[2])
    at = payload.index(chunk)
    payload[at - 4 : at] = struct.pack(">I", claimed)
    with pytest.raises(BadReplyError, match="chunks do not add up"):
        decode(bytes(payload), "png", "lit", VIEW)


# A server that talks nonsense.


def test_another_servers_greeting_is_refused():
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def greet():
            with listener.accept()[0] as connection:
                connection.sendall(frame(b"220 mail.example ESMTP"))

        threading.Thread(target=greet, daemon=True).start()
        with pytest.raises(ServerConnectionError, match=r"expected 'connected to ...', got .*220 mail"):
            Client(listener.getsockname(), timeout_s=20)


def test_a_greeting_that_trickles_for_ever_is_given_up():
    """A deadline for every byte would never pass; this one is for the whole frame."""
    listener, done = socket.create_server(("127.0.0.1", 0)), threading.Event()

    def trickle():
        with listener, listener.accept()[0] as connection, contextlib.suppress(OSError):
            connection.sendall(struct.pack("<II", MAGIC, 1 << 20))
            while not done.wait(0.01):
                connection.sendall(b"c")

    threading.Thread(target=trickle, daemon=True).start()
    with pytest.raises(ServerConnectionError, match=r"no greeting within 0\.2 s"):
        Client(listener.getsockname(), timeout_s=0.2)  # else the suite's time limit is the judge
    done.set()


@pytest.mark.parametrize(
    "text", ["", "(R=1,G=2,B=3)", "(R=1,G=2,B=3,A=4)x", "R", "(R=٣,G=2,B=3,A=4)", "(R=256,G=2,B=3,A=4)"]
)
def test_a_colour_that_is_none_is_refused(text):
    with pytest.raises(BadReplyError, match="expected a colour"):
        parse_color(text)
