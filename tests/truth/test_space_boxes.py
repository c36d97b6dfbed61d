"""Boxes in space: against the scene's own bounds, and projected by the camera."""

import numpy as np
import pytest
from support.observed import observed

import mock_server
import omniscv
from omniscv import cameras, truth
from omniscv.dataset import truths
from omniscv.geometry.scene_geometry import ObjectBox

POSE = omniscv.Pose.from_angles((0.2, -0.1, 1.5), yaw_deg=30, pitch_deg=-10, roll_deg=5)
SCENE = mock_server.load_scene("four-wall")
CORNERS = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
CAMERAS = {
    "equirectangular": cameras.create("equirectangular", width=512, height=256),
    "kannala-brandt": cameras.model("kannala-brandt").example(256),
    "panorama on a circle": cameras.create("noncentral-panorama", width=512, height=256, radius=0.3),
}


def records(camera, pose=POSE):
    with omniscv.open_source("scene://four-wall") as source:
        boxes = source.geometry().boxes
    return boxes, truth.boxes3d(boxes, camera, pose, {name: SCENE.label(name) for name in SCENE.objects})


def test_boxes_are_the_scenes_bounds():
    boxes, found = records(CAMERAS["equirectangular"])
    assert [record["name"] for record in found] == list(SCENE.objects)
    for record in found:
        low, high = SCENE.bounds(record["name"])
        R_w_b, half = np.array(record["R_world_box"]), np.array(record["size"]) / 2
        if np.isin(np.abs(R_w_b), (0, 1)).all():  # along the world's axes
            assert record["center_world"] - np.abs(R_w_b @ half) == pytest.approx(low, abs=1e-6)
            assert record["center_world"] + np.abs(R_w_b @ half) == pytest.approx(high, abs=1e-6)
        else:
            assert record["name"] in ("Chair_1", "Chair_2")
        assert np.array_equal(boxes[record["name"]].R_w_b, R_w_b)
        away = np.array(record["center_world"]) - POSE.position
        assert record["distance"] == pytest.approx(np.linalg.norm(away))
        assert record["source"] == "scene"
        assert "partial" not in record


@pytest.mark.parametrize("name", CAMERAS)
def test_corners_in_the_cameras_frame_have_the_pixels_of_the_worlds(name):
    camera = CAMERAS[name]
    for record in records(camera)[1]:
        corner = np.array(CORNERS) * np.array(record["size"]) / 2
        world = np.array(record["center_world"]) + corner @ np.array(record["R_world_box"]).T
        own = np.array(record["center_camera"]) + corner @ np.array(record["R_camera_box"]).T
        (a, seen), (b, again) = camera.project(POSE.to_camera(world)), camera.project(own)
        assert np.array_equal(seen, again)
        assert np.abs(a - b)[seen].max(initial=0) <= 1e-6


def test_a_whole_panorama_truncates_nothing():
    assert {record["truncated"] for record in records(CAMERAS["equirectangular"])[1]} == {0.0}


def test_truncated_is_the_share_outside_the_image():
    """Of a cube that a pinhole camera sees a part of, by points strewn over its sides."""
    camera, rng = cameras.create("pinhole", width=80, height=60, fov_deg=70), np.random.default_rng(3)
    for _ in range(8):
        center = rng.uniform([1.5, -2, -1.5], [4, 2, 1.5])
        box = ObjectBox(center, np.eye(3), rng.uniform(0.3, 2, 3), "scene")
        points = rng.uniform(-0.5, 0.5, (60_000, 3))
        sides = rng.integers(0, 3, len(points))
        points[np.arange(len(points)), sides] = rng.choice([-0.5, 0.5], len(points))
        area = np.prod(box.size) / box.size[sides]
        x, y, z = omniscv.Pose.from_angles((0, 0, 0)).to_camera(center + points * box.size).T
        u, v = camera.focal * x / z, camera.focal * y / z
        outside = (z <= 0) | (np.abs(u) > 40) | (np.abs(v) > 30)
        wanted = (outside * area).sum() / area.sum()
        (found,) = truth.boxes3d({"Box": box}, camera, omniscv.Pose.from_angles((0, 0, 0)), ["Box"])
        assert found["truncated"] == pytest.approx(wanted, abs=0.06)


@pytest.mark.parametrize("source", ["mock://four-wall?dialect=0.3.10&size=192x192", "mock://four-wall"])
def test_the_truth_of_a_frame_has_a_box_for_every_object_that_is_seen(source):
    """From vertices, or, where the plugin has none, around points that are seen, which are in the object."""
    camera = cameras.create("equirectangular", width=192, height=96)
    options = {} if "0.3.10" in source else {"face_size": 96}
    with omniscv.open_source(source) as opened:
        seen_frame = observed(opened, camera, omniscv.Pose.from_angles((0, 0, 1.5)), **options)
    found = truths.get("boxes3d").apply(seen_frame, {})
    seen = set(np.unique(seen_frame.image.labels)) - {0}
    by_points = "0.3.10" in source
    assert {record["instance_id"] for record in found} <= seen
    assert len(found) >= len(seen) - 1
    for record in found:
        assert record["source"] == ("points" if by_points else "vertices")
        assert record.get("partial", False) == by_points
        low, high = SCENE.bounds(record["name"])
        corner = np.array(CORNERS) * np.array(record["size"]) / 2
        world = np.array(record["center_world"]) + corner @ np.array(record["R_world_box"]).T
        if by_points:
            assert (world >= low - 0.03).all()
            assert (world <= high + 0.03).all()
        else:
            assert (world.min(axis=0) <= low + 0.01).all()
            assert (world.max(axis=0) >= high - 0.01).all()
