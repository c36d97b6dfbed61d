"""A job's dataset in all formats of geometry at once: poses, cameras, depth, points, flow."""

import numpy as np
import pytest
from plyfile import PlyData
from support.datasets import made

from omniscv import calibration, dataset
from omniscv.geometry.trajectory_files import read_trajectory

EXPORTS = """
truth: {poses: true, flow: {backward: true}, tolerance: {abs_m: 0.03}}
export:
  - {format: ply, voxel: 0.1, max_relative_error: 0.001}
  - {format: depth-png, scale: stanford2d3d}
  - normals_png
  - poses
  - {format: kalibr, cameras: [lens]}
  - {format: colmap, points: 0.2}
  - nerfstudio
"""


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    return made(tmp_path_factory.mktemp("job"), more=EXPORTS) / "exports"


def test_made_again_they_are_the_same_bytes(exports):
    assert dataset.check(exports.parent, deep=True) == []


def test_each_camera_has_a_trajectory_in_the_order_of_times(exports):
    """Of these files' forms ``tests/geometry`` and ``tests/rigs`` tell."""
    frames = [frame for frame in dataset.open(exports.parent) if frame.camera_name == "lens"]
    for kind in ("tum", "euroc", "kitti"):
        read = read_trajectory(exports / f"poses/lens.{kind}", first=frames[0].pose)
        assert read.times == pytest.approx([0, 0.5, 1])
        for pose, frame in zip(read, frames, strict=True):
            np.testing.assert_allclose(pose.position, frame.pose.position, atol=1e-12)
            np.testing.assert_allclose(pose.rotation, frame.pose.rotation, atol=1e-12)
    assert (exports / "poses/lens.keys").read_text().split() == [frame.key for frame in frames]
    chain = calibration.load(exports / "kalibr/camchain.yaml")
    ray = frames[0].camera.unproject([10.0, 20.0]).directions
    np.testing.assert_allclose(chain["cam0"].project(ray)[0], [10, 20], atol=1e-9)


def test_the_cloud_has_classes_and_their_names(exports):
    read = PlyData.read(exports / "ply/cloud.ply")
    vertex = read["vertex"].data
    label_of = {each.split()[2]: int(each.split()[1]) for each in read.comments if each.startswith("label")}
    floor = vertex[vertex["label"] == label_of["Layout_Floor"]]
    assert len(floor) > 50
    np.testing.assert_allclose(floor["z"], 0, atol=0.002)
    np.testing.assert_allclose(floor["nz"], 1, atol=1e-3)
    (floor_class,) = np.unique(floor["class"])
    assert f"class {floor_class} floor" in read.comments
