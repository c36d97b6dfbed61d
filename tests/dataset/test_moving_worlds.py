"""Datasets of worlds that move: poses, boxes and flow of each frame are those of its instant."""

import json
import shutil
from dataclasses import replace
from itertools import pairwise

import numpy as np
import OpenEXR
import pytest
from support.datasets import tree

import mock_server
from mock_server.motion import turned
from omniscv import dataset, jobs
from omniscv.geometry.motion import Motion
from omniscv.geometry.trajectory import Trajectory

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
    jobs.make(jobs.load(folder / "job.yaml"))
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


def test_the_same_bytes_in_every_way(made, tmp_path):
    """Workers, and a dataset that is resumed; truths that hide objects do so at the frame's instant."""
    wanted, job = tree(made / "moving"), jobs.load(made / "job.yaml")
    jobs.make(replace(job, out=tmp_path / "workers"), workers=3)
    assert tree(tmp_path / "workers") == wanted
    shutil.copytree(made / "moving", tmp_path / "resumed")
    (tmp_path / "resumed" / "pano-1.depth.exr").unlink()
    done = jobs.make(replace(job, out=tmp_path / "resumed"), resume=True)
    assert (done.written, done.kept) == (1, 2)
    assert tree(tmp_path / "resumed") == wanted


def test_frames_of_another_motion_are_made_again(made, tmp_path):
    """Of an object that goes elsewhere after the first frame, only the others."""
    job = jobs.load(made / "job.yaml")
    shutil.copytree(made / "moving", tmp_path / "other")
    first, last = job.motions["Cabinet"].waypoints
    other = Motion(Trajectory((first, replace(last, position=last.position + 0.1)), (0.0, 1.0)))
    done = jobs.make(replace(job, out=tmp_path / "other", motions={"Cabinet": other}), resume=True)
    assert (done.written, done.kept) == (2, 1)


def test_without_poses_of_what_moves_there_is_no_flow(made, tmp_path):
    """Rather than that of a world that stands still."""
    frames = [
        replace(frame, files={kind: path for kind, path in frame.files.items() if kind != "truth"})
        for frame in dataset.open(made / "moving")
    ]
    (only,) = dataset.get("flow").export(frames, tmp_path, {})
    assert json.loads(only.read_text(encoding="utf-8"))["to"] == {}


def test_flow_and_scene_flow_are_those_of_the_motion(made):
    """Of composed depth: where both frames see the point, by tracing both, away from edges."""
    folder, frames = made / "moving" / "exports" / "flow" / "flow", dataset.open(made / "moving")
    total = 0
    for (t0, t1), (one, two) in zip(pairwise(TIMES), pairwise(frames), strict=True):
        camera = one.camera
        directions_w = camera.unproject().directions @ one.pose.rotation.T
        hits = world(t0).trace(one.pose.position, directions_w)
        points_w = one.pose.position + hits.distance[..., None] * directions_w
        moved_w, moving = points_w.copy(), np.zeros(hits.label.shape, bool)
        for name in (*WORKSHOP.moving, "Cabinet"):
            mine = hits.label == WORKSHOP.label(name)
            (R0, place0), (R1, place1) = world(t0).pose(name), world(t1).pose(name)
            moved_w[mine] = (points_w[mine] - place0) @ (R1 @ R0.T).T + place1
            moving |= mine
        toward = moved_w - two.pose.position
        again = world(t1).trace(two.pose.position, toward)
        both = np.abs(again.distance - np.linalg.norm(toward, axis=-1)) < 1e-6

        x, y, z = np.moveaxis(toward @ two.pose.rotation, -1, 0)
        expected = 64 * np.stack(
            [np.arctan2(x, z) / np.pi + 1, 0.5 - np.arctan2(-y, np.hypot(x, z)) / np.pi], -1
        )
        flow, scene = channels(folder / f"{one.key}.exr"), channels(folder / f"{one.key}.sceneflow.exr")
        off = camera.pixels() + np.stack([flow["flow.X"], flow["flow.Y"]], -1) - expected
        off[..., 0] -= 128 * np.rint(off[..., 0] / 128)
        sure = both & (one.layer("depth_error") < 1e-4) & ~one.layer("label_edge")
        total += (sure & moving).sum()
        assert np.abs(off[sure]).max() < 1e-3
        found = np.stack([scene[f"sceneflow.{axis}"] for axis in "XYZ"], -1)
        np.testing.assert_allclose(found[sure], (moved_w - points_w)[sure], atol=1e-4)
        assert not found[sure & ~moving].any()
    assert total > 100


def channels(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: each.pixels for name, each in file.channels().items()}


def test_a_recording_makes_the_same_dataset(made, tmp_path):
    """Its states are those that the job computes; poses and boxes of all that moves come from the file."""
    text = JOB.replace("amodal: boxes, ", "")
    (tmp_path / "job.yaml").write_text(text, encoding="utf-8")
    job = jobs.load(tmp_path / "job.yaml")
    jobs.make(replace(job, record=tmp_path / "kept.sqlite", out=tmp_path / "live"))
    jobs.make(replace(job, source=str(tmp_path / "kept.sqlite"), out=tmp_path / "replayed"))
    assert tree(tmp_path / "replayed") == tree(tmp_path / "live")
