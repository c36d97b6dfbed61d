"""Flow as files, and datasets of worlds that move."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.traced_frames import channels, frame_of, traced_frame

import mock_server
from mock_server.scene_file import turned
from omniscv import Pose, cameras, dataset, truth
from omniscv.dataset import get
from omniscv.dataset.formats.flow import kitti_codes
from omniscv.errors import ArgumentError
from omniscv.geometry.instant import Motion
from omniscv.geometry.trajectory import Trajectory
from omniscv.job import load
from omniscv.make import make
from omniscv.truth import Flow

SCENE = mock_server.load_scene("four-wall")
CAMERA = cameras.create("equirectangular", width=64, height=32)
POSES = [Pose.from_angles((0.2 * i, 0.1 * i, 1.4), 12 * i) for i in range(3)]


def frames(folder, times=(None,) * 3):
    return [
        traced_frame(folder, SCENE, CAMERA, pose, key=f"cam-{i}", time_ns=time_ns)
        for i, (pose, time_ns) in enumerate(zip(POSES, times, strict=True))
    ]


def expected(first, second, **options):
    one = first.layer("depth")
    two = second.layer("depth")
    labels = first.layer("labels")
    return truth.flow(one, CAMERA.unproject(), first.pose, CAMERA, second.pose, two, labels, **options)


def test_both_readers_get_the_flow_between_neighbours(tmp_path):
    one, two, three = frames(tmp_path)
    written = get("flow").export([three, one, two], tmp_path, {"backward": True, "scene": True})
    names = ["cam-0", "cam-1.backward", "cam-1", "cam-2.backward"]
    files = [f"{name}.{suffix}" for name in names for suffix in ("flo", "exr", "sceneflow.exr")]
    assert [path.name for path in written] == [*files, "flow.json"]
    targets = dict(zip(names, ["cam-1", "cam-0", "cam-2", "cam-1"], strict=True))
    assert json.loads((tmp_path / "flow/flow.json").read_text())["to"] == targets
    for name, pair in zip(names, [(one, two), (two, one), (two, three), (three, two)], strict=True):
        wanted = expected(*pair)
        pixels = wanted.pixels.astype(np.float32)
        read = cv2.readOpticalFlow(str(tmp_path / f"flow/{name}.flo"))
        np.testing.assert_array_equal(read, np.where(np.isnan(pixels), np.float32(1e10), pixels))
        found = channels(tmp_path / f"flow/{name}.exr")
        assert {each.dtype for each in found.values()} == {np.dtype(np.float32)}
        np.testing.assert_array_equal(found["flow.X"], pixels[..., 0])
        np.testing.assert_array_equal(found["flow.Y"], pixels[..., 1])
        np.testing.assert_array_equal(found["mask"], wanted.mask)
        moved = channels(tmp_path / f"flow/{name}.sceneflow.exr")
        for i, axis in enumerate("XYZ"):
            np.testing.assert_array_equal(moved[f"sceneflow.{axis}"], wanted.scene[..., i].astype(np.float32))


def targets(frames, out, **options):
    """The frame that each one's flow leads to."""
    get("flow").export(frames, out, options)
    return json.loads((out / "flow/flow.json").read_text())["to"]


def test_frames_pair_by_time_and_gap_within_a_scene(tmp_path):
    assert targets(frames(tmp_path, times=(2, 1, 3)), tmp_path) == {"cam-1": "cam-0", "cam-0": "cam-2"}
    one, two, three = frames(tmp_path)
    assert targets([one, two, three], tmp_path, gap=2) == {"cam-0": "cam-2"}
    assert targets([one, two, three], tmp_path, gap=3) == {}
    assert targets([one, two, replace(three, scene="another")], tmp_path) == {"cam-0": "cam-1"}


def placed(frame, poses):
    path = frame.files["depth"].with_name(f"{frame.key}.truth.json")
    path.write_text(json.dumps({"poses": {name: pose.to_dict() for name, pose in poses.items()}}))
    return replace(frame, files={**frame.files, "truth": path})


def test_objects_move_by_their_recorded_poses(tmp_path):
    """One is turned and moved, another one has a pose in the first frame only."""
    label = SCENE.label("Chair_1")
    lost = SCENE.label("Ball")
    before = Pose.from_angles((1, 2, 0), 10)
    after = Pose.from_angles((1.1, 1.8, 0.1), 35)
    recorded = [{"Chair_1": before, "Ball": before}, {"Chair_1": after}]
    pair = []
    for i, poses in enumerate(recorded):
        frame = traced_frame(tmp_path, SCENE, CAMERA, POSES[i], key=f"cam-{i}")
        pair.append(replace(placed(frame, poses), scene=f"moment {i}"))
    get("flow").export(pair, tmp_path, {"scene": True})
    T = [np.vstack([np.column_stack([p.rotation, p.position]), [0, 0, 0, 1]]) for p in (before, after)]
    motion = T[1] @ np.linalg.inv(T[0])
    frame = pair[0]
    mine = pair[0].layer("labels") == label
    rays = CAMERA.unproject()
    points_w = frame.pose.to_world(frame.layer("depth")[..., None] * rays.directions)[mine]
    moved = points_w @ motion[:3, :3].T + motion[:3, 3]
    found = channels(tmp_path / "flow/cam-0.sceneflow.exr")
    scene = np.stack([found[f"sceneflow.{axis}"] for axis in "XYZ"], axis=-1)
    np.testing.assert_allclose(scene[mine], moved - points_w, atol=1e-6)
    flow = channels(tmp_path / "flow/cam-0.exr")
    target, _ = CAMERA.project(POSES[1].to_camera(moved))
    off = target - CAMERA.pixels()[mine] - np.stack([flow["flow.X"], flow["flow.Y"]], axis=-1)[mine]
    np.testing.assert_allclose(off - 64 * np.rint(off / 64), 0, atol=1e-3)
    assert mine.sum() > 5
    others = frame.layer("labels") == lost
    assert others.any()
    assert (flow["mask"][others] == 0).all()
    assert not scene[~mine & ~others].any()


def test_objects_that_move_during_readout_have_no_flow(tmp_path):
    """The pose of an object is that of the first line; one that rests is seen by all lines where it is."""
    base = cameras.create("pinhole", width=40, height=30, fov_deg=100)
    camera = cameras.create("rolling-shutter", width=40, height=30, base=base, readout=0.03)
    looking = Pose.from_angles((0, 0, 1.4), 20)
    poses = [{"Chair_1": Pose.from_angles((x, 2, 0)), "Ball": Pose.from_angles((1, 1, 0))} for x in (1, 1.1)]
    pair = []
    for i, known in enumerate(poses):
        labels = np.zeros((30, 40), np.uint16)
        labels[:, :20], labels[:, 20:] = (SCENE.label(name) for name in known)
        layers = {"depth": np.full((30, 40), 2, np.float32), "labels": labels}
        pair.append(placed(frame_of(tmp_path, layers, camera, looking, key=f"cam-{i}", scene=SCENE), known))
    get("flow").export(pair, tmp_path, {})
    mask = channels(tmp_path / "flow/cam-0.exr")["mask"]
    assert (mask[:, :20] == 0).all()
    assert (mask[:, 20:] == 1).all()


def test_unsure_pixels_have_no_flow(tmp_path):
    unsure = np.zeros((32, 64), bool)
    unsure[5:9] = True
    layers = {"depth": np.full((32, 64), 2, np.float32), "unsure": unsure}
    targets([frame_of(tmp_path, layers, CAMERA, POSES[0], key=f"cam-{i}") for i in (0, 1)], tmp_path)
    np.testing.assert_array_equal(channels(tmp_path / "flow/cam-0.exr")["mask"] == 0, unsure)


def known_flow(*values):
    pixels = np.array([[(value, 0.0) for value in values]])
    return Flow(pixels, np.uint8(~np.isnan(pixels[..., 0])), np.zeros((1, len(values), 3)))


def test_codes_of_kitti_and_what_they_cannot_hold(tmp_path):
    codes = kitti_codes(known_flow(-512, -511.984375, 0, 1.5, 511.984375, np.nan))
    assert codes[0, :, 0].tolist() == [0, 1, 32768, 32864, 65535, 0]
    assert codes[0, :, 2].tolist() == [1, 1, 1, 1, 1, 0]
    for beyond in (-512.1, 512.0):
        with pytest.raises(ArgumentError, match="kitti: expected flow within"):
            kitti_codes(known_flow(0, beyond))
    wide = cameras.create("equirectangular", width=1040, height=2)
    poses = (Pose.from_angles((0, 0, 0), yaw) for yaw in (0, 5))
    depth = np.full((2, 1040), 2, np.float32)
    pair = [frame_of(tmp_path, {"depth": depth}, wide, pose, key=f"cam-{i}") for i, pose in enumerate(poses)]
    with pytest.raises(ArgumentError, match=r"cam-0: kitti: expected flow within -512 to 511.98 px"):
        get("flow").export(pair, tmp_path, {"kitti": True, "wrap": "classic"})
    get("flow").export(pair, tmp_path, {"kitti": True})
    read = cv2.imread(str(tmp_path / "flow/cam-0.png"), cv2.IMREAD_UNCHANGED)[..., ::-1].astype(float)
    assert (read[..., 2] == 1).all()
    exact = channels(tmp_path / "flow/cam-0.exr")
    np.testing.assert_allclose((read[..., 0] - 2**15) / 64, exact["flow.X"], atol=1 / 128 + 1e-4)


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


def test_frames_have_the_poses_of_all_that_moves(made, tmp_path):
    """Without them there is no flow, rather than that of a world that stands still."""
    frames = dataset.open(made / "moving")
    assert len({frame.state for frame in frames} - {""}) == 3
    for time, frame in zip(TIMES, frames, strict=True):
        assert set(frame.truth["poses"]) == {*WORKSHOP.moving, "Cabinet"}
        for name, pose in frame.truth["poses"].items():
            R_w_o, place = world(time).pose(name)
            np.testing.assert_allclose(pose["position"], place, atol=1e-9)
            np.testing.assert_allclose(pose["rotation"], R_w_o, atol=1e-9)
    assert dataset.check(made / "moving", deep=True) == []
    assert targets(frames, tmp_path / "all") != {}
    bare = [{kind: path for kind, path in frame.files.items() if kind != "truth"} for frame in frames]
    frames = [replace(frame, files=files) for frame, files in zip(frames, bare, strict=True)]
    assert targets(frames, tmp_path / "none") == {}


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
            center_w = frame.pose.to_world(box["center_camera"])
            np.testing.assert_allclose(center_w, box["center_world"], atol=1e-9)
        turn = np.array(boxes["Cabinet"]["R_world_box"])
        np.testing.assert_allclose(np.abs(turn), np.abs(turned(40 * time)), atol=1e-9)


def test_frames_of_another_motion_are_refused(made, tmp_path):
    """Of an object that goes elsewhere after the first frame."""
    job = load(made / "job.yaml")
    shutil.copytree(made / "moving", tmp_path / "other")
    first, last = job.motions["Cabinet"].waypoints
    other = Motion(Trajectory.timed((first, replace(last, position=last.position + 0.1)), (0.0, 1.0)))
    with pytest.raises(ArgumentError, match="its frame pano-1 has state"):
        make(replace(job, out=tmp_path / "other", motions={"Cabinet": other}), existing="resume")
