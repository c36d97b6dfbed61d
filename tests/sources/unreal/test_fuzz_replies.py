"""Pictures that are damaged on the wire, and servers that talk nonsense: refused in one line, in time."""

import contextlib
import socket
import struct
import threading

import cv2
import numpy as np
import pytest
from support.unreal import frame

from omniscv.errors import BadReplyError, ServerConnectionError
from omniscv.geometry import Pose
from omniscv.sources import View
from omniscv.sources.codecs import decode
from omniscv.sources.unreal.client import Client
from omniscv.sources.unreal.objects import parse_color
from omniscv.sources.unreal.protocol import MAGIC

VIEW = View(Pose.from_angles((0.3, 0.2, 1.3), 40, 10), 90.0, 9, 7)


PNG = cv2.imencode(".png", np.random.default_rng(3).integers(0, 255, (7, 9, 4), dtype=np.uint8))[1].tobytes()


def test_no_picture_survives_a_changed_byte_unseen():
    """PNG has checksums. Raw depth has none: TCP's and the record's guard it."""
    payload = PNG
    true = decode(payload, "png", "lit", VIEW)
    for at in range(0, len(payload), 5):
        changed = payload[:at] + bytes([payload[at] ^ 0x40]) + payload[at + 1 :]
        with contextlib.suppress(BadReplyError):
            assert np.array_equal(decode(changed, "png", "lit", VIEW), true)


@pytest.mark.parametrize("claimed", [1 << 28, (1 << 32) - 1])
@pytest.mark.parametrize("chunk", [b"IDAT", b"IHDR", b"IEND"])
def test_a_chunk_that_claims_4_gb_is_refused_before_it_is_decoded(chunk, claimed):
    """Regression: OpenCV allocated and cleared all of it, for 12 s, before it found bytes missing."""
    payload = bytearray(PNG)
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
