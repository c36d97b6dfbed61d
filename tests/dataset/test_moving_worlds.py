"""Datasets of worlds that move: poses, boxes and flow of each frame are those of its instant."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

import mock_server
from mock_server.scene_file import turned
from omniscv import dataset
from omniscv.geometry.motion import Motion
from omniscv.geometry.trajectory import Trajectory
from omniscv.job import load
from omniscv.make import make

WORKSHOP = mock_server.load_scene("workshop")
JOB = """
source: scene://workshop
cameras:
  pano: {model: equirectangular, width: 128, height: 64}
poses:
  - {position: [0.1, 0.2, 1.1], yaw_deg: 10, time: 0}
  - {position: [0.2, 0.15, 1.2], yaw_deg: 16, pitch_deg: 3, time: 0.3}
  - {position: [0.25, 0.15, 1.2], yaw_deg: 20, time: 0.5}
times: poses
motions:
  Cabinet: [{time: 0, position: [-2, -0.6, 0.85]}, {time: 1, position: [-1.6, -1, 0.85], yaw_deg: 40}]
modes: [object_mask, depth]
face_size: 96
truth: {boxes3d: true, amodal: boxes, flow: {scene: true}}
out: moving
"""
TIMES = (0, 0.3, 0.5)


def cabinet(time):
    return {"Cabinet": (turned(40 * time), np.array([-2 + 0.4 * time, -0.6 - 0.4 * time, 0.85]))}


def world(time):
    return WORKSHOP.at(time, cabinet(time))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving")
    (folder / "job.yaml").write_text(JOB, encoding="utf-8")
    make(load(folder / "job.yaml"))
    return folder


def test_frames_have_the_poses_of_all_that_moves(made):
    frames = dataset.open(made / "moving")
    assert len({frame.state for frame in frames} - {""}) == 3
    for time, frame in zip(TIMES, frames, strict=True):
        assert set(frame.truth["poses"]) == {*WORKSHOP.moving, "Cabinet"}
        for name, pose in frame.truth["poses"].items():
            R_w_o, place = world(time).pose(name)
            np.testing.assert_allclose(pose["position"], place, atol=1e-9)
            np.testing.assert_allclose(pose["rotation"], R_w_o, atol=1e-9)
    assert dataset.check(made / "moving", deep=True) == []


def test_boxes_follow_the_objects(made):
    for time, frame in zip(TIMES, dataset.open(made / "moving"), strict=True):
        boxes = {box["name"]: box for box in frame.truth["boxes3d"]}
        assert {"Cabinet", "Crate"} <= set(boxes)
        for name in {"Cabinet", "Crate", "Lamp"} & set(boxes):
            low, high = world(time).bounds(name)
            box = boxes[name]
            np.testing.assert_allclose(box["center_world"], (low + high) / 2, atol=1e-6)
            half = np.abs(np.array(box["R_world_box"])) @ box["size"] / 2
            np.testing.assert_allclose(half, (high - low) / 2, atol=1e-6)
            np.testing.assert_allclose(
                frame.pose.to_world(box["center_camera"]), box["center_world"], atol=1e-9
            )
        turn = np.array(boxes["Cabinet"]["R_world_box"])
        np.testing.assert_allclose(np.abs(turn), np.abs(turned(40 * time)), atol=1e-9)


def test_frames_of_another_motion_are_made_again(made, tmp_path):
    """Of an object that goes elsewhere after the first frame, only the others."""
    job = load(made / "job.yaml")
    shutil.copytree(made / "moving", tmp_path / "other")
    first, last = job.motions["Cabinet"].waypoints
    other = Motion(Trajectory((first, replace(last, position=last.position + 0.1)), (0.0, 1.0)))
    done = make(replace(job, out=tmp_path / "other", motions={"Cabinet": other}), resume=True)
    assert (done.written, done.kept) == (2, 1)


def test_frames_without_object_poses_have_no_flow(made, tmp_path):
    """Rather than that of a world that stands still."""
    frames = [
        replace(frame, files={kind: path for kind, path in frame.files.items() if kind != "truth"})
        for frame in dataset.open(made / "moving")
    ]
    (only,) = dataset.get("flow").export(frames, tmp_path, {})
    assert json.loads(only.read_text(encoding="utf-8"))["to"] == {}
