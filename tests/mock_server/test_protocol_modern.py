"""The 1.x dialects on the wire: frames, poses, batches, the Unix socket, and the official client."""

import re
import socket
import time
from pathlib import Path

import pytest
from support.wire import leave


@pytest.fixture
def client_of(start, open_raw):
    return lambda dialect, **options: open_raw(start(dialect=dialect, size=(40, 30), **options))


MAGIC = b"\xc1\x83\x2b\x9e"
VERSION = b"vget /unrealcv/version"
EXCHANGES = [  # dialect, payloads that are sent together, payloads that come back
    ("N1", [b"7:" + VERSION, b"0012:" + VERSION, b"1234567890:" + VERSION],
     [b"7:1.0.1", b"12:1.0.1", b"1234567890:1.0.1"]),
    ("N1", [b"2147483648:" + VERSION, b"9" * 5000 + b":" + VERSION], [b"-2147483648:1.0.1", b"-1:1.0.1"]),
    ("N1", [VERSION, b":vget /x", b"\xff\xfe", b"5:vget /unrealcv/echo here"], [b"5:here"]),  # without an id
    ("N1", [b"%d:vget /unrealcv/echo w%d" % (i, i) for i in range(500)],
     [b"%d:w%d" % (i, i) for i in range(500)]),
    ("N1", ["1:vget /unrealcv/echo é".encode()], ["1:Ã©".encode()]),  # bytes are taken for characters
    ("N2", ["1:vget /unrealcv/echo après".encode(), b"4294967295:" + VERSION],
     ["1:après".encode(), b"0:1.0.1"]),  # no negative ids
    ("M", [b"vget /no/id", b"1234567890123:" + VERSION], [b"67890123:0.3.10"]),
    ("L", [VERSION], [b"error: Malformat raw message '" + VERSION + b"'"]),
    ("L", [b"1234567890123:" + VERSION], [b"67890123:0.3.10"]),
    ("N1", [b"1:vset /cameras/spawn", b"2:vset /camera/1/rotation -90 0 0", b"3:vget /camera/1/rotation"],
     [b"1:FusionCameraActor_0", b"2:ok", b"3:-90.000 0.000 0.000"]),  # posed at once
    # A batch runs in one frame, so the player's camera has not followed yet at its end.
    ("N2", [b"1:vbatch 2", b"2:vset /camera/0/location 50 0 150", b"3:vget /camera/0/location"],
     [b"1:ok", b"2:ok", b"3:0.000 0.000 150.000"]),
]  # fmt: skip


@pytest.mark.parametrize(("dialect", "payloads", "replies"), EXCHANGES)
def test_exchanges(client_of, dialect, payloads, replies):
    client = client_of(dialect)
    assert client.greeting == b"connected to four-wall"
    client.send(*payloads)
    assert [client.frame() for _ in replies] == replies


def test_a_bad_header_drops_the_connection_and_the_next_client_is_served(start, open_raw):
    server = start(dialect="N1")
    for header in (b"\0\0\0\0\x05\0\0\0", MAGIC + b"\0\0\0\0", MAGIC + b"\xff\xff\xff\xff"):
        dropped = open_raw(server)
        dropped.socket.sendall(header)
        with pytest.raises(EOFError):
            dropped.bytes(1)
    assert open_raw(server).text("vget /unrealcv/version") == "1.0.1"


def test_a_second_client_waits_for_its_greeting_until_the_first_leaves(start, open_raw):
    server = start(dialect="N1")
    first = open_raw(server)
    second = socket.create_connection((server.host, server.port), timeout=0.3)
    with pytest.raises(TimeoutError):
        second.recv(1)
    first.socket.close()
    second.settimeout(20)
    assert second.recv(4) == MAGIC
    second.close()


@pytest.mark.parametrize(("dialect", "fov"), [("L", "90.000000"), ("N1", "90.000000"), ("N2", "90.0")])
def test_status(client_of, dialect, fov):
    lines = client_of(dialect).text("vget /unrealcv/status").split("\n")
    port = lines[2]
    file = lines[4]
    assert lines == [
        "Is Listening", "Client Connected", port, "Configuration", file, f"Port: {port}", "Width: 40",
        "Height: 30", f"FOV: {fov}", "EnableInput: true", "EnableRightEye: false", *[""] * (dialect != "N2"),
    ]  # fmt: skip
    assert re.fullmatch("Config file: /.*/unrealcv.ini", file)


@pytest.mark.parametrize("dialect", ["0.3.10", "M", "N1", "N2"])
def test_captured_files_are_beside_the_file_that_the_status_names(start, open_raw, tmp_path, dialect):
    raw = open_raw(start(dialect=dialect, folder=tmp_path, size=(8, 8)))
    raw.ask("vget /camera/0/lit x.png")
    named = re.search("^Config file: (.*)$", raw.text("vget /unrealcv/status"), re.MULTILINE)[1]
    assert Path(named).with_name("x.png").read_bytes()[:4] == b"\x89PNG"


ORDERS = {  # some templates, in the order of the help
    "L": """vrun [str]|vget /objects|vget /camera/[uint]/[str]|vget /camera/[uint]/horizontal_fieldofview
        vset /viewmode [str]|vget /camera/[uint]/lit npy|vget /unrealcv/status""",
    "M": "vrun [str]|vget /objects|vget /unrealcv/status|vget /cameras|vset /cameras/spawn",
    "N1": """vrun [str]|vget /objects|vget /unrealcv/status|vget /cameras|vset /cameras/spawn
        vget /camera/[uint]/lit [str]|vset /camera/[uint]/ortho_width [float]""",
    "N2": """vrun [str]|vget /objects|vget /unrealcv/status|vcmd [str]
        vset /camera/[uint]/exposure_bias [float]""",
}


@pytest.mark.parametrize("dialect", ORDERS)
def test_help_lists_templates_and_descriptions(client_of, dialect):
    text = client_of(dialect).text("vget /unrealcv/help")
    assert text.startswith("vrun [str]\n")
    assert text.endswith("\n")
    templates = text.split("\n")[:-1:2]
    places = [templates.index(template.strip()) for template in re.split(r"[|\n]", ORDERS[dialect])]
    assert places == sorted(places)
    assert ("vcmd [str]" in templates) == ("exposure_bias" in text) == (dialect == "N2")
    assert "vbatch" not in text  # taken out before commands are matched


def test_a_spawned_camera_at_the_poles_near_them_and_beyond(camera):
    def read(*rotation):
        camera.ask("vset /camera/1/rotation {} {} {}".format(*rotation))
        return map(float, camera.text("vget /camera/1/rotation").split())

    for pole, given_yaw, given_roll in ((1, 45, 0), (1, 0, 30), (-1, 45, 0), (-1, 10, 25)):
        pitch, yaw, roll = read(pole * 90, given_yaw, given_roll)
        assert pitch == pole * 90
        turn = (yaw - pole * roll) - (given_yaw - pole * given_roll)
        assert (turn + 180) % 360 - 180 == pytest.approx(0, abs=2e-3)  # printed with three decimals, twice
    for pitch, reads in ((89.95, 90.0), (-89.93, -90.0), (89.85, 89.85), (100, 80)):
        # Kept in single precision, where the arc sine is steep: some 1e-3 degrees.
        assert next(read(pitch, 0, 0)) == pytest.approx(reads, abs=0 if abs(reads) == 90 else 5e-3)


@pytest.mark.parametrize("dialect", ["M", "N3"])
def test_the_players_camera_is_late(client_of, dialect):
    client = client_of(dialect, frames_per_s=1)  # no frame passes by itself
    old = client.ask("vget /camera/0/depth npy")
    assert client.text("vset /camera/0/location 50 0 150") == "ok"
    assert client.text("vget /camera/0/location") == "0.000 0.000 150.000"
    client.settle()
    assert client.text("vget /camera/0/location") == "50.000 0.000 150.000"
    assert client.ask("vget /camera/0/depth npy") != old


def test_a_batch_of_n2_is_held_until_it_is_whole(client_of):
    client = client_of("N2", frames_per_s=100)
    client.send(b"1:vbatch 3", b"2:vget /unrealcv/echo a", b"3:vget /unrealcv/echo b")
    assert client.frame() == b"1:ok"
    client.socket.settimeout(0.2)
    with pytest.raises(TimeoutError):
        client.frame()
    client.socket.settimeout(20)
    client.send(b"4:vget /unrealcv/echo c", b"5:vget /unrealcv/echo d")
    assert [client.frame() for _ in range(4)] == [b"2:a", b"3:b", b"4:c", b"5:d"]


@pytest.fixture
def unix_client(connect):

    def connect_to(server):
        deadline = time.monotonic() + 20
        while not server.unix_path.exists():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return connect(str(server.unix_path))

    return connect_to


@pytest.mark.parametrize(("dialect", "state"), [("N1", "No Client Connected"), ("N2", "Client Connected")])
def test_on_linux_the_second_client_is_served_by_a_unix_socket(start, open_raw, unix_client, dialect, state):
    """A client of TCP that comes back waits for ever. The socket is removed at the end."""
    server = start(dialect=dialect, platform="linux")
    first = open_raw(server)
    assert first.text("vget /unrealcv/status").split("\n")[1] == "Client Connected"
    assert not server.unix_path.exists()
    first.socket.close()
    second = unix_client(server)
    assert second.request("vget /unrealcv/version") == "1.0.1"
    assert second.request("vget /unrealcv/status").split("\n")[1] == state
    leave(second)
    assert unix_client(server).request("vget /unrealcv/version") == "1.0.1"
    again = socket.create_connection((server.host, server.port), timeout=0.3)
    with again, pytest.raises(TimeoutError):
        again.recv(1)
    server.stop()
    assert not server.unix_path.exists()


@pytest.mark.parametrize(("dialect", "platform"), [("M", "linux"), ("0.3.10", "linux"), ("N1", "windows")])
def test_elsewhere_tcp_goes_on(start, open_raw, dialect, platform):
    server = start(dialect=dialect, platform=platform)
    open_raw(server).socket.close()
    assert open_raw(server).greeting == b"connected to four-wall"
    assert not server.unix_path.exists()
