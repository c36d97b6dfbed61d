"""What UnrealCV's own tests of a server expect, one by one, where the plugin's source does what they expect.

The table holds their expectations, not their text. ``differs`` says what the source of a dialect replies
where it is something else; the protocol reference has the lines.
"""

import re
from contextlib import ExitStack
from types import MappingProxyType
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from support.expected_views import npy, png
from support.wire import RawClient
from support.worlds import DIALECTS

import mock_server

MODERN = ("M", "N1", "N2", "N3")
SIZE = (16, 12)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Where servers write, and clients in the same folder read."""
    return tmp_path_factory.mktemp("files")


@pytest.fixture(scope="module")
def asking(files):
    """Returns how to request something of a dialect, all of one server: text, or the bytes of a picture."""
    clients = {}
    with ExitStack() as opened:

        def ask_of(dialect):
            if dialect not in clients:
                options = {"dialect": dialect, "size": SIZE, "folder": files, "frames_per_s": 1000}
                server = opened.enter_context(mock_server.serve("four-wall", **options))
                clients[dialect] = RawClient(server)
                opened.callback(clients[dialect].socket.close)
                if dialect != "0.3.10":
                    clients[dialect].text("vset /cameras/spawn")
            return clients[dialect].ask

        yield ask_of


def no_error(reply):
    return not reply.startswith(b"error")


def ok(reply):
    return reply == b"ok"


def says(*parts):
    return lambda reply: no_error(reply) and all(part.encode() in reply for part in parts)


def three_numbers(reply):
    return len([float(word) for word in reply.decode().split()]) == 3


def is_png(reply):
    return png(reply).shape == (*SIZE[::-1], 4)


def is_picture(reply):
    return cv2.imdecode(np.frombuffer(reply, np.uint8), cv2.IMREAD_COLOR).shape == (*SIZE[::-1], 3)


def is_depth(reply):
    return npy(reply).shape == SIZE[::-1]


def version(reply):
    return [int(part) for part in reply.decode().split(".")] >= [0, 3, 8]


class Row(NamedTuple):
    """An expectation: of which test, what is requested, what the reply must be, and of which dialects.

    ``differs`` has the replies of dialects whose source does otherwise.
    """

    test: str
    command: str
    expected: object
    dialects: tuple = DIALECTS
    differs: MappingProxyType = MappingProxyType({})


NOT_IMPLEMENTED = dict.fromkeys(MODERN, "error Not Implemented")
NO_FILE_TYPE = dict.fromkeys(MODERN, "error Invalid filename type, filename test.png")
LIT_WANTS_A_WORD = {
    **dict.fromkeys(("M", "N1"), "error Can not find a handler for URI 'vget /camera/0/lit'"),
    **dict.fromkeys(("N2", "N3"), "error No handler found for URI 'vget /camera/0/lit'"),
}
TABLE = [
    Row("connection: connection", "vget /unrealcv/status", no_error),
    Row("connection: echo", "vget /unrealcv/echo test", says("test")),
    *(Row("connection: viewmode", f"vset /viewmode {mode}", ok)
      for mode in ("depth", "object_mask", "normal", "lit")),
    Row("contract: status", "vget /unrealcv/status", says("Port:", "Width:", "Height:")),
    Row("contract: help", "vget /unrealcv/help", says("vget /unrealcv/status", "vget /unrealcv/version")),
    Row("contract: version", "vget /unrealcv/version", version),
    Row("contract: echo", "vget /unrealcv/echo contract_check", lambda reply: reply == b"contract_check"),
    Row("contract: unknown", "vget /unrealcv/absent", re.compile(b"error Can not find a handler").match,
        differs=dict.fromkeys(("N2", "N3"), "error No handler found for URI 'vget /unrealcv/absent'")),
    Row("camera: control", "vget /camera/0/location", three_numbers),
    Row("camera: control", "vget /camera/0/rotation", three_numbers),
    *(Row("camera: png", f"vget /camera/0/{mode} png", is_png) for mode in ("lit", "object_mask", "normal")),
    Row("camera: npy", "vget /camera/0/depth npy", is_depth),
    *(Row("camera: file", f"vget /camera/0/{mode} test.png", is_picture)
      for mode in ("lit", "object_mask", "normal")),
    Row("camera: file", "vget /camera/0/depth test.png", is_picture, differs=NO_FILE_TYPE),
    Row("camera: exr file", "vget /camera/0/depth test.exr", no_error, ("0.3.10",)),
    Row("stereo: pause", "vset /action/game/pause", ok),
    Row("stereo: pause", "vget /camera/0/lit", no_error,
        differs=LIT_WANTS_A_WORD),
    Row("stereo: pause", "vget /camera/1/lit png", is_png, MODERN),
    Row("stereo: pause", "vset /action/game/pause", ok),
    *(Row("stereo: distance", f"vset /action/eyes_distance {cm}", ok, differs=NOT_IMPLEMENTED)
      for cm in (20, 40, 60)),
]  # fmt: skip


@pytest.mark.parametrize("dialect", DIALECTS)
def test_expectations(asking, files, dialect):
    """In the order of the table: later tests take the server as earlier ones leave it."""
    ask = asking(dialect)
    for row in TABLE:
        if dialect in row.dialects:
            reply, where = ask(row.command), (row.test, row.command)
            if dialect in row.differs:
                assert (*where, reply.decode()) == (*where, row.differs[dialect])
            else:
                reply = (files / reply.decode()).read_bytes() if row.test == "camera: file" else reply
                assert row.expected(reply), (*where, reply[:100])


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_listed_object_has_a_colour(asking, dialect):
    """Their test splits the list at every space, and so takes the last one of 1.x for a name."""
    ask = asking(dialect)
    listed = ask("vget /objects").decode()
    assert listed.endswith(" ") == (dialect != "0.3.10")
    names = listed.split()
    assert len(names) > 5
    for name in names:
        assert re.fullmatch(rb"\(R=\d+,G=\d+,B=\d+,A=255\)", ask(f"vget /object/{name}/color"))


def test_the_first_eye_is_the_pawns(asking):
    """Of 0.3.10; its second eye exists with the right eye enabled alone."""
    ask = asking("0.3.10")
    for turn in ("10 20 30", "-45 170 0"):
        assert ask(f"vset /camera/0/rotation {turn}") == b"ok"
        np.testing.assert_allclose(
            *([float(word) for word in ask(f"vget /{of}/location").split()] for of in ("actor", "camera/0")),
            atol=0.01,
        )


@pytest.mark.parametrize("dialect", DIALECTS)
def test_colours_and_masks_of_a_room_have_one_size(asking, dialect):
    lit, mask = (png(asking(dialect)(f"vget /camera/0/{mode} png")) for mode in ("lit", "object_mask"))
    assert lit.shape == mask.shape


CINE = """filmback 36 24 0 0|lens 50 2.8|lens_settings 20 200 1.4 16 10 1 6|focus 100|focus_mode manual 0 2 0
crop 1.777 0 0 0|near_clip 0 10|exposure 100 120 0|enabled 1"""


def test_cine_commands_of_their_live_test(asking):
    ask = asking("N3")
    for command in CINE.replace("\n", "|").split("|"):
        assert ask(f"vset /camera/0/cine/{command}") == b"ok"
    for what in ("", "/enabled", "/intrinsics"):
        assert no_error(ask(f"vget /camera/0/cine{what}"))
