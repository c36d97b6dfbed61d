"""Captures that are developed: of a live source and of its recording alike, and no more than that takes."""

import numpy as np
import pytest
from support.recordings import CountingSource

import omniscv
from omniscv.cli import run
from omniscv.geometry import Pose, cube_rotations
from omniscv.render_options import RenderOptions
from omniscv.sources.base import Capture, Request, View
from omniscv.sources.developing import Developed
from omniscv.sources.developing.slips import straightened
from omniscv.sources.scene import open_scene
from omniscv.testing import check_source

DOME = "mock://open?fault=sky-dome=300"
PLACES = (0.3, -0.2, 1.45), (0.6, 0.1, 1.3)
EDGE = 16


def faces(modes, places=PLACES):
    views = (View(Pose(at, R_w_c), 90, EDGE, EDGE) for at in places for _, R_w_c in cube_rotations())
    return [Request(view, mode) for view in views for mode in modes]


@pytest.mark.parametrize("asked", [{"seams": "close"}, {"sky": ("Sofa",)}, {"straighten": True}])
def test_it_is_a_source_as_any_other(asked):
    with Developed(open_scene("scene://four-wall"), RenderOptions(**asked)) as source:
        check_source(source)


@pytest.mark.parametrize("modes", [("lit",), ("object_mask", "depth", "lit")])
def test_each_capture_is_made_once(modes):
    source = CountingSource(open_scene("scene://four-wall"))
    requests = faces(modes)
    with Developed(source, RenderOptions(seams="close")) as developed:
        captures = list(developed.capture(requests))
        assert [capture.request for capture in captures] == requests
        assert sorted(source.requests, key=requests.index) == requests
        source.requests.clear()
        (one,) = developed.capture(requests[modes.index("lit") :][:1])
    assert len(source.requests) == 6
    colors = [capture for capture in captures if capture.mode == "lit"]
    assert all(set(capture.marks) == {"relit"} for capture in colors)
    if modes == ("lit",):
        np.testing.assert_array_equal(one.pixels, colors[0].pixels)


def test_a_replay_with_sky_plans_what_the_live_job_captured(tmp_path):
    """A ring of centres, whose captures follow from the depth that it finds: every one is asked for again."""
    path = tmp_path / "open.sqlite"
    job = ["--camera", "noncentral-panorama", "--size", "32x16", "--set", "camera.radius=0.2"]
    job += ["--position", "0.3,-0.2,1.45", "--modes", "lit,object_mask,depth", "--set", "sky=[SkyDome]"]
    assert run(["render", "--source", DOME, *job, "--set", f"record={path}", "--out", str(tmp_path)]) == 0
    camera = omniscv.cameras.create("noncentral-panorama", 32, 16, radius=0.2)
    pose = Pose.from_angles(PLACES[0])
    modes = ("lit", "object_mask", "depth")
    with omniscv.open_source(path) as replay:
        source = CountingSource(replay)
        image = omniscv.render(camera, pose, source, modes, sky=("SkyDome",))
        recorded = {Request(v, mode) for mode in modes for v in replay.recorded_in(mode)}
    assert set(source.requests) == recorded
    assert np.isinf(image.depth).mean() > 0.2
    with omniscv.open_source(DOME) as live:
        online = omniscv.render(camera, pose, live, modes, sky=("SkyDome",))
    for layer in image.layers:
        np.testing.assert_array_equal(image[layer], online[layer])


def test_the_sky_of_a_round_image_is_where_the_object_was():
    lens = omniscv.cameras.create("fisheye-equidistant", 32, 32, fov_deg=185)
    pose = Pose.from_angles(PLACES[0])
    modes = ("object_mask", "depth")
    with open_scene("scene://four-wall") as source:

        def rendered(*sky):
            return omniscv.render(lens, pose, source, modes, sky=sky)

        plain = rendered()
        label = np.bincount(plain.labels[plain.valid]).argmax()
        image = rendered(source.objects().names()[label - 1])
        at = plain.labels == label
    assert np.isinf(image.depth[at]).all()
    assert not image.labels[at].any()
    for layer in ("depth", "labels", "object_mask"):
        np.testing.assert_array_equal(image[layer][~at], plain[layer][~at])


@pytest.mark.parametrize("mode", ["lit", "object_mask"])
def test_a_face_that_was_turned_is_turned_back_pixel_by_pixel(mode):
    """By nothing, and by a quarter about its axis z, where a ray (x, y) is the turned camera's (y, -x)."""
    view = View(Pose((0, 0, 0), cube_rotations()[1][1]), 90, EDGE, EDGE)
    pixels = np.random.default_rng(4).integers(0, 256, (EDGE, EDGE, 3), np.uint8)
    capture = Capture(Request(view, mode), view, pixels)
    np.testing.assert_array_equal(straightened(capture, np.zeros(3)).pixels, pixels)
    axis_w = view.pose.R_w_c[:, 2]
    v, u = np.mgrid[:EDGE, :EDGE]
    quarter = straightened(capture, axis_w * np.pi / 2).pixels
    np.testing.assert_array_equal(quarter, pixels[EDGE - 1 - u, v])
