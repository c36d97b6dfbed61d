"""OpenCV's fisheye files and arrays, judged by OpenCV: its projection and its FileStorage."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from support.lenses import lenses, seen_in_front
from support.same_rays import assert_same_rays

from omniscv import calibration, cameras
from omniscv.errors import ArgumentError

SIZE = {"width": 64, "height": 48}
LENS = cameras.create(
    "kannala-brandt", **SIZE, fx=30.0, fy=31.5, cx=33.25, cy=22.0, k=[0.1, -0.02, 0.003, 1e-5]
)


@given(lenses)
def test_opencv_projects_our_rays_to_our_pixels_less_half(camera: cameras.Camera) -> None:
    K, D = calibration.to_opencv_fisheye(camera)
    pixels, directions = seen_in_front(camera)
    if len(pixels) == 0:
        return
    theirs, _ = cv2.fisheye.projectPoints(directions[:, None], np.zeros(3), np.zeros(3), K, D)
    # The ray's angle is found to a few 1e-16, times at most 1000 px, and steep by up to 1 / cos(80 deg)^2.
    np.testing.assert_allclose(theirs[:, 0], pixels - 0.5, rtol=0, atol=1e-9)


@given(lenses)
def test_arrays_make_the_camera_again(camera: cameras.Camera) -> None:
    K, D = calibration.to_opencv_fisheye(camera)
    assert_same_rays(camera, calibration.from_opencv_fisheye(K, D[:, None], 64, 48))


def test_the_middle_of_an_image_is_half_a_pixel_less_in_opencv() -> None:
    """640 columns number 0 to 639, so their middle is 319.5, where ours is 320."""
    K, _ = calibration.to_opencv_fisheye(
        cameras.create("kannala-brandt", width=640, height=480, fx=1.0, fy=1.0)
    )
    assert K[:2, 2].tolist() == [319.5, 239.5]


@given(lenses)
def test_a_file_makes_the_camera_again(camera: cameras.Camera) -> None:
    text = calibration.write_opencv_fisheye({"cam0": camera})
    assert_same_rays(camera, calibration.read_opencv_fisheye(text)["cam0"])


def test_opencv_reads_the_file(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    calibration.save(path, {"cam0": LENS}, "opencv-fisheye")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    K, D = calibration.to_opencv_fisheye(LENS)
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), K)
    np.testing.assert_array_equal(storage.getNode("distortion_coefficients").mat(), D[:, None])
    assert storage.getNode("image_width").real() == 64
    assert storage.getNode("image_height").real() == 48


@pytest.mark.parametrize("suffix", ["yml", "json"])
def test_a_file_of_opencvs_is_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"camera.{suffix}"
    K, D = calibration.to_opencv_fisheye(LENS)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (("image_width", 64), ("image_height", 48), ("fisheye_model", 1)):
        storage.write(key, value)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", D)
    storage.release()
    assert_same_rays(calibration.load(path)["cam0"], LENS)


def test_the_plain_model_is_told_from_the_fisheye(tmp_path: Path) -> None:
    """Four coefficients are k1, k2, p1, p2 in the one file and k1 to k4 in the other, under the same keys."""
    text = calibration.write_opencv_fisheye({"cam0": LENS})
    with pytest.raises(ArgumentError, match="fisheye_model: expected 1"):
        calibration.read_opencv_fisheye(text.replace("fisheye_model: 1", "fisheye_model: 0"))
    path = tmp_path / "camera.yml"
    path.write_text(text.replace("fisheye_model: 1\n", ""), encoding="utf-8")
    with pytest.raises(ArgumentError, match="give format"):
        calibration.load(path)
    assert_same_rays(calibration.load(path, "opencv-fisheye")["cam0"], LENS)


@pytest.mark.parametrize(
    ("K", "D"),
    [
        ([[30, 0.1, 3], [0, 30, 2], [0, 0, 1]], [0, 0, 0, 0]),
        ([[30, 0, 3], [0, 30, 2], [0, 0, 2]], [0, 0, 0, 0]),
        ([[30, 0, 3], [0, 0, 2], [0, 0, 1]], [0, 0, 0, 0]),
        ([[30, 0, np.nan], [0, 30, 2], [0, 0, 1]], [0, 0, 0, 0]),
        (np.eye(4), [0, 0, 0, 0]),
        ([[30, 0, 3], [0, 30], [0, 0, 1]], [0, 0, 0, 0]),
        (np.eye(3), [0, 0, 0, 0, 0]),
        (np.eye(3), "abcd"),
        (np.eye(3), [[0, 0], [0, 0]]),
    ],
)
def test_arrays_that_are_no_fisheye_are_refused(K: object, D: object) -> None:
    with pytest.raises(ArgumentError, match=r"^(K|D|fy): expected"):
        calibration.from_opencv_fisheye(K, D, 64, 48)  # type: ignore[arg-type]
