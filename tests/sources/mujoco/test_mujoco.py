"""Captures of a MuJoCo model, held against geometry by hand, single rays, and each other."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from support.judged import Errors

import omniscv
from omniscv import dataset
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.job import load
from omniscv.make import make
from omniscv.sources import Request, View, codecs

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")

ROOM = Path(__file__).parent / "four-wall.xml"
CENTER = (0.1, 0.2, 1.4)
ANGLES = (20, -5), (120, -20), (250, -30)
VIEWS = [View(Pose.from_angles(CENTER, *angles), 90, 96, 96) for angles in ANGLES]
DATA = ("object_mask", "depth", "normals")
NORTH = 6
"""The label of the north wall."""


@pytest.fixture(scope="module")
def room():
    with omniscv.open_source(f"mujoco://{ROOM}") as source:
        yield source


@pytest.fixture(scope="module")
def raster():
    with omniscv.open_source(f"mujoco://{ROOM}?data=raster") as source:
        yield source


def pictures(source, view=VIEWS[0], modes=(*DATA, "lit")):
    captures = source.capture(Request(view, mode, source.state) for mode in modes)
    return {capture.mode: capture.pixels for capture in captures}


def label(source, name):
    return source.objects().label(name)


def test_a_sphere_and_a_floor_are_where_they_stand(room):
    """The nearer root of the ray's quadratic, and the plane z = 0, in float64."""
    view = VIEWS[0]
    seen = pictures(room, modes=DATA)
    d = view.directions_w()
    to_ball = np.array((1.2, 0.5, 0.8)) - CENTER
    along = d @ to_ball
    behind = along**2 - to_ball @ to_ball + 0.3**2
    ball = along - np.sqrt(np.maximum(behind, 0))
    for name, distance in (("ball", ball), ("floor", -CENTER[2] / d[..., 2])):
        shown = seen["object_mask"] == label(room, name)
        assert shown.sum() > 300
        np.testing.assert_allclose(seen["depth"][shown], (distance / view.ray_lengths())[shown], rtol=2e-7)
    inside = seen["object_mask"] == label(room, "ball")
    assert (inside == ((behind > 0) & (ball > 0))).all()
    middle = CENTER + ball[..., None] * d - (1.2, 0.5, 0.8)
    np.testing.assert_allclose(seen["normals"][inside], middle[inside] / 0.3, atol=1e-6)


def test_rays_of_many_origins_meet_what_single_rays_meet(room):
    generator = np.random.default_rng(4)
    origins = np.repeat(generator.uniform((-2, -2, 0.2), (2, 2, 2.5), (30, 3)), 4, axis=0)
    directions = generator.normal(size=(120, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = room.trace(origins, directions)
    model = mujoco.MjModel.from_xml_path(str(ROOM))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = np.zeros(1, np.int32)
    for i in range(120):
        distance = mujoco.mj_ray(model, data, origins[i], directions[i], None, 1, -1, geom, None)
        assert hits.distance[i] == (distance if geom[0] >= 0 else np.inf)
        body = model.geom_bodyid[geom[0]] if geom[0] >= 0 else 0
        name = model.body(body).name if body else model.geom(geom[0]).name if geom[0] >= 0 else None
        assert hits.label[i] == (0 if name is None else label(room, name))


def test_rays_meet_what_is_only_seen_and_nothing_where_they_are_unknown():
    """A board without contacts on a small body that has some: many rays at once pass it in MuJoCo 4.0."""
    board = "<geom type='box' size='.02 .5 .5' contype='0' conaffinity='0'/>"
    body = f"<body pos='1 0 0'><geom type='sphere' size='.05'/>{board}</body>"
    xml = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    from omniscv.sources.mujoco import from_model

    with from_model(mujoco.MjModel.from_xml_string(xml)) as source:
        directions = np.array([[1, 0.3, 0.3], [1, 0.6, 0.1], [np.nan] * 3]) / np.sqrt(1.18)
        hits = source.trace(np.zeros(3), directions)
    np.testing.assert_allclose(hits.distance, [0.98 * np.sqrt(1.18), np.inf, np.inf])
    assert hits.label.tolist() == [1, 0, 0]


@pytest.mark.parametrize("view", VIEWS)
def test_the_renderer_agrees_with_rays_within_its_bound(room, raster, view):
    exact = room.trace(view.pose.position, view.directions_w())
    mask, depth = raster.capture(Request(view, mode) for mode in ("object_mask", "depth"))
    same = (mask.pixels == exact.label) & np.isfinite(exact.distance)
    assert (mask.pixels == exact.label).mean() > 0.998  # edges of facets
    off = np.abs((depth.pixels * view.ray_lengths())[same] - exact.distance[same])
    error = codecs.error_of(depth)[same]
    assert (off <= error).all()
    flat = np.isin(exact.label[same], [label(room, name) for name in ("floor", "north", "west")])
    assert (error[flat] < 1e-4).mean() > 0.98  # beside an outline a normal is not known


@pytest.mark.parametrize(
    ("headlight", "agrees"),
    [
        ("center", True),
        ("camera", False),
        *(pytest.param(name, True, marks=pytest.mark.soak) for name in ("ambient", "off")),
    ],
)
def test_views_of_one_centre_agree_in_colour(headlight, agrees):
    """The same rays in two views, turned by 40 degrees: nearest pixels, away from textures' edges."""
    one, other = (View(Pose.from_angles(CENTER, yaw, -5), 90, 100, 100) for yaw in (0, 40))
    with omniscv.open_source(f"mujoco://{ROOM}?headlight={headlight}") as source:
        a, b = (pictures(source, view, ("lit", "object_mask")) for view in (one, other))
    points = CENTER + one.directions_w()
    u, v, z = np.moveaxis(other.project(points), -1, 0)
    at = np.floor([v, u]).astype(int)
    shared = (z > 0) & (at >= 1).all(axis=0) & (at < 99).all(axis=0)
    rows, columns = np.where(shared, at, 0)
    inner_a, inner_b = (
        cv2.erode((of["object_mask"] == NORTH).astype(np.uint8), np.ones((5, 5))) for of in (a, b)
    )
    wall = shared & (inner_a > 0) & (inner_b[rows, columns] > 0)  # outlines are smoothed by each view
    apart = np.abs(a["lit"].astype(int) - b["lit"][rows, columns]).max(axis=-1)[wall]
    assert wall.sum() > 600
    assert ((apart > 4).mean() < 0.001) == agrees


MOVES = {"north": (-1.5, 0, 0), "ball": (0, 0.3, 0.4), "post": (3, -1, 0), "arm": (0, 0, 0.3)}


@pytest.mark.parametrize("name", MOVES)
def test_what_is_placed_is_there_with_what_hangs_on_it_and_put_back_to_the_bit(room, name):
    before = pictures(room)
    rest = room.poses(["arm", name])
    turn = Pose.from_angles((0, 0, 0), 30).rotation @ Pose.from_angles((0, 0, 0)).rotation.T
    pose = Pose(rest[name].position + MOVES[name], turn @ rest[name].rotation)
    with room.at(Instant({name: pose})) as moved:
        found = moved.poses(["arm", name])
        np.testing.assert_allclose(found[name].position, pose.position, atol=1e-9)
        np.testing.assert_allclose(found[name].rotation, pose.rotation, atol=1e-9)
        if name == "post":  # the arm follows
            offset = turn @ (rest["arm"].position - rest[name].position)
            np.testing.assert_allclose(found["arm"].position - pose.position, offset, atol=1e-9)
        toward = moved.geometry().boxes[name].center_w - CENTER
        hit = moved.trace(np.array(CENTER), toward / np.linalg.norm(toward))
        shown = pictures(moved, modes=("object_mask",))["object_mask"]
        assert hit.label == label(room, name) or name == "arm"
        assert not np.array_equal(shown, before["object_mask"]) or name == "arm"
    after = pictures(room)
    assert all(np.array_equal(before[mode], after[mode]) for mode in before)


def test_hidden_objects_are_in_no_layer(room):
    with room.without(["ball"]) as source:
        seen = pictures(source)
    with room.at(Instant.drawn({"objects": {"ball": {"shown": False}}})) as source:
        drawn = pictures(source)
    assert all(np.array_equal(pixels, drawn[mode]) for mode, pixels in seen.items())
    assert not (seen["object_mask"] == label(room, "ball")).any()
    shown = pictures(room)
    ball = shown["object_mask"] == label(room, "ball")
    assert (seen["depth"][ball] > shown["depth"][ball]).all()
    assert (seen["lit"][ball] != shown["lit"][ball]).any(axis=-1).mean() > 0.9


def test_lights_and_materials_are_drawn(room):
    assert room.variable("lights")["lamp"]["diffuse"] == 3
    assert room.variable("materials")["red"]["rgba"] == 3
    drawn = {"materials": {"red": {"rgba": [0, 1, 0]}}, "lights": {"lamp": {"diffuse": [0, 0, 0]}}}
    shown = pictures(room)
    with room.at(Instant.drawn(drawn)) as source:
        seen = pictures(source)
    ball = shown["object_mask"] == label(room, "ball")
    assert seen["lit"][ball].mean(axis=0).argmax() == 1
    assert shown["lit"][ball].mean(axis=0).argmax() == 0
    floor = shown["object_mask"] == label(room, "floor")
    assert seen["lit"][floor].mean() < shown["lit"][floor].mean()
    assert all(np.array_equal(pixels, shown[mode]) for mode, pixels in pictures(room).items())


def test_time_is_steps_of_physics_in_any_order(room):
    """Free fall, before the ball meets the floor: g t^2 / 2, less what half-explicit steps of 2 ms add."""
    heights = {}
    for time in (0.2, 0.1, 0.3):
        with room.at(Instant(time=time)) as source:
            heights[time] = source.poses()["ball"].position[2]
    for time, height in heights.items():
        assert height == pytest.approx(0.8 - 9.81 / 2 * time * (time + 0.002), abs=1e-6)


def test_keyframes_and_qpos_say_where_it_begins(tmp_path):
    with omniscv.open_source(f"mujoco://{ROOM}", keyframe="up") as source:
        assert source.poses(["ball"])["ball"].position[2] == 1.8
    rows = np.array([[0, 0, 0, 1, 1, 0, 0, 0, 0], [2, 1, 0, 1, 0, 0, 0, 1, 1.0]])
    np.save(tmp_path / "track.npy", rows)
    np.savetxt(tmp_path / "track.txt", rows)
    for name in ("track.npy", "track.txt"):
        with (
            omniscv.open_source(f"mujoco://{ROOM}?qpos={tmp_path / name}") as source,
            source.at(Instant(time=0.5)) as quarter,
        ):
            pose = quarter.poses(["ball"])["ball"]
            np.testing.assert_allclose(pose.position, (0.25, 0, 1), atol=1e-12)
            np.testing.assert_allclose(pose.rotation[0, 0], np.cos(np.pi / 4), atol=1e-12)


def test_a_program_has_images_of_the_state_that_it_is_in():
    model = mujoco.MjModel.from_xml_path(str(ROOM))
    data = mujoco.MjData(model)
    data.qpos[2] = 2.0
    mujoco.mj_forward(model, data)
    from omniscv.sources.mujoco import from_model

    with from_model(model, data) as source:
        assert source.poses()["ball"].position[2] == 2.0
        data.qpos[0] = 0.7
        assert source.poses()["ball"].position[0] == 1.2  # it has a copy
        with source.with_state(data) as later:
            assert later.poses()["ball"].position[0] == 0.7
            assert later.state != source.state
        assert model.geom_rgba[0, 3] == 1
        assert source.poses()["ball"].position[0] == 1.2


def test_what_it_is_not_is_refused():
    for options, expected in (
        ({"keyframe": "down"}, "keyframe: expected one of the model's: up; got 'down'"),
        ({"groups": "7"}, "options.groups: expected groups of geoms"),
        ({"qpos": [1, 2]}, "qpos: expected 8 numbers, or rows of an increasing time and 8 numbers, got 2"),
        ({"retries": 3}, "options: unknown key 'retries'"),
    ):
        with pytest.raises(ArgumentError, match=expected.replace("(", r"\(")):
            omniscv.open_source(f"mujoco://{ROOM}", **options)


def test_files_that_are_no_models_and_skins_that_rays_pass_are_refused_in_a_line(tmp_path):
    (tmp_path / "broken.xml").write_text("<mujoco>\n<worldbody>")
    with pytest.raises(ArgumentError, match=r"expected a model of MuJoCo in .*broken.xml', got: [^\n]*$"):
        omniscv.open_source(f"mujoco://{tmp_path}/broken.xml")
    (tmp_path / "cloth.xml").write_text(
        "<mujoco><worldbody><flexcomp name='c' type='grid' count='3 3 1' spacing='.1 .1 .1' pos='0 0 1'"
        " dim='2' radius='.01'/></worldbody></mujoco>"
    )
    with pytest.raises(ArgumentError, match=r"cloth: expected a model whose rays meet.*data=raster"):
        omniscv.open_source(f"mujoco://{tmp_path}/cloth.xml")


@pytest.mark.parametrize(
    ("backend", "expected"),
    [
        ("disabled", "modes: expected some of depth, normals, object_mask.*got lit"),
        ("glfw", "expected OpenGL to render with.*MUJOCO_GL=egl"),
        ("osmesa", "expected the library of MUJOCO_GL=osmesa.*egl, or to disabled"),
    ],
)
def test_without_opengl_there_are_data_and_a_line_that_says_what_to_do(backend, expected):
    code = (
        "import omniscv; from omniscv.sources import Request, View\n"
        "from omniscv.sources.base import check_modes\n"
        f"source = omniscv.open_source('mujoco://{ROOM}')\n"
        "view = View(omniscv.Pose.from_angles((0.1, 0.2, 1.4)), 90, 8, 8)\n"
        "data = [Request(view, mode) for mode in ('depth', 'object_mask', 'normals')]\n"
        "assert all(capture.pixels.any() for capture in source.capture(data))\n"
        "check_modes(source, ['lit']); next(source.capture([Request(view, 'lit')]))\n"
    )
    gone = ("DISPLAY", "WAYLAND_DISPLAY", "PYOPENGL_PLATFORM")
    there = {key: value for key, value in os.environ.items() if key not in gone} | {"MUJOCO_GL": backend}
    done = subprocess.run([sys.executable, "-c", code], env=there, capture_output=True, text=True)
    if backend == "osmesa" and not done.returncode:
        pytest.skip("OSMesa is installed here")
    assert re.search(expected, done.stderr.splitlines()[-1]), done.stderr


def test_colours_need_no_screen_in_a_program_that_has_imported_mujoco(room):
    code = (
        "import hashlib, sys, mujoco\n"
        "from omniscv import Pose\n"
        "from omniscv.sources import Request, View\n"
        "from omniscv.sources.mujoco import from_model\n"
        f"with from_model(mujoco.MjModel.from_xml_path({str(ROOM)!r})) as source:\n"
        "    views = [View(Pose.from_angles((0.1, 0.2, 1.4), yaw), 90, 32, 32) for yaw in (0, 90)]\n"
        "    for capture in source.capture([Request(view, 'lit') for view in views]):\n"
        "        print(hashlib.sha256(capture.pixels.tobytes()).hexdigest())\n"
    )
    gone = ("DISPLAY", "WAYLAND_DISPLAY", "PYOPENGL_PLATFORM", "MUJOCO_GL")
    there = {key: value for key, value in os.environ.items() if key not in gone}
    done = subprocess.run([sys.executable, "-c", code], env=there, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    expected = []
    for yaw in (90, 0):  # each alone, and not in the order of the program
        view = View(Pose.from_angles((0.1, 0.2, 1.4), yaw), 90, 32, 32)
        (capture,) = room.capture([Request(view, "lit")])
        expected.insert(0, hashlib.sha256(capture.pixels.tobytes()).hexdigest())
    assert done.stdout.split() == expected


def test_images_of_every_kind_are_within_their_bounds(room):
    pose = Pose.from_angles(CENTER, 20, -5, 3)
    ball = {"mirror_radius": 0.3, "distance": 0.3, "fov_deg": 280}
    for camera in (
        omniscv.cameras.create("fisheye-equidistant", width=96, height=96, fov_deg=190),
        omniscv.cameras.create("noncentral-panorama", width=96, height=48, radius=0.3),
        omniscv.cameras.create("noncentral-spherical-mirror", width=48, height=48, **ball),
    ):
        image = omniscv.render(camera, pose, room, ("object_mask", "depth"))
        assert Errors(image, room).uncovered[image.valid].mean() <= 2e-4  # a pixel


def test_a_job_moves_bodies_along_a_trajectory_and_draws_materials(tmp_path):
    shutil.copy(ROOM, tmp_path / "room.xml")
    rows = [[0, 1.2, 0.5, 0.8, 1, 0, 0, 0, 0], [1, 1.2, -0.5, 0.8, 1, 0, 0, 0, 0.5]]
    np.save(tmp_path / "track.npy", np.array(rows))
    ways = [{"time": 0, "position": [-1, 1, 0.6]}, {"time": 1, "position": [-1, 0, 0.6]}]
    job = {
        "source": "mujoco://room.xml",
        "source_options": {"qpos": "track.npy"},
        "cameras": {"ring": {"model": "noncentral-panorama", "width": 32, "height": 16, "radius": 0.2}},
        "poses": [{"position": CENTER}, {"position": CENTER, "yaw_deg": 20}],
        "times": [0.0, 0.5],
        "motions": {"post": ways},
        "vary": {"seed": 1, "materials": {"red": {"rgba": {"choice": [[0, 1, 0], [0, 0, 1]]}}}},
        "modes": ["object_mask", "depth"],
        "truth": {"poses": {}, "flow": {}},
        "out": "data",
    }
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job))
    make(load(tmp_path / "job.yaml"))
    frames = dataset.open(tmp_path / "data")
    poses = [{name: pose["position"] for name, pose in frame.truth["poses"].items()} for frame in frames]
    varied = [frame.varied["materials"]["red"]["rgba"] for frame in frames]
    np.testing.assert_allclose([of["ball"] for of in poses], [(1.2, 0.5, 0.8), (1.2, 0, 0.8)], atol=1e-9)
    np.testing.assert_allclose([of["post"] for of in poses], [(-1, 1, 0.6), (-1, 0.5, 0.6)], atol=1e-9)
    np.testing.assert_allclose([of["arm"] for of in poses], [(-1, 1, 1.2), (-1, 0.5, 1.2)], atol=1e-9)
    assert all(rgba in ([0, 1, 0], [0, 0, 1]) for rgba in varied)


PANORAMA = omniscv.cameras.create("equirectangular", width=64, height=32)


@pytest.mark.rays
def test_truth_of_a_panorama_comes_by_rays_unless_the_address_says_otherwise(room):
    """Where neither says that it may be wrong, rays and captures have the same labels and depth."""
    pose = Pose.from_angles(CENTER, 20)
    rays = omniscv.render(PANORAMA, pose, room, DATA)
    with omniscv.open_source(f"mujoco://{ROOM}?traces=0") as source:
        assert source.scene_identity == room.scene_identity
        captured = omniscv.render(PANORAMA, pose, source, DATA)
    assert rays.effort.captures == 0
    assert rays.effort.traced == DATA
    assert captured.effort.captures > 0
    assert captured.effort.traced == ()
    assert rays.doubtful == 0
    sure = ~captured.doubt
    assert sure.mean() > 0.8
    assert np.array_equal(rays.labels[sure], captured.labels[sure])
    met = sure & np.isfinite(rays.depth)
    bound = captured.depth_error[met] + rays.depth_error[met]
    assert (np.abs(rays.depth[met] - captured.depth[met]) <= bound).all()
