"""What the 1.x dialects do otherwise than N1, and the player's camera that they share."""

import logging
import socket
import time

import numpy as np
import pytest
from support.expected_views import npy, png
from support.wire import leave, official_api

MODERN = ("M", "N1", "N2", "N3")


@pytest.fixture
def raw(start, open_raw):
    return lambda dialect, **options: open_raw(start(dialect=dialect, size=(40, 30), **options))


# The player's camera, number 0


@pytest.mark.parametrize("dialect", MODERN)
def test_the_players_camera_is_late(raw, dialect):
    client = raw(dialect, frames_per_s=1)  # no frame passes by itself
    old = client.ask("vget /camera/0/depth npy")
    assert client.text("vset /camera/0/location 50 0 150") == "ok"
    assert client.text("vget /camera/0/location") == "0.000 0.000 150.000"
    client.settle()
    assert client.text("vget /camera/0/location") == "50.000 0.000 150.000"
    assert client.ask("vget /camera/0/depth npy") != old


@pytest.mark.parametrize("dialect", MODERN)
def test_the_controller_limits_the_players_camera(raw, dialect):
    client = raw(dialect)
    for rotation, read in (
        ("-90 -30 95", "270.100 330.000 89.900"),
        ("90 720.5 -100", "89.900 0.500 270.100"),
        ("-30 0 0", "330.000 0.000 0.000"),
    ):
        client.ask(f"vset /camera/0/rotation {rotation}")
        client.settle()
        assert client.text("vget /camera/0/rotation") == read


@pytest.mark.parametrize("dialect", MODERN)
def test_straight_down_is_exact_only_for_spawned_cameras(raw, dialect):
    """A tenth of a degree tilts the floor's depth from side to side."""
    client = raw(dialect, depth="float32")
    client.ask("vset /cameras/spawn")
    for camera in (0, 1):
        client.ask(f"vset /camera/{camera}/location 0 0 150")
        client.ask(f"vset /camera/{camera}/rotation -90 0 0")
    client.settle()
    player, own = (npy(client.ask(f"vget /camera/{i}/depth npy")) for i in (0, 1))
    floor = np.isclose(own, 150, atol=1e-4)
    assert floor.mean() > 0.3
    assert np.ptp(player[floor]) > 0.1


@pytest.mark.parametrize("dialect", MODERN)
def test_the_players_camera_stays_while_the_game_is_paused(raw, dialect):
    client = raw(dialect)
    client.ask("vset /cameras/spawn")
    client.ask("vset /action/game/pause")
    client.ask("vset /camera/0/location 50 0 150")
    client.ask("vset /camera/1/location 50 0 150")
    client.settle()
    assert client.text("vget /camera/0/location") == "0.000 0.000 150.000"
    assert client.text("vget /camera/1/location") == "50.000 0.000 150.000"
    client.ask("vset /action/game/resume")
    client.settle()
    assert client.text("vget /camera/0/location") == "50.000 0.000 150.000"


@pytest.mark.parametrize("dialect", MODERN)
def test_moveto_and_screenshot_are_the_players(raw, dialect):
    client = raw(dialect)
    assert client.text("vset /camera/0/moveto 50 0 150") == "ok"
    client.settle()
    assert client.text("vget /camera/0/location") == "50.000 0.000 150.000"
    client.ask("vset /viewmode object_mask")
    assert client.ask("vget /screenshot png") == client.ask("vget /camera/0/object_mask png")
    assert client.text("vget /screenshot gif") == "error Invalid filename type, filename gif"


# What a client finds out first: the probes of the reference


@pytest.mark.parametrize(
    ("dialect", "version", "unknown"),
    [
        ("M", "0.3.10", "error Can not find a handler for URI 'nonsense'"),
        ("N1", "1.0.1", "error Can not find a handler for URI 'nonsense'"),
        ("N2", "1.0.1", "error No handler found for URI 'nonsense'"),
    ],
)
def test_probes(raw, dialect, version, unknown):
    client = raw(dialect)
    assert client.text("vget /unrealcv/version") == version
    assert client.text("nonsense") == unknown
    assert client.text("vget /unrealcv/commands") == unknown.replace("nonsense", "vget /unrealcv/commands")
    assert client.text("vget /cameras") == "PawnSensor "
    assert float(client.text("vget /camera/0/fov")) == 90
    command = "vget /camera/0/horizontal_fieldofview"
    assert client.text(command) == unknown.replace("nonsense", command)
    text = client.text("vget /unrealcv/help")
    assert ("vcmd [str]" in text) == ("exposure_bias" in text) == (dialect == "N2")
    assert "vbatch" not in text  # taken out before commands are matched


# M


def test_m_cannot_tell_size_or_level_but_sets_the_size(raw):
    client = raw("M")
    assert client.text("vget /camera/0/size") == "error Argument Invalid"
    assert client.text("vget /level/name") == "error Can not find a handler for URI 'vget /level/name'"
    assert client.text("vset /camera/0/size 20 10") == "ok"
    assert png(client.ask("vget /camera/0/lit png")).shape == (10, 20, 4)


def test_of_a_long_id_m_uses_the_last_eight_digits(raw):
    client = raw("M")
    client.send(b"vget /no/id", b"1234567890123:vget /unrealcv/version")
    assert client.frame() == b"67890123:0.3.10"


# N2


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("xx vget /viewmode", "error No handler found for URI 'xx vget /viewmode'"),
        ("vrun X", "error Unrecognised alias 'X'"),
        ("vrun r.MotionBlurQuality 0", "ok"),
        ("vcmd DisableAllScreenMessages", "ok"),
        ("vget /object/Nothing/location", "error Cannot find object"),
        ("vget /object/Nothing/color", "error Cannot find object"),
        ("vget /object/Sofa/uclass_name", "StaticMeshActor"),
        ("vset /camera/0/exposure_method MANUAL", "ok"),
        ("vset /camera/0/exposure_bias 1.5", "ok"),
        ("vset /camera/0/motion_blur 0 0 0 0", "ok"),
        ("vset /camera/7/exposure_bias 1.5", "error Argument Invalid"),
        ("vset /camera/7/reflection lumen", "error Argument Invalid"),
        ("vget /camera/7/lit png", "error Invalid sensor id"),
    ],
)
def test_n2_replies(raw, command, reply):
    assert raw("N2").text(command) == reply


def test_n2_offers_the_words_it_takes(raw):
    text = raw("N2").text("vset /camera/0/exposure_method true")
    assert text.startswith("error Can not support ")
    assert text.endswith(" true, available options are histogram, basic and manual")


def test_the_status_of_n2_ends_otherwise(raw):
    text = raw("N2").text("vget /unrealcv/status")
    assert "\nWidth: 40\nHeight: 30\nFOV: 90.0\n" in text
    assert text.endswith("EnableRightEye: false")


def test_n2_reads_utf8_that_n1_mangles_and_knows_no_negative_ids(raw):
    assert raw("N1").ask("vget /unrealcv/echo é".encode()) == "Ã©".encode()
    client = raw("N2")
    assert client.ask("vget /unrealcv/echo après".encode()) == "après".encode()
    client.send(b"4294967295:vget /unrealcv/version")
    assert client.frame() == b"0:1.0.1"


def test_a_batch_of_n2_is_held_until_it_is_whole(raw):
    client = raw("N2", frames_per_s=100)
    client.send(b"1:vbatch 3", b"2:vget /unrealcv/echo a", b"3:vget /unrealcv/echo b")
    assert client.frame() == b"1:ok"
    client.socket.settimeout(0.2)
    with pytest.raises(TimeoutError):
        client.frame()
    client.socket.settimeout(20)
    client.send(b"4:vget /unrealcv/echo c", b"5:vget /unrealcv/echo d")
    assert [client.frame() for _ in range(4)] == [b"2:a", b"3:b", b"4:c", b"5:d"]


def test_a_batch_runs_in_one_frame(raw):
    """So a pose set in it is not yet the player's camera's at its end."""
    client = raw("N2")
    client.send(b"1:vbatch 2", b"2:vset /camera/0/location 50 0 150")
    assert client.frame() == b"1:ok"
    client.send(b"3:vget /camera/0/location")
    assert [client.frame(), client.frame()] == [b"2:ok", b"3:0.000 0.000 150.000"]


# The official client and its high-level API


@pytest.mark.parametrize("dialect", MODERN)
def test_the_official_client(start, connect, dialect):
    client = connect(start(dialect=dialect, size=(40, 30)))
    assert client.request("vset /cameras/spawn") == "FusionCameraActor_0"
    replies = client.request(["vget /camera/1/lit png", "vget /camera/1/depth npy", "vget /camera/1/seg bmp"])
    assert [reply[:2] for reply in replies] == [b"\x89P", b"\x93N", b"BM"]
    assert client.request([f"vget /unrealcv/echo w{i}" for i in range(200)]) == [f"w{i}" for i in range(200)]


@pytest.mark.parametrize("dialect", ["M", "N1", "N2"])
def test_the_official_api(start, monkeypatch, dialect):
    monkeypatch.setattr(logging.getLogger("unrealcv"), "level", logging.CRITICAL)
    server = start(dialect=dialect, size=(40, 30))
    api = official_api(server, (40, 30))
    try:
        assert api.get_objects() == list(server.scene.objects)
        assert api.get_image(0, "lit", "png").shape == (30, 40, 3)
        assert api.get_depth(0).shape == (30, 40, 1)
        # DisableAllScreenMessages comes without vrun, an unknown command, and nobody reads the error.
        api.config_ue((40, 30), low_quality=True)
        assert api.get_image(0, "object_mask", "png").shape == (30, 40, 3)
    finally:
        leave(api.client)


# Linux: the plugin leaves TCP


@pytest.fixture
def unix_client(connect):
    """Waits for the Unix socket, and connects the official client to it."""

    def connect_to(server):
        deadline = time.monotonic() + 20
        while not server.unix_path.exists():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return connect(str(server.unix_path))

    return connect_to


@pytest.mark.parametrize(("dialect", "state"), [("N1", "No Client Connected"), ("N2", "Client Connected")])
def test_on_linux_the_second_client_is_served_by_a_unix_socket(start, open_raw, unix_client, dialect, state):
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


def test_on_linux_a_tcp_client_that_comes_back_waits_for_ever(start, open_raw, unix_client):
    server = start(dialect="N1", platform="linux")
    open_raw(server).socket.close()
    unix_client(server)
    with (
        socket.create_connection((server.host, server.port), timeout=0.3) as again,
        pytest.raises(TimeoutError),
    ):
        again.recv(1)


@pytest.mark.parametrize(("dialect", "platform"), [("M", "linux"), ("0.3.10", "linux"), ("N1", "windows")])
def test_elsewhere_tcp_goes_on(start, open_raw, dialect, platform):
    server = start(dialect=dialect, platform=platform)
    open_raw(server).socket.close()
    assert open_raw(server).greeting == b"connected to four-wall"
    assert not server.unix_path.exists()


def test_the_unix_socket_is_removed_at_the_end(start, open_raw, unix_client):
    server = start(dialect="N2", platform="linux")
    open_raw(server).socket.close()
    unix_client(server)
    server.stop()
    assert not server.unix_path.exists()
