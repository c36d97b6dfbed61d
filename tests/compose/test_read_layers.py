"""Layers read back from their files are those that were in memory, to the bit."""

import numpy as np
import pytest

import omniscv
from omniscv.compose.files import read
from omniscv.errors import ArgumentError

MODES = ("lit", "object_mask", "depth", "normals")


@pytest.mark.parametrize("image_format", ["png", "jxl"])
def test_layers_read_back_are_those_in_memory(tmp_path, image_format):
    camera = omniscv.cameras.create("fisheye-equidistant", width=40, height=30, fov_deg=150)
    pose = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=20)
    with omniscv.open_source("scene://four-wall") as source:
        image = omniscv.render(camera, pose, source, MODES)
    image.save(tmp_path, "a", image_format)
    for name, layer in image.layers.items():
        (path,) = (each for each in tmp_path.glob(f"a.{name}.*"))
        again = read(path, name)
        assert again.dtype == layer.dtype
        np.testing.assert_array_equal(again, layer)
    with pytest.raises(ArgumentError, match="expected float32 pixels of depth"):
        read(tmp_path / "a.object_mask.png", "depth")
    with pytest.raises(ArgumentError, match="expected a picture of depth"):
        read(tmp_path / "nothing.exr", "depth")
