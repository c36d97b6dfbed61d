"""Layers read back from their files are those that were in memory, to the bit; bounds are rounded up."""

import json

import numpy as np
import pytest

import omniscv
from omniscv.compose import files
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
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["blank"] == ["unsure"]
    assert not image.unsure.any()
    for name in image.layers.keys() - {"unsure"}:
        (path,) = (each for each in tmp_path.glob(f"a.{name}.*"))
        again, layer = read(path, name), image[name]
        assert again.dtype == layer.dtype
        if name == "depth_error":
            assert (again >= layer).all()
            np.testing.assert_array_equal(again, as_half_floats(layer))
        else:
            np.testing.assert_array_equal(again, layer)
    with pytest.raises(ArgumentError, match="expected float32 pixels of depth"):
        read(tmp_path / "a.object_mask.png", "depth")
    with pytest.raises(ArgumentError, match="expected a picture of depth"):
        read(tmp_path / "nothing.exr", "depth")


def as_half_floats(bounds):
    """The least half floats of 7 binary digits that are not less, found among all of them."""
    halves = np.arange(0, 0x7C01, 16, dtype=np.uint16).view(np.float16).astype(np.float64)  # 0 to +inf
    return halves[np.searchsorted(halves, bounds.astype(np.float64))]


def test_bounds_are_rounded_up_to_half_floats(tmp_path):
    """Also below their least normal number, 6.1e-5 m, and beyond their largest, 65504 m."""
    spread = 2.0 ** np.random.default_rng(4).uniform(-30, 20, 5000)
    ends = [0, 1e-45, 6e-8, 6.1e-5, 1 / 3, 1, 65504, 65505, 65519, 65520, 3e38, np.inf]
    bounds = np.array([*spread, *ends], np.float32)[None]
    files.write({"depth_error": bounds}, {}, None, tmp_path, "a")
    np.testing.assert_array_equal(read(tmp_path / "a.depth_error.exr", "depth_error"), as_half_floats(bounds))
