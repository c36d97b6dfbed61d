"""COLMAP's cameras.txt, judged by pycolmap."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from support.lenses import seen_in_front
from support.same_rays import assert_same_rays

from omniscv import calibration, cameras
from omniscv.calibration import colmap
from omniscv.errors import ArgumentError

TEXT = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 5
3 PINHOLE 64 48 50 50 32 24
1 PINHOLE 64 48 50 52.5 31 23.5
7 SIMPLE_PINHOLE 64 48 50 32 24

4 OPENCV_FISHEYE 64 48 30.0 31.5 33.25 22 0.1 -0.02 0.003 1e-05
12 EQUIRECTANGULAR 64 32 64 32
"""


def test_every_line_is_a_camera_named_by_its_id() -> None:
    read = calibration.loads(TEXT, "colmap")
    models = {"3": "pinhole", "1": "pinhole", "7": "pinhole", "4": "kannala-brandt", "12": "equirectangular"}
    assert {name: camera.name for name, camera in read.items()} == models
    assert read["7"] == read["3"]
    again = calibration.loads(calibration.dumps(read, "colmap"), "colmap")
    assert list(again.items()) == list(read.items())  # nothing is shifted, so nothing is lost


IMAGE = "64 48"
PARAMS = {
    "SIMPLE_PINHOLE": "50 32 24",
    "PINHOLE": "50 52 31 23",
    "SIMPLE_RADIAL": "50 32 24 -0.1",
    "RADIAL": "50 32 24 -0.1 0.02",
    "OPENCV": "50 52 31 23 -0.1 0.02 0.003 -0.002",
    "FULL_OPENCV": "50 52 31 23 -0.1 0.02 0.003 -0.002 0.01 0.05 0.01 -0.02",
    "SIMPLE_FISHEYE": "30 32 24",
    "FISHEYE": "30 31 32 24",
    "SIMPLE_RADIAL_FISHEYE": "30 32 24 0.02",
    "RADIAL_FISHEYE": "30 32 24 0.02 -0.01",
    "OPENCV_FISHEYE": "30 31.5 33.25 22 0.1 -0.02 0.003 1e-05",
    "RAD_TAN_THIN_PRISM_FISHEYE": "30 31 32 24 0.02 -0.01 0 0.001 0 0 1e-3 -2e-3 1e-4 0 2e-4 -1e-4",
    "SIMPLE_DIVISION": "40 32 24 -0.2",
    "DIVISION": "40 40 32 24 -0.2",
    "EUCM": "30 31 32 24 0.6 1.1",
    "FOV": "30 31 32 24 0.9",
}


@pytest.mark.parametrize("model", PARAMS)
def test_projections_are_those_of_pycolmap(model: str) -> None:
    """Up to 80 degrees off the axis: COLMAP refuses what lies beyond 90."""
    camera = calibration.loads(f"1 {model} {IMAGE} {PARAMS[model]}", "colmap")["1"]
    params = list(map(float, PARAMS[model].split()))
    theirs = pycolmap.Camera(model=model, width=64, height=48, params=params)
    pixels, directions = seen_in_front(camera)
    assert len(pixels) > 1500
    projected = theirs.img_from_cam(directions)
    np.testing.assert_allclose(projected, pixels, rtol=0, atol=1e-9)
    again = calibration.dumps({"1": camera}, "colmap")
    assert_same_rays(camera, calibration.loads(again, "colmap")["1"])


def test_every_model_of_the_table_is_tested_and_has_colmaps_id(tmp_path: Path) -> None:
    known = [model.words[0] for model in colmap.COLMAP.layout.models]
    assert {*PARAMS, "EQUIRECTANGULAR"} == set(known)
    assert [name for name in colmap.NAMES if name in known] == known
    scene = pycolmap.Reconstruction()
    lines = []
    for i, (model, words) in enumerate(PARAMS.items(), start=1):
        params = list(map(float, words.split()))
        scene.add_camera(pycolmap.Camera(model=model, width=64, height=48, params=params, camera_id=i))
        lines.append(f"{i} {model} {IMAGE} {words}")
    scene.write_binary(str(tmp_path))
    assert calibration.load(tmp_path / "cameras.bin") == calibration.loads("\n".join(lines))
    with pytest.raises(ArgumentError, match=r"COLMAP's cameras.bin, got other bytes"):
        calibration.loads((tmp_path / "cameras.bin").read_bytes()[:-1])


def test_lenses_wider_than_colmap_reads_get_a_comment() -> None:
    wide = cameras.create("extended-unified", width=64, height=64, fx=15.0, fy=15.0, alpha=0.6, beta=1.1)
    text = calibration.dumps({"3": wide}, "colmap")
    assert "# 3: COLMAP uses only the rays less than 90 degrees off the axis." in text.splitlines()
    assert_same_rays(wide, calibration.loads(text, "colmap")["3"])
    narrow = cameras.from_dict({**wide.to_dict(), "fx": 60.0, "fy": 60.0})
    assert "90 degrees" not in calibration.dumps({"3": narrow}, "colmap")
