"""A job's dataset in all formats of geometry at once: poses, cameras, depth, points, flow."""

import numpy as np
import pytest
from plyfile import PlyData
from support.datasets import made

from omniscv import dataset

EXPORTS = """
truth: {poses: true, flow: {backward: true}, tolerance: {abs_m: 0.03}}
export:
  - {format: ply, voxel: 0.1, max_relative_error: 0.001}
  - {format: depth-png, scale: stanford2d3d}
  - normals_png
  - poses
  - {format: colmap, points: 0.2}
  - nerfstudio
"""


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    return made(tmp_path_factory.mktemp("job"), more=EXPORTS) / "exports"


def test_made_again_they_are_the_same_bytes(exports):
    assert dataset.check(exports.parent, deep=True) == []


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
