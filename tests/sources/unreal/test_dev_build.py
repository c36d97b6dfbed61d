"""The closed Dev build, as far as documents go: its commands are used where the server lists them."""

import numpy as np
import pytest
from support.unreal import agrees, relayed
from support.wire import RawClient
from support.worlds import SCENE, ahead, at_time, serve

import mock_server
import omniscv
from mock_server import pixels
from omniscv.diagnostics import native_panorama
from omniscv.diagnostics.native_panorama import bmp_colors
from omniscv.diagnostics.server import RawCamera
from omniscv.errors import BadReplyError
from omniscv.sources.unreal.opening import open_connection


def test_a_world_is_frozen_but_for_the_pawn_and_goes_on_afterwards():
    with serve("Dev", time_step_s=0.02, frames_per_s=500) as server:
        with omniscv.open_source(server.uri) as source, source.at(at_time(0.8)) as frozen:
            assert server.world.paused
            (capture,) = frozen.capture(ahead(frozen))
            assert agrees(capture, source, SCENE.at(0.8))
        assert not server.world.paused
        sent = server.statistics
        assert sent.total("vset /world/pause_all_except_pawn") == sent.total("vset /world/resume_all") == 1
        assert sent.total("vset /action/game/pause") == 0


def test_its_camera_keeps_its_stable_id_while_numbers_change():
    """The level gains a camera before ours, and the connection breaks."""
    with serve("Dev", time_step_s=0.0) as server, omniscv.open_source(server.uri) as source:
        (before,) = source.capture(ahead(source))
        assert before.provenance["command"].startswith("vget /camera/CID-FusionCameraActor_0-00/")
        server.world.spawn()
        server.world.cameras.insert(1, server.world.cameras.pop())
        server.faults.start("reset@0.03")
        while server.faults.struck["reset"] < 3:
            (after,) = source.capture(ahead(source))
            np.testing.assert_array_equal(after.pixels, before.pixels)
        server.faults.stop("reset")
        assert server.statistics.total("vset /cameras/spawn") == 1


def test_objects_are_annotated_and_other_replies_than_ok_are_taken():
    with serve("Dev", faults=["object-missing=Box"]) as server, omniscv.open_source(server.uri) as source:
        assert server.statistics.total("vset /annotation/object/Box") == 1
        reply = source.command("vset /light/directional/intensity 3")
        assert reply == "Set DirectionalLight intensity to 3.00"


def test_fast_captures_are_switched_off_where_they_are_listed():
    with serve("Dev") as server, omniscv.open_source(server.uri):
        sent = server.statistics.counts
        assert sent["vset /camera/CID-FusionCameraActor_0-00/use_fast_capture 0"] == 1


def test_bitmaps_of_both_header_sizes_are_read():
    rgb = np.random.default_rng(5).integers(0, 255, (3, 4, 3), np.uint8)
    data = pixels.bmp(rgb)  # repeats its byte count behind the header
    for picture in (data, data[:54] + data[58:]):
        np.testing.assert_array_equal(bmp_colors(picture, 4, 3), rgb)
    with pytest.raises(BadReplyError, match="expected a BMP of 4 x 3"):
        bmp_colors(data[:-1], 4, 3)


FOUND = {
    "fork": (0.0, "columns turn right, world axes, rows at corners", "planar, cm"),
    "centred": (127.5, "columns turn left, follows the camera, rows at pixel centres", "ray, m"),
}


@pytest.mark.parametrize("convention", FOUND)
def test_the_doctor_finds_how_a_native_panorama_is_to_be_read(convention, monkeypatch):
    options = {"dialect": "Dev", "panorama": convention, "shared_memory": "serving"}
    with mock_server.serve("four-wall", **options) as server, open_connection(server.uri) as connection:
        regions = server.regions
        monkeypatch.setattr(
            native_panorama, "region_reader", lambda _: lambda name, size: bytes(regions[name][:size])
        )
        with RawCamera(connection) as camera:
            camera.lag = 0
            colors, depth = native_panorama.findings(connection, camera)
    column, words, meaning = FOUND[convention]
    found = float(colors.value.split("column ")[1].split(" ")[0])
    assert abs((found - column + 128) % 256 - 128) < 0.2  # px of 1.4 degrees, from faces of 128 px
    assert words in colors.value
    assert depth.value.startswith(meaning)


def test_a_panorama_that_shows_something_else_is_not_explained():
    def noise(command, forward):
        reply = forward(command)
        if "panoramic bmp" not in command:
            return reply
        return reply[:54] + np.random.default_rng(3).integers(0, 255, len(reply) - 54, np.uint8).tobytes()

    with (
        mock_server.serve("four-wall", dialect="Dev") as server,
        relayed(server, noise) as uri,
        open_connection(uri) as connection,
        RawCamera(connection) as camera,
    ):
        camera.lag = 0
        (finding,) = native_panorama.findings(connection, camera)
    assert (finding.verdict, finding.value) == ("warning", "does not show what six faces show")


@pytest.mark.parametrize("command", ["panoramic bmp", "panoramic/depth_shared"])
def test_a_panorama_of_no_pixels_is_refused(command):
    with mock_server.serve("four-wall", dialect="Dev", shared_memory="serving") as server:
        client = RawClient(server)
        with client.socket:
            assert client.text(f"vget /camera/0/{command} 0 0").startswith("error Invalid ")


def test_open_servers_have_no_panorama():
    with open_connection("mock://four-wall") as connection, RawCamera(connection) as camera:
        assert native_panorama.findings(connection, camera) == []
