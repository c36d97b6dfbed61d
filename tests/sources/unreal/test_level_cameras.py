"""Cameras of a level, their cine models, and manual exposure of the camera that is spawned."""

import dataclasses
import re
from contextlib import contextmanager

import numpy as np
import pytest
from support.expected_views import nearly_all_equal, png, seen_by_cine
from support.unreal import relayed
from support.wire import RawClient
from support.worlds import CENTER

import mock_server
import omniscv
from omniscv.calibration import load
from omniscv.cameras import create
from omniscv.cli import run
from omniscv.diagnostics.server import cameras_of
from omniscv.errors import ArgumentError, MissingCaptureError, ServerRefusedError
from omniscv.sources import Lens, Request, SourceWrapper, View
from omniscv.sources.recording.folders import export, import_folder
from omniscv.testing import check_source

EDGE = 48
LAYERS = ("lit", "object_mask", "depth", "normals")
PLAIN = ("location 50 -20 140", "rotation 5 40 3", "size 60 40")
OFF_CENTRE = (*PLAIN, "cine/filmback 36 24 3 -2", "cine/lens 18 2.8")
CENTRED = (*PLAIN, "cine/filmback 36 24 0 0", "cine/lens 12 2.8")


@contextmanager
def level(commands, **options):
    """A server whose level has camera 1, set by commands: it and camera 1's picture by another client."""
    with mock_server.serve("four-wall", size=(EDGE, EDGE), frames_per_s=1000, **options) as server:
        raw = RawClient(server)
        raw.ask("vset /cameras/spawn")
        for command in commands:
            assert raw.text(f"vset /camera/1/{command}") == "ok"
        lit = png(raw.ask("vget /camera/1/lit png"))[..., :3]
        raw.socket.close()
        server.statistics.counts.clear()
        yield server, lit


def state(server):
    """What camera 1 is set to."""
    raw = RawClient(server)
    known = [raw.text(f"vget /camera/1/{what}") for what in ("location", "rotation", "fov", "size", "cine")]
    raw.socket.close()
    return known


def test_an_image_of_a_cine_camera_off_its_axis_is_the_cameras_own_picture(tmp_path, capsys):
    """By a pinhole camera of its intrinsics, from captures of a camera that is spawned."""
    with level(OFF_CENTRE) as (server, own):
        path = tmp_path / "hero.json"
        assert run(["cameras", "from-unreal", server.uri, "--number", "1", "--out", str(path)]) == 0
        assert not [command for command in server.statistics.counts if command.startswith("vset")]
        text = capsys.readouterr().out
        assert "1 FusionCameraSensor (cine): " in text
        place, *angles = re.findall(r"--(?:position|yaw|pitch|roll) (\S+)", text)
        pose = omniscv.Pose.from_angles([float(value) for value in place.split(",")], *map(float, angles))
        (camera,) = load(path).values()
        assert (camera.width, camera.height) == (60, 40)
        with omniscv.open_source(server.uri) as source:
            image = omniscv.render(camera, pose, source, ("lit",), face_size=256)
    # Bilinear between pixels of finer faces: edges differ, surfaces by less than two levels.
    assert np.median(np.abs(image.lit.astype(int) - own)) <= 1
    assert np.mean(np.abs(image.lit.astype(int) - own) > 8) < 0.06


def test_a_centred_cine_camera_captures_with_its_own_field_of_view_and_is_put_back():
    with level(CENTRED) as (server, own):
        before = state(server)
        (_, known) = cameras_of(server.uri)
        with omniscv.open_source(f"{server.uri}?camera=1") as source:
            assert not source.capabilities.can_set_fov
            fov = source.capabilities.fov_deg
            assert fov == pytest.approx(2 * np.degrees(np.arctan(1.5)))  # 36 mm wide, 12 mm before it
            (capture,) = source.capture([Request(View(known.pose, fov, 60, 40), "lit")])
            np.testing.assert_array_equal(capture.pixels, own)
            assert capture.provenance["camera"] == "1"
            with pytest.raises(
                ArgumentError, match=r"fov_deg: expected 112.6.* of the camera's lens, got 90"
            ):
                list(source.capture([Request(View(known.pose, 90.0, 60, 40), "lit")]))
        sent = {command for command in server.statistics.counts if command.startswith("vset /camera/1/")}
        assert not [command for command in sent if "cine" in command or "fov" in command]
        assert server.statistics.total("vset /cameras/spawn") == 0
        assert state(server) == before


STRETCHED = (*OFF_CENTRE, "size 60 30")


@pytest.fixture(scope="module")
def stretched(tmp_path_factory):
    """What the cine camera off its axis, whose pixels are not square, captures of a room: recorded."""
    path = tmp_path_factory.mktemp("cine") / "room.sqlite"
    with level(STRETCHED, faults=["stretched-cine"]) as (server, own):
        before = state(server)
        (_, known) = cameras_of(server.uri)
        _, _, fx, fy, cx, cy = known.intrinsics
        camera = create("pinhole", 60, 30, fx=fx, fy=fy, cx=cx, cy=cy)
        with omniscv.record(omniscv.open_source(f"{server.uri}?camera=1"), path) as source:
            image = omniscv.render(camera, known.pose, source, LAYERS)
        assert state(server) == before
        assert server.statistics.total("vset /cameras/spawn") == 0
    return path, camera, known.pose, image, own


def test_a_cine_camera_off_its_axis_captures_what_its_filmback_shows(stretched):
    """One picture; each of its pixels is a pixel of the image, so that nothing is interpolated."""
    _, camera, pose, image, own = stretched
    assert (camera.fx, camera.fy) == (30.0, 22.5)
    np.testing.assert_array_equal(image.lit, own)
    scene = mock_server.load_scene("four-wall")
    hits, planar = seen_by_cine(scene, (50, -20, 140), (5, 40, 3), (36, 24, 3, -2), 18, 60, 30)
    nearly_all_equal(image.lit, np.round(255 * hits.color), 1)  # poses have three decimals on the wire
    nearly_all_equal(image.labels[..., None], hits.label[..., None])
    off = np.abs(image.depth - hits.distance) > image.depth_error + 1e-4  # a hundredth of a centimetre
    assert off.mean() < 0.005
    assert planar.min() > 0.5  # so that the depths above are no zeros
    assert np.median((image.normals @ pose.R_w_c.T * hits.normal).sum(-1)) > 0.999  # they come in 8 bits


def test_captures_through_a_lens_are_replayed_and_go_into_folders_and_back(stretched, tmp_path):
    path, camera, pose, image, _ = stretched
    with omniscv.open_source(path) as replay:
        again = omniscv.render(camera, pose, replay, LAYERS)
        (lens,) = {view.lens for view in replay.recorded_views()}
        assert lens == pytest.approx((0.75, -3 / 36, -2 / 24))  # fy / fx, and the filmback's offsets
        plain = [Request(dataclasses.replace(view, lens=None), "lit") for view in replay.recorded_views()]
        with pytest.raises(MissingCaptureError, match="lens: "):
            list(replay.capture(plain))
        export(path, tmp_path / "folder")
        import_folder(tmp_path / "folder", tmp_path / "again.sqlite")
        with omniscv.open_source(tmp_path / "again.sqlite") as folder:
            assert folder.recorded_views() == replay.recorded_views()
    for layer in ("lit", "labels", "depth", "normals", "depth_error"):
        np.testing.assert_array_equal(again[layer], image[layer])


@pytest.mark.parametrize("filter", ["bilinear", "bicubic", "area"])
def test_images_from_a_view_through_a_lens_are_those_of_finer_faces(stretched, filter):
    """A fisheye within the picture; colours of the room are flat but for edges."""
    _, _, pose, _, _ = stretched
    lens, camera = Lens(0.75, -0.0625, 0.125), create("fisheye-equidistant", 24, 24, fov_deg=50)
    view = View(pose, 100.0, 192, 160, lens)
    with omniscv.open_source("scene://four-wall") as scene:

        class Fixed(SourceWrapper):
            capabilities = dataclasses.replace(
                scene.capabilities, can_set_size=False, can_set_fov=False,
                image_size=(192, 160), fov_deg=100.0, lens=lens,
            )  # fmt: skip

        image = omniscv.render(camera, pose, Fixed(scene), LAYERS, filter=filter)
        wanted = omniscv.render(camera, pose, scene, LAYERS, filter=filter)
        assert Fixed(scene).capabilities.lens == view.lens
        for other in (create("equirectangular", 16, 8), create("pinhole", 16, 16, fov_deg=110)):
            with pytest.raises(ArgumentError, match="square pixels around the optical axis, got Lens"):
                omniscv.render(other, pose, Fixed(scene), ("lit",))
    inner = image.valid & ~image.label_edge & ~wanted.label_edge
    np.testing.assert_array_equal(image.labels[inner], wanted.labels[inner])
    off = np.abs(image.depth - wanted.depth)[inner]
    assert (off <= (image.depth_error + wanted.depth_error)[inner]).all()
    assert np.mean(np.abs(image.lit.astype(int) - wanted.lit)[inner] > 4) < 0.05


def test_other_views_than_the_lens_shows_are_refused():
    with level(STRETCHED, faults=["stretched-cine"]) as (server, _):
        (_, known) = cameras_of(server.uri)
        with omniscv.open_source(f"{server.uri}?camera=1") as source:
            own = source.capabilities
            for view, says in (
                (View(known.pose, own.fov_deg, 60, 30), "lens: expected Lens"),
                (View(known.pose, own.fov_deg, 30, 15, own.lens), "size: expected 60 x 30 px of the camera"),
            ):
                with pytest.raises(ArgumentError, match=says):
                    list(source.capture([Request(view, "depth")]))
            check_source(source)
    view = View(known.pose, 90.0, 8, 8, own.lens)
    with omniscv.open_source("mock://four-wall") as source, pytest.raises(ArgumentError, match="got Lens"):
        list(source.capture([Request(view, "depth")]))


def test_a_plain_camera_of_the_level_is_used_and_put_back():
    with level(PLAIN) as (server, _):
        before = state(server)
        with omniscv.open_source(f"{server.uri}?camera=1") as source:
            view = View(omniscv.Pose.from_angles(CENTER), 75.0, 32, 24)
            capture, color = source.capture([Request(view, "depth"), Request(view, "lit")])
            assert capture.pixels.shape == (24, 32)
            assert "exposure" not in color.provenance
        assert server.statistics.total("vset /camera/1/cine") == 0
        assert server.statistics.total("vset /camera/1/exposure") == 0
        assert state(server) == before


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ("?camera=0", "expected a camera from 1 to 1 of the level, got 0"),
        ("?camera=7", "expected a camera from 1 to 1 of the level, got 7"),
        ("?camera=CID-Actor-00", "No handler found"),
        ("?camera=x", "expected \\?camera=NUMBER"),
        ("?cam=1", "expected \\?camera=NUMBER"),
    ],
)
def test_cameras_that_cannot_capture_are_refused(query, says):
    with level(OFF_CENTRE) as (server, _), pytest.raises((ServerRefusedError, ArgumentError), match=says):
        omniscv.open_source(server.uri + query)


def test_of_0_3_10_no_camera_can_be_chosen():
    with (
        mock_server.serve("four-wall", dialect="0.3.10", size=(16, 16)) as server,
        pytest.raises(ServerRefusedError, match="expected a server with cameras in its level"),
    ):
        omniscv.open_source(f"{server.uri}?camera=1")


def test_exposure_of_the_command_line(tmp_path, capsys):
    base = ["record", "--source", "mock://four-wall", "--modes", "lit", "--set", "face_size=16"]
    out = str(tmp_path / "a.sqlite")
    assert run([*base, "--exposure", "0.5", "--out", out]) == 0
    with omniscv.open_source(out) as source:
        (view, *_) = source.recorded_views()
        (capture,) = source.capture([Request(view, "lit")])
    assert capture.provenance["exposure"] == "manual, bias 0.5"
    for wrong in ("bright", "99", "1,2"):
        assert run([*base, "--exposure", wrong, "--out", out]) == 2
    expected = "--exposure: expected auto, game or a bias in stops such as 0.5, got"
    assert [expected in line for line in capsys.readouterr().err.splitlines()] == [True, False, True]


def test_fields_of_view_that_engines_clamp_are_refused():
    with omniscv.open_source("mock://four-wall") as source:
        pose = omniscv.Pose.from_angles(CENTER)
        with pytest.raises(ArgumentError, match="expected 1 to 179 degrees, which engines do not clamp"):
            list(source.capture([Request(View(pose, 179.5, 8, 8), "depth")]))


@pytest.mark.parametrize(
    ("what", "stays", "says"),
    [
        ("fov", "90.000000", r"a field of view, degrees, of 100.0, .* got '90.000000'"),
        ("size", "640 480", r"a size, px, of 64 48, which was set, got '640 480'"),
    ],
)
def test_a_setting_that_is_not_kept_is_refused(what, stays, says):
    def change(command, forward):
        return stays if command == f"vget /camera/1/{what}" else forward(command)

    refused = pytest.raises(ServerRefusedError, match=says)
    with mock_server.serve("four-wall") as server, relayed(server, change) as uri, refused:
        omniscv.open_source(uri)


def test_lit_images_in_place_of_normals_are_refused():
    with omniscv.open_source("mock://four-wall?fault=lit-normals") as source:
        view = View(omniscv.Pose.from_angles(CENTER), 90.0, EDGE, EDGE)
        with pytest.raises(ServerRefusedError, match="expected pictures of normals, got the lit image"):
            list(source.capture([Request(view, "normals")]))
