"""What ``serve`` accepts, and how a server ends."""

import re

import pytest

import mock_server


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dialect": "1.0"}, "dialect: expected one of 1.x, 0.3.10, L, M, N1, N2; got '1.0'"),
        ({"depth": "double"}, "depth: expected one of half, float32; got 'double'"),
        ({"platform": None}, "platform: expected one of windows, linux; got None"),
        ({"port": 65536}, "port: expected a number from 0 to 65535, got 65536"),
        ({"port": "9000"}, "port: expected a number from 0 to 65535, got '9000'"),
        ({"fov_deg": 180.0}, "fov_deg: expected a number from 1 to 179, got 180.0"),
        ({"latency_ms": float("inf")}, "latency_ms: expected a number from 0 to 3.6e+06, got inf"),
        ({"size": 64}, "size: expected (width, height) of at least 1 px each, got 64"),
        ({"size": (64, 0)}, "size: expected (width, height) of at least 1 px each, got (64, 0)"),
        ({"window": (0.5, 64)}, "window: expected (width, height) of at least 1 px each, got (0.5, 64)"),
        ({"faults": "reset"}, "faults: expected a list of texts, got 'reset'"),
    ],
)
def test_a_wrong_option_is_named(options, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        mock_server.serve("direction", **options)


def test_an_unknown_option_is_named():
    with pytest.raises(TypeError, match="unexpected keyword argument 'latency'"):
        mock_server.serve("direction", latency=3)


def test_stopping_waits_for_no_client_that_has_stopped_reading(start, open_raw):
    server = start(size=(1024, 1024))
    client = open_raw(server)
    client.send(*(b"%d:vget /camera/0/lit bmp" % number for number in range(20)))
    client.bytes(100)  # the first of 80 MB is on its way
    server.stop()  # a server that waits exceeds the suite's time limit
    server.stop()


def test_the_cameras_of_a_server_can_be_counted(start, open_raw):
    server = start()
    client = open_raw(server)
    client.text("vset /cameras/spawn")
    assert [camera.actor for camera in server.world.cameras] == ["", "FusionCameraActor_0"]
    client.text("vset /object/FusionCameraActor_0/destroy")
    assert len(server.world.cameras) == 1
