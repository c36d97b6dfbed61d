"""Dialect 1.x (columns N1 of the protocol reference) over a real socket: raw bytes, and the official client.

Texts are written here as the reference gives them, not taken from the server.
"""

import io
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import mock_server

UNKNOWN = "error Can not find a handler for URI '{}'"


@pytest.fixture
def raw(start, open_raw):
    return open_raw(start())


@pytest.fixture
def camera(raw):
    """A client with a spawned camera 1 of 40 x 30 pixels, turned and moved."""
    raw.ask("vset /cameras/spawn")
    for command in ("size 40 30", "fov 75.5", "location 10.0 -20.0 150.0", "rotation 10.0 30.0 5.0"):
        assert raw.ask(f"vset /camera/1/{command}") == b"ok"
    return raw


def seen_by_hand(scene, location, rotation, fov, width, height):
    """Rays in Unreal's axes by the reference's formulas, traced after the mirror."""
    P, Y, R = np.radians(rotation)
    S, C = np.sin, np.cos
    forward = np.array([C(P) * C(Y), C(P) * S(Y), S(P)])
    right = np.array([S(R) * S(P) * C(Y) - C(R) * S(Y), S(R) * S(P) * S(Y) + C(R) * C(Y), -S(R) * C(P)])
    up = np.array([-(C(R) * S(P) * C(Y) + S(R) * S(Y)), C(Y) * S(R) - C(R) * S(P) * S(Y), C(R) * C(P)])
    f = width / 2 / np.tan(np.radians(fov) / 2)
    u, v = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    rays = forward + (u / f)[..., None] * right - (v / f)[..., None] * up
    hits = scene.trace(np.array(location) * (0.01, -0.01, 0.01), rays * (1, -1, 1))
    return hits, hits.distance / np.linalg.norm(rays, axis=-1)


@pytest.fixture(scope="module")
def truth():
    scene = mock_server.load_scene("four-wall")
    return scene, *seen_by_hand(scene, (10, -20, 150), (10, 30, 5), 75.5, 40, 30)


def nearly_all_equal(got, expected, tolerance=0):
    """All but pixels on an edge, where the last digit decides between two surfaces."""
    off = np.abs(got.astype(float) - expected).max(axis=-1) > tolerance
    assert off.mean() < 0.005


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
    server = start()
    first = open_raw(server)
    first.socket.sendall(header)
    with pytest.raises(EOFError):
        first.bytes(1)
    assert open_raw(server).text("vget /unrealcv/version") == "1.0.1"


def test_a_second_client_waits_for_its_greeting_until_the_first_leaves(start, open_raw):
    import socket

    server = start()
    first = open_raw(server)
    second = socket.create_connection((server.host, server.port), timeout=0.3)
    with pytest.raises(TimeoutError):
        second.recv(1)
    first.socket.close()
    second.settimeout(20)
    assert second.recv(4) == b"\xc1\x83\x2b\x9e"
    second.close()


@pytest.fixture(scope="module")
def fuzzed():
    with mock_server.serve("direction") as server:
        yield server


@given(
    st.lists(st.one_of(st.binary(min_size=1, max_size=200), st.text(min_size=1).map(str.encode)), max_size=5)
)
def test_no_payload_stops_the_server(fuzzed, payloads):
    from wire import RawClient

    client = RawClient(fuzzed)
    try:
        client.send(*payloads, b"424242:vget /unrealcv/version")
        while client.frame() != b"424242:1.0.1":
            pass
    finally:
        client.socket.close()


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


def test_pause(raw):
    assert raw.text("vset /action/game/pause") == "ok"
    assert raw.text("vget /action/game/is_paused") == "true"
    assert raw.text("vset /action/game/resume") == "ok"
    assert raw.text("vget /action/game/is_paused") == "false"


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


# Images


def test_png_is_rgba(camera, truth):
    _, hits, _ = truth
    image = np.asarray(Image.open(io.BytesIO(camera.ask("vget /camera/1/lit png"))))
    assert image.shape == (30, 40, 4)
    assert image.dtype == np.uint8
    nearly_all_equal(image[..., :3], 255 * hits.color, tolerance=0.51)


def test_mask_shows_the_objects_colours(camera, truth):
    scene, hits, _ = truth
    image = np.asarray(Image.open(io.BytesIO(camera.ask("vget /camera/1/object_mask PNG"))))
    assert (image[..., 3] == 255).all()
    colors = [(0, 0, 0)]
    for name in scene.objects:
        text = camera.text(f"vget /object/{name}/color")
        colors.append(tuple(int(part[2:]) for part in text.strip("()").split(",")[:3]))
    nearly_all_equal(image[..., :3], np.array(colors)[hits.label])
    assert camera.ask("vget /camera/1/seg png") == camera.ask("vget /camera/1/object_mask png")


def test_normals_are_in_unreals_world_axes(camera, truth):
    _, hits, _ = truth
    image = np.asarray(Image.open(io.BytesIO(camera.ask("vget /camera/1/normal png"))))
    nearly_all_equal(image[..., :3], 255 * (0.5 + 0.5 * hits.normal * (1, -1, 1)), tolerance=0.51)


def test_bmp_repeats_its_byte_count_before_the_pixels(camera):
    image = np.asarray(Image.open(io.BytesIO(camera.ask("vget /camera/1/lit png"))))
    data = camera.ask("vget /camera/1/lit bmp")
    count = 4 * 40 * 30
    assert len(data) == 58 + count
    fields = struct.unpack("<2sIHHIIiiHHIIii", data[:46])
    assert fields == (b"BM", 54 + count, 0, 0, 54, 40, 40, -30, 1, 32, 0, 0, 1024, 1024)
    assert data[54:58] == struct.pack("<i", count)
    pixels = np.frombuffer(data[58:], np.uint8).reshape(30, 40, 4)
    np.testing.assert_array_equal(pixels[..., 2::-1], image[..., :3])


def test_depth_is_planar_centimetres_through_half_floats(camera, truth):
    _, _, planar = truth
    data = camera.ask("vget /camera/1/depth npy")
    assert data[:8] == b"\x93NUMPY\x01\x00"
    length = struct.unpack("<H", data[8:10])[0]
    assert (10 + length) % 16 == 0
    header = data[10 : 10 + length]
    assert header.rstrip() == b"{'descr': '<f4', 'fortran_order': False, 'shape': (30, 40), }"
    assert header.endswith(b" \n")
    depth = np.load(io.BytesIO(data))
    np.testing.assert_array_equal(depth, depth.astype(np.float16).astype(np.float32))
    # Half floats have 11 bits: at most half a step, 2^-11 relative.
    nearly_all_equal(depth[..., None], 100 * planar[..., None], tolerance=2.0**-11 * 100 * planar.max())


def test_depth_may_be_asked_for_without_half_floats(start, open_raw):
    raw = open_raw(start(depth="float32"))
    raw.ask("vset /camera/0/size 40 30")
    scene = mock_server.load_scene("four-wall")
    _, planar = seen_by_hand(scene, (0, 0, 150), (0, 0, 0), 90, 40, 30)
    depth = np.load(io.BytesIO(raw.ask("vget /camera/0/depth npy")))
    nearly_all_equal(depth[..., None] / 100, planar[..., None], tolerance=1e-6 * planar.max())


def test_npy_headers_get_another_block_when_they_fit(raw):
    """The header of (480, 640) takes 80 bytes; one that fits exactly grows by 16 all the same."""
    lengths = {}
    for width in (1, 10, 100, 1000):
        for height in (1, 10, 100):
            raw.ask(f"vset /camera/0/size {width} {height}")
            data = raw.ask("vget /camera/0/depth npy")
            text = len(f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({height}, {width}), }}")
            lengths[text] = 10 + struct.unpack("<H", data[8:10])[0]
            assert np.load(io.BytesIO(data)).shape == (height, width)
    assert all(total == (10 + text) // 16 * 16 + 16 for text, total in lengths.items())


def test_the_sky_is_the_largest_half_float(start, open_raw):
    raw = open_raw(start("direction"))
    raw.ask("vset /camera/0/size 8 8")
    np.testing.assert_array_equal(np.load(io.BytesIO(raw.ask("vget /camera/0/depth npy"))), np.float32(65504))
    mask = np.asarray(Image.open(io.BytesIO(raw.ask("vget /camera/0/object_mask png"))))
    assert not mask[..., :3].any()


def test_field_of_view_is_of_the_longer_side(camera):
    camera.ask("vset /camera/1/size 20 60")
    depth = np.load(io.BytesIO(camera.ask("vget /camera/1/depth npy")))
    scene = mock_server.load_scene("four-wall")
    across = np.degrees(2 * np.arctan(np.tan(np.radians(75.5) / 2) * 20 / 60))
    _, planar = seen_by_hand(scene, (10, -20, 150), (10, 30, 5), across, 20, 60)
    nearly_all_equal(depth[..., None], 100 * planar[..., None], tolerance=2.0**-11 * 100 * planar.max())


@pytest.mark.parametrize(
    "command", ["size 0 10", "size 4000000000 1", "size 100000 100000", "fov 0", "fov 180"]
)
def test_captures_without_pixels_are_refused(camera, command):
    assert camera.text(f"vset /camera/1/{command}") == "ok"
    assert camera.text("vget /camera/1/lit png") == "error Captured data is empty"
    assert camera.text("vget /camera/1/depth npy") == "error Captured data is empty"


def test_files_are_written_in_the_servers_folder(start, open_raw, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    raw = open_raw(start(folder=folder))
    raw.ask("vset /camera/0/size 16 16")
    assert raw.text("vget /camera/0/lit a.png") == "a.png"
    assert raw.text("vget /camera/0/depth a.npy") == "a.npy"
    assert (folder / "a.png").read_bytes() == raw.ask("vget /camera/0/lit png")
    assert (folder / "a.npy").read_bytes() == raw.ask("vget /camera/0/depth npy")


def test_file_names_cannot_leave_the_folder(start, open_raw, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    raw = open_raw(start(folder=folder))
    raw.ask("vset /camera/0/size 4 4")
    for name in ("../a.png", f"{tmp_path}/a.png", "link/a.png", "missing/a.png", "x/../../a.png"):
        assert raw.text(f"vget /camera/0/lit {name}") == name
    assert sorted(tmp_path.rglob("*.png")) == []


def test_the_view_mode_contaminates_captures(camera):
    """A depth or normal view mode puts a post-process into the world, which capture cameras obey."""
    clean = camera.ask("vget /camera/1/lit png")
    assert camera.text("vset /viewmode Normal") == "ok"
    assert camera.text("vget /viewmode") == "normal"
    assert camera.ask("vget /camera/1/lit png") != clean
    assert camera.text("vset /viewmode lit") == "ok"
    assert camera.ask("vget /camera/1/lit png") == clean


# Objects


def test_objects_are_listed_each_with_a_space(raw):
    names = mock_server.load_scene("four-wall").objects
    assert raw.text("vget /objects") == "".join(name + " " for name in names)


def test_a_scene_without_objects_answers_ok(start, open_raw):
    assert open_raw(start("direction")).text("vget /objects") == "ok"


def test_default_colours_are_the_plugins_in_order(raw):
    first = ["(0,0,0)", "(0,0,255)", "(0,255,0)", "(0,255,255)", "(255,0,0)", "(255,0,255)", "(255,255,0)"]
    first += ["(255,255,255)", "(0,0,127)", "(0,255,127)", "(255,0,127)", "(255,255,127)", "(0,127,0)"]
    for name, color in zip(raw.text("vget /objects").split(), first, strict=False):
        r, g, b = color.strip("()").split(",")
        assert raw.text(f"vget /object/{name}/color") == f"(R={r},G={g},B={b},A=255)"


def test_the_palette_has_32768_distinct_colours():
    from mock_server.world import palette

    colors = list(palette())
    assert len(colors) == len(set(colors)) == 32768
    assert colors[27] == (0, 0, 63)


def test_colours_are_set_modulo_256(camera):
    assert camera.text("vset /object/Sofa/color 300 5 511") == "ok"
    assert camera.text("vget /object/Sofa/color") == "(R=44,G=5,B=255,A=255)"


def test_hidden_objects_vanish_from_every_mode(camera, truth):
    scene, hits, _ = truth
    name = scene.objects[np.bincount(hits.label.ravel()).argmax() - 1]
    before = {f: camera.ask(f"vget /camera/1/{f}") for f in ("lit png", "object_mask png", "depth npy")}
    assert camera.text(f"vset /object/{name}/hide") == "ok"
    for form, data in before.items():
        assert camera.ask(f"vget /camera/1/{form}") != data
    assert camera.text(f"vset /object/{name}/show") == "ok"
    for form, data in before.items():
        assert camera.ask(f"vget /camera/1/{form}") == data


def test_bounds_are_those_of_the_scenes_file(camera):
    # The sofa of the scene's file, in centimetres, its Y mirrored.
    values = [float(v) for v in camera.text("vget /object/Sofa/bounds").split()]
    np.testing.assert_allclose(values[:3], [-287.5, -223.0, 0.0], atol=0.011)
    np.testing.assert_allclose(values[3:], [-195.0, -17.0, 85.0], atol=0.011)


def test_objects_move_and_turn(camera):
    """A ball seen after a move is where it was sent: its mask's middle lies in that direction."""
    camera.ask("vset /camera/1/size 200 200")
    camera.ask("vset /camera/1/location 0 0 150")
    camera.ask("vset /camera/1/rotation 0 0 0")
    assert camera.text("vset /object/Ball/location 100.0 25.0 160.0") == "ok"
    assert camera.text("vget /object/Ball/location") == "100.000 25.000 160.000"
    assert camera.text("vset /object/Ball/color 1 2 3") == "ok"
    mask = np.asarray(Image.open(io.BytesIO(camera.ask("vget /camera/1/object_mask png"))))
    v, u = np.nonzero((mask[..., :3] == (1, 2, 3)).all(axis=-1))
    f = 100 / np.tan(np.radians(75.5) / 2)
    # A sphere's picture is nearly centred on its centre's: 22 cm at 1 m shift it by a pixel or two.
    assert u.mean() == pytest.approx(100 + f * 25 / 100, abs=3)
    assert v.mean() == pytest.approx(100 - f * 10 / 100, abs=3)
    before = camera.text("vget /object/Picture/bounds")
    assert camera.text("vset /object/Picture/rotation 0 90 0") == "ok"
    assert camera.text("vget /object/Picture/rotation") == "0.000 90.000 0.000"
    old, new = (np.array(t.split(), float) for t in (before, camera.text("vget /object/Picture/bounds")))
    np.testing.assert_allclose((new[3:] - new[:3])[[1, 0, 2]], old[3:] - old[:3], atol=0.03)


def test_objects_can_be_renamed_and_destroyed(camera):
    assert camera.text("vset /object/Sofa/name Couch") == "ok"
    assert "Couch" in camera.text("vget /objects").split()
    assert camera.text("vget /object/Sofa/color") == "error Can not find object"
    assert camera.text("vset /object/Couch/destroy") == "ok"
    assert "Couch" not in camera.text("vget /objects").split()


# The official client


def test_the_official_client_pipelines_and_gets_text_and_bytes(start, connect):
    client = connect(start())
    replies = client.request(["vget /unrealcv/version", "vget /cameras", "vget /camera/0/lit png"])
    assert replies[:2] == ["1.0.1", "PawnSensor "]
    assert isinstance(replies[2], bytes)
    assert client.request("vget /unrealcv/echo après") is not None
    assert client.request("vset /camera/0/fov 60.0", -1) is True
    assert client.request("vget /camera/0/fov") == "60.000000"


def test_the_official_client_may_leave_and_come_back(start, connect):
    server = start()
    connect(server).disconnect()
    assert connect(server).request("vget /unrealcv/version") == "1.0.1"
