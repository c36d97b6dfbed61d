"""Depth and normals as 16-bit PNG, as OpenCV and Pillow read them."""

import json

import cv2
import numpy as np
import pytest
from PIL import Image
from support.traced_frames import frame_of

from omniscv import Pose, cameras
from omniscv.dataset import get
from omniscv.dataset.formats.numbers import PRESETS
from omniscv.errors import ArgumentError

POSE = Pose.from_angles((0, 0, 1))
PINHOLE = cameras.create("pinhole", width=4, height=1, focal=1e6)
"""So long a lens that depth along its rays is planar."""
PANORAMA = cameras.create("equirectangular", width=32, height=16)


def export(tmp_path, depth, camera, **options):
    frame = frame_of(tmp_path, {"depth": np.asarray(depth, np.float32)}, camera, POSE)
    path, meaning = get("depth_png").export([frame], tmp_path, options)
    return path, json.loads(meaning.read_text())


@pytest.mark.parametrize(
    ("scale", "codes"),
    [
        ("matterport", [4000, 10873, 0, 0]),
        ("stanford2d3d", [512, 1392, 40960, 65535]),
        ("mm", [1000, 2718, 0, 0]),
        ("kitti", [256, 696, 20480, 51200]),
        ("tum", [5000, 13591, 0, 0]),
        ("tof360", [512, 1392, 40960, 0]),
    ],
)
def test_known_answers(scale, codes, tmp_path):
    """Both readers keep 16 bits; nothing is clamped."""
    path, meaning = export(tmp_path, [[1.0, 2.71828, 80, 200]], PINHOLE, scale=scale)
    read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert read.dtype == np.uint16
    assert read.tolist() == [codes]
    assert np.array(Image.open(path)).tolist() == [codes]
    beyond = sum(code == PRESETS[scale].none for code in codes)
    assert meaning["replaced"] == {"cam": {"beyond": beyond, "infinite": 0, "outside": 0}}
    assert meaning["kind"] == {"cam": "ray" if scale == "tof360" else "planar"}


@pytest.mark.parametrize("scale", ["mm", "tof360"])
def test_depth_along_the_ray_is_half_a_step_off_at_most(scale, tmp_path):
    draw = np.random.default_rng(2)
    depth = draw.uniform(0.1, 60, (16, 32)).astype(np.float32)
    depth[0, :3] = np.inf
    depth[1, :5] = 0
    path, meaning = export(tmp_path, depth, PANORAMA, scale=scale)
    preset = PRESETS[scale]
    read = np.array(Image.open(path)).astype(float)
    has = np.isfinite(depth) & (depth > 0)
    np.testing.assert_array_equal(read == preset.none, ~has)
    assert np.abs(read / preset.per_metre - depth)[has].max() <= 0.5 / preset.per_metre * (1 + 1e-9)
    assert meaning["replaced"]["cam"] == {"beyond": 0, "infinite": 3, "outside": 5}
    assert meaning["kind"] == {"cam": "ray"}


def test_planar_depth_is_measured_along_the_axis_and_shift_has_24_bits(tmp_path):
    """A wall straight ahead has one planar depth; SHIFT's own formula, on the channels that Pillow reads."""
    camera = cameras.create("pinhole", width=16, height=12, fov_deg=90)
    path, _ = export(tmp_path, 3 / camera.unproject().directions[..., 2], camera, scale="tum")
    assert (np.array(Image.open(path)) == 15000).all()
    path, _ = export(tmp_path, [[1.0, 2.71828, 900, 1001]], PINHOLE, scale="shift")
    c = np.array(Image.open(path)).astype(float)
    metres = (c[..., 2] * 65536 + c[..., 1] * 256 + c[..., 0]) / 2**24 * 1000
    np.testing.assert_allclose(metres[0, :3], [1.0, 2.71828, 900], atol=1000 / 2**25 + 4e-5)
    assert c[0, 3].tolist() == [255, 255, 255]


def test_planar_presets_are_refused_for_other_cameras(tmp_path):
    format = get("depth_png")
    for scale in ("matterport", "kitti", "tum", "shift"):
        with pytest.raises(ArgumentError, match="cam: scale: expected a preset of depth along the ray"):
            format.check_options(format.read_options({"scale": scale}), {"cam": PANORAMA})
    with pytest.raises(ArgumentError, match="scale: expected a preset"):
        export(tmp_path, np.ones((16, 32)), PANORAMA, scale="tum")
