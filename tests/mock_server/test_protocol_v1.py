"""Dialect 1.x (columns N1 of the protocol reference) over a real socket: raw bytes, and the official client.

Texts are written here as the reference gives them, not taken from the server.
"""

import re
import struct
from pathlib import Path

import pytest

UNKNOWN = "error Can not find a handler for URI '{}'"


# Frames


def test_the_greeting_is_a_frame_without_id(raw):
    assert raw.greeting == b"connected to four-wall"


def test_replies_carry_the_requests_id_as_a_plain_number(raw):
    raw.send(b"7:vget /unrealcv/version")
    assert raw.frame() == b"7:1.0.1"
    raw.send(b"0012:vget /unrealcv/version")
    assert raw.frame() == b"12:1.0.1"
    raw.send(b"1234567890:vget /unrealcv/version")
    assert raw.frame() == b"1234567890:1.0.1"


def test_ids_are_32_bits(raw):
    raw.send(b"2147483648:vget /unrealcv/version")
    assert raw.frame() == b"-2147483648:1.0.1"
    raw.send(b"9" * 5000 + b":vget /unrealcv/version")
    assert raw.frame() == b"-1:1.0.1"


def test_pipelined_requests_are_answered_in_order(raw):
    raw.send(*(b"%d:vget /unrealcv/echo w%d" % (i, i) for i in range(500)))
    assert [raw.frame() for _ in range(500)] == [b"%d:w%d" % (i, i) for i in range(500)]


def test_a_frame_may_come_in_pieces(raw):
    data = b"\xc1\x83\x2b\x9e" + struct.pack("<I", 14) + b"3:vget /camera"
    for byte in data[:-1]:
        raw.socket.sendall(bytes([byte]))
    raw.socket.sendall(data[-1:])
    assert raw.frame() == b"3:" + UNKNOWN.format("vget /camera").encode()


def test_requests_without_an_id_get_no_reply(raw):
    raw.send(b"vget /unrealcv/version", b":vget /x", b"\xff\xfe", b"5:vget /unrealcv/echo here")
    assert raw.frame() == b"5:here"


def test_a_command_ends_at_a_line_feed_and_a_null_byte(raw):
    assert raw.text("vget /unrealcv/echo a\nb") == "a"
    assert raw.text("vget /unrealcv/echo a\0b") == "a"


@pytest.mark.parametrize(
    "header", [b"\0\0\0\0\x05\0\0\0", b"\xc1\x83\x2b\x9e\0\0\0\0", b"\xc1\x83\x2b\x9e\xff\xff\xff\xff"]
)
def test_a_bad_header_drops_the_connection_and_the_next_client_is_served(start, open_raw, header):
    server = start(dialect="N1")
    first = open_raw(server)
    first.socket.sendall(header)
    with pytest.raises(EOFError):
        first.bytes(1)
    assert open_raw(server).text("vget /unrealcv/version") == "1.0.1"


def test_a_second_client_waits_for_its_greeting_until_the_first_leaves(start, open_raw):
    import socket

    server = start(dialect="N1")
    first = open_raw(server)
    second = socket.create_connection((server.host, server.port), timeout=0.3)
    with pytest.raises(TimeoutError):
        second.recv(1)
    first.socket.close()
    second.settimeout(20)
    assert second.recv(4) == b"\xc1\x83\x2b\x9e"
    second.close()


# Texts


def test_plugin(raw, start):
    assert raw.text("vget /unrealcv/version") == "1.0.1"
    assert raw.text("vget /unrealcv/echo word") == "word"
    assert raw.text("vget /scene/name") == "four-wall"
    lines = raw.text("vget /unrealcv/status").split("\n")
    port = lines[2]
    assert lines == [
        "Is Listening", "Client Connected", port, "Configuration", lines[4], f"Port: {port}", "Width: 640",
        "Height: 480", "FOV: 90.000000", "EnableInput: true", "EnableRightEye: false", "",
    ]  # fmt: skip
    assert lines[4].startswith("Config file: /")
    assert lines[4].endswith("/unrealcv.ini")


@pytest.mark.parametrize("dialect", ["0.3.10", "M", "N1", "N2"])
def test_captured_files_are_beside_the_file_that_the_status_names(start, open_raw, tmp_path, dialect):
    """Where clients look for them."""
    raw = open_raw(start(dialect=dialect, folder=tmp_path, size=(8, 8)))
    raw.ask("vget /camera/0/lit x.png")
    named = re.search("^Config file: (.*)$", raw.text("vget /unrealcv/status"), re.MULTILINE)[1]
    assert Path(named).with_name("x.png").read_bytes()[:4] == b"\x89PNG"


def test_help_lists_templates_and_descriptions(raw):
    text = raw.text("vget /unrealcv/help")
    assert text.startswith("vrun [str]\n")
    assert text.endswith("\n")
    templates = text.split("\n")[:-1:2]
    for expected in (
        "vget /objects",
        "vget /cameras",
        "vset /cameras/spawn",
        "vget /camera/[uint]/lit [str]",
    ):
        assert expected in templates
    assert "vcmd [str]" not in templates
    assert "exposure_bias" not in text
    assert templates.index("vget /objects") < templates.index("vget /unrealcv/status")
    assert templates.index("vget /unrealcv/status") < templates.index("vget /cameras")


@pytest.mark.parametrize(
    "command",
    [
        "vget /unrealcv/commands",
        "vget /camera/0/horizontal_fieldofview",
        "vget /camera/0/pose",
        "vget /camera/0/lit",
        "vget /camera/0/plane_depth npy",
        "vget /camera/0/vis_depth npy",
        "vget /camera/0/optical_flow png",
        "vget /camera/-1/location",
        "vset /camera/1/location 1 2",
        "vset /camera/1/location 1e-05 2 3",
        "vset /camera/1/location 5. 2 3",
        "vset /camera/1/location nan 2 3",
        "vset /camera/1/location inf 2 3",
        "vget /object/Sofa/name",
        "VGET /cameras",
        "vcmd x",
        "DisableAllScreenMessages",
        "",
    ],
)
def test_unknown_commands_are_quoted(raw, command):
    assert raw.text(command) == UNKNOWN.format(command)


@pytest.mark.parametrize("command", ["vget /viewmode   ", "xx vget /viewmode", "vget /camera//fov"])
def test_templates_are_not_anchored_and_may_be_followed_by_spaces(raw, command):
    assert raw.text(command) == ("lit" if "viewmode" in command else "90.000000")


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("vget /camera/7/location", "error Invalid sensor id"),
        ("vget /camera/7/rotation", "error Invalid sensor id"),
        ("vset /camera/7/location 1 2 3", "error Invalid sensor id"),
        ("vget /camera/7/lit png", "error Invalid sensor id"),
        ("vget /camera/7/depth npy", "error Invalid sensor id"),
        ("vget /camera/99999999999999999999999/lit png", "error Invalid sensor id"),
        ("vget /camera/7/fov", "error Argument Invalid"),
        ("vset /camera/7/fov 90.0", "error Argument Invalid"),
        ("vget /camera/7/size", "error Argument Invalid"),
        ("vset /camera/7/size 4 4", "error Argument Invalid"),
        ("vget /camera/0/lit jpg", "error Invalid filename type, filename jpg"),
        ("vget /camera/0/lit npy", "error Invalid filename type, filename npy"),
        ("vget /camera/0/lit ", "error Invalid filename type, filename "),
        ("vget /camera/0/depth png", "error Invalid filename type, filename png"),
        ("vget /camera/0/depth x.exr", "error Invalid filename type, filename x.exr"),
        ("vset /camera/1/moveto 1 2 3", "error Invalid sensor id"),
        ("vget /object/Nothing/location", "error Can not find object"),
        ("vget /object/Nothing/color", "error Can not find object"),
        ("vset /object/Nothing/hide", "error Can not find object"),
        ("vget /object//color", "error Can not find object"),
        ("vset /objects/spawn Cube MyCube", "error Can not find a class with name 'Cube'"),
        ("vset /viewmode Nothing", "error Can not set ViewMode to nothing"),
        ("vset /action/eyes_distance 3.0", "error Not Implemented"),
        ("vexec Nobody Jump", "error Can not find actor with id 'Nobody'"),
        ("vrun r.Tonemapper.Quality 1", "ok"),
        ("vrun setres 640x480w", "ok"),
        ("vrun a b c d e f", "ok"),
        ("vbatch 3", "ok"),
        ("vset /action/input/disable", "ok"),
        ("vget /action/game/is_paused", "false"),
    ],
)  # fmt: skip
def test_replies(raw, command, reply):
    assert raw.text(command) == reply


# Cameras


def test_cameras(raw):
    assert raw.text("vget /cameras") == "PawnSensor "
    assert raw.text("vset /cameras/spawn") == "FusionCameraActor_0"
    assert raw.text("vset /cameras/spawn") == "FusionCameraActor_1"
    assert raw.text("vget /cameras") == "PawnSensor FusionCameraSensor FusionCameraSensor "
    assert raw.text("vset /camera/1/moveto 1 2 3") == "error MoveTo only supports the player camera with id 0"


def test_camera_values_are_printed_as_in_c(camera):
    assert camera.text("vget /camera/1/location") == "10.000 -20.000 150.000"
    assert camera.text("vget /camera/1/rotation") == "10.000 30.000 5.000"
    assert camera.text("vget /camera/1/fov") == "75.500000"
    assert camera.text("vget /camera/1/size") == "40 30"
    camera.ask("vset /camera/1/location +1.23456 -.5 7")
    assert camera.text("vget /camera/1/location") == "1.235 -0.500 7.000"


def test_a_spawned_camera_is_posed_at_once(camera):
    camera.send(b"1:vset /camera/1/rotation -90 0 0", b"2:vget /camera/1/rotation")
    assert [camera.frame(), camera.frame()] == [b"1:ok", b"2:-90.000 0.000 0.000"]


@pytest.mark.parametrize(
    ("rotation", "pole"),
    [((90, 45, 0), 1), ((90, 0, 30), 1), ((-90, 45, 0), -1), ((-90, 10, 25), -1)],
)
def test_at_the_poles_only_one_turn_of_a_spawned_camera_is_read_back(camera, rotation, pole):
    camera.ask("vset /camera/1/rotation {} {} {}".format(*rotation))
    pitch, yaw, roll = map(float, camera.text("vget /camera/1/rotation").split())
    assert pitch == pole * 90
    turn = (yaw - pole * roll) - (rotation[1] - pole * rotation[2])
    assert (turn + 180) % 360 - 180 == pytest.approx(0, abs=2e-3)  # printed with three decimals, twice


def test_near_the_pole_the_pitch_reads_exactly_90(camera):
    for pitch, reads in ((89.95, 90.0), (-89.93, -90.0), (89.85, 89.85)):
        camera.ask(f"vset /camera/1/rotation {pitch} 0 0")
        # Kept in single precision, where the arc sine is steep: some 1e-3 degrees.
        got = float(camera.text("vget /camera/1/rotation").split()[0])
        assert got == pytest.approx(reads, abs=5e-3 if reads == pitch else 0)


def test_beyond_the_pole_the_camera_has_turned_round(camera):
    camera.ask("vset /camera/1/rotation 100 0 0")
    pitch, yaw, roll = map(float, camera.text("vget /camera/1/rotation").split())
    assert (pitch, abs(yaw), abs(roll)) == pytest.approx((80, 180, 180), abs=2e-3)


# The official client


def test_the_official_client_pipelines_and_gets_text_and_bytes(start, connect):
    client = connect(start(dialect="N1"))
    replies = client.request(["vget /unrealcv/version", "vget /cameras", "vget /camera/0/lit png"])
    assert replies[:2] == ["1.0.1", "PawnSensor "]
    assert isinstance(replies[2], bytes)
    assert client.request("vget /unrealcv/echo après") == "aprÃ¨s"  # N1 reads bytes as characters
    assert client.request("vset /camera/0/fov 60.0", -1) is True
    assert client.request("vget /camera/0/fov") == "60.000000"


def test_the_official_client_may_leave_and_come_back(start, connect):
    server = start(dialect="N1")
    connect(server).disconnect()
    assert connect(server).request("vget /unrealcv/version") == "1.0.1"
