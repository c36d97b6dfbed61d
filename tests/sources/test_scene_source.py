"""``scene://``: pictures traced in this process, against the scene itself."""

import pickle

import numpy as np
import pytest
from support.faces import face_requests

import mock_server
import omniscv
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.pose import R_LEVEL
from omniscv.sources import Capabilities, Request, View
from omniscv.sources.scene import SceneSource

SCENE = mock_server.load_scene("four-wall")
VIEW = View(Pose.from_angles((0.3, -0.2, 1.4), yaw_deg=25, pitch_deg=-12, roll_deg=4), 80.0, 40, 30)


def hits():
    x = (np.arange(VIEW.width) + 0.5 - VIEW.width / 2) / VIEW.focal_px
    y = (np.arange(VIEW.height) + 0.5 - VIEW.height / 2) / VIEW.focal_px
    rays = np.stack([*np.meshgrid(x, y), np.ones((VIEW.height, VIEW.width))], axis=-1)
    return SCENE.trace(VIEW.pose.position, rays @ VIEW.pose.rotation.T)


def captured(source):
    captures = source.capture(Request(VIEW, mode, source.state) for mode in source.capabilities.modes)
    return {each.mode: each.pixels for each in captures}


@pytest.mark.parametrize("lit", ["uint8", "float32"])
def test_every_mode_shows_what_the_rays_meet(lit):
    truth = hits()
    pixels = captured(SceneSource(SCENE, lit=lit))
    assert np.abs(pixels["lit"] / (255 if lit == "uint8" else 1) - truth.color).max() <= 0.5 / 255 + 1e-12
    assert pixels["depth"] * VIEW.ray_lengths() == pytest.approx(truth.distance, rel=1e-6)
    assert pixels["normals"] == pytest.approx(truth.normal, abs=1e-6)


def test_masks_show_the_objects_by_colour_or_by_id():
    truth = hits()
    source = SceneSource(SCENE)
    mask = captured(source)["object_mask"]
    table = source.objects()
    for name in np.array(SCENE.objects)[np.unique(truth.label) - 1]:
        assert (mask[truth.label == SCENE.label(name)] == table.colors[name]).all()
    by_id = SceneSource(SCENE, masks="ids")
    assert np.array_equal(captured(by_id)["object_mask"], truth.label)
    assert by_id.objects().ids == {name: SCENE.label(name) for name in SCENE.objects}
    assert (table.ids, table.tolerance, by_id.objects().colors) == ({}, 0, table.colors)
    assert (0, 0, 0) not in table.colors.values()
    assert len(set(table.colors.values())) == len(SCENE.objects)


def test_views_are_traced_once_and_kept_within_a_bound():
    faces = face_requests(8, ["depth"])
    source = SceneSource(SCENE, cached_views=4)
    assert len(list(source.capture(faces[:4] * 5))) == 20
    assert source.made == 4
    list(source.capture(faces))
    assert source.made == 6
    list(source.capture(faces[5:]))
    assert source.made == 6
    list(source.capture(faces[:1]))
    assert source.made == 7


def test_it_can_declare_what_another_source_can_do():
    fixed = Capabilities(can_set_size=False, image_size=(512, 512), fov_deg=90.0)
    assert SceneSource(SCENE, fixed).capabilities == fixed


def test_addresses(tmp_path):
    path = tmp_path / "ball.yaml"
    path.write_text("objects: {Ball: {solids: [{sphere: 0.5, at: [2, 0, 0]}]}}\n")
    with omniscv.open_source(f"scene://{path}?lit=float32&masks=ids") as source:
        assert source.objects().ids == {"Ball": 1}
        assert next(source.capture(face_requests(8))).provenance["scene"] == "ball"


MOVING = mock_server.load_scene("workshop")
CRATE = Pose((1.4, -0.3, 1.2), Pose.from_angles((0, 0, 0), yaw_deg=30).R_w_c @ R_LEVEL.T)


def test_an_instant_shows_the_scene_at_its_time_with_its_poses_and_without_what_is_hidden():
    instant = Instant({"Crate": CRATE}, frozenset({"Lamp"}), 1.25)
    placed = MOVING.at(1.25, {"Crate": (CRATE.rotation, CRATE.position)})
    with SceneSource(MOVING) as source, source.at(instant) as there:
        expected = captured(SceneSource(placed, hidden=("Lamp",)))
        assert there.state == instant.state
        got = captured(there)
        assert there.geometry().boxes["Crate"].center_w == pytest.approx(CRATE.position)
        assert there.scene_identity == source.scene_identity
        assert there.without(["Crate"]).state == instant.state
        there.close()
        at_start = captured(source)
    assert all(np.array_equal(got[mode], expected[mode]) for mode in expected)
    assert all(np.array_equal(at_start[mode], each) for mode, each in captured(SceneSource(MOVING)).items())
    assert not np.array_equal(got["depth"], at_start["depth"])


def test_an_address_may_have_a_time_and_an_instant_of_another_scene_is_refused():
    with omniscv.open_source("scene://workshop?time=1.25") as source:
        assert source.state == Instant(time=1.25).state
        depth = captured(source)["depth"]
        copied = pickle.loads(pickle.dumps(source))  # noqa: S301 - our own bytes
        assert np.array_equal(captured(copied)["depth"], depth)
        assert copied.state == source.state
        assert source.at(Instant()).state == ""
    assert np.array_equal(depth, captured(SceneSource(MOVING.at(1.25)))["depth"])
    with pytest.raises(ArgumentError, match="scene workshop: expected objects of the scene, got 'Cow'"):
        SceneSource(MOVING).at(Instant({"Cow": CRATE}))
    with pytest.raises(ArgumentError, match=r"scene workshop: time: expected -1e\+09 to 1e\+09 s"):
        SceneSource(MOVING).at(Instant(time=2e9))
