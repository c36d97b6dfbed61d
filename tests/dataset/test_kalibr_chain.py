"""Kalibr's chain of a dataset's rig, by 20 lines of a reader of its conventions and by our own."""

import numpy as np
import pytest
import yaml
from support.traced_frames import black_frame

from omniscv import Pose, cameras
from omniscv.calibration.kalibr import read_kalibr
from omniscv.dataset import get

CAMERAS = {
    "left": cameras.create("pinhole", width=32, height=24, fov_deg=80, center=(15, 13)),
    "right": cameras.create(
        "kannala-brandt", width=48, height=40, fx=15.0, fy=14.0, k=[0.02, -0.008, 0.002, 0]
    ),
    "rear": cameras.create("fisheye-equidistant", width=40, height=40, fov_deg=160),
}
PLACES = [
    Pose.from_angles((0, 0, 0)),
    Pose.from_angles((0, -0.1, 0), -20, 3),
    Pose.from_angles((-0.2, 0, 0), 180),
]
MOVES = [Pose.from_angles((i, 2 * i, 1), 40 * i, 10 * i, 3 * i) for i in range(2)]


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kalibr")
    level = Pose.from_angles((0, 0, 0)).inverse()
    return [
        black_frame(folder, camera, move @ (level @ place), name, f"{name}-{i}")
        for i, move in enumerate(MOVES)
        for (name, camera), place in zip(CAMERAS.items(), PLACES, strict=True)
    ]  # fmt: skip


def w2c(pose):
    return np.vstack([np.column_stack([pose.rotation.T, -pose.rotation.T @ pose.position]), [0, 0, 0, 1]])


def test_the_chain_leads_to_the_poses_of_every_camera(frames, tmp_path):
    (path,) = get("kalibr").export(frames, tmp_path, {})
    assert path.name == "camchain.yaml"
    chain = yaml.safe_load(path.read_text())
    names = [entry["rostopic"].removeprefix("/") for entry in chain.values()]
    assert names == ["left", "rear", "right"]
    assert list(chain) == ["cam0", "cam1", "cam2"]
    assert "T_cn_cnm1" not in chain["cam0"]
    by_key = {frame.key: frame for frame in frames}
    for moment in range(2):
        T = w2c(by_key[f"left-{moment}"].pose)
        for name, entry in zip(names, chain.values(), strict=True):
            T = np.array(entry.get("T_cn_cnm1", np.eye(4))) @ T
            frame = by_key[f"{name}-{moment}"]
            np.testing.assert_allclose(T, w2c(frame.pose), atol=1e-9)
            assert entry["resolution"] == [frame.camera.width, frame.camera.height]
    assert [entry["cam_overlaps"] for entry in chain.values()] == [[2], [2], [0, 1]]
    assert list(read_kalibr(path.read_text())) == ["cam0", "cam1", "cam2"]
