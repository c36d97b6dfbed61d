"""OpenCV's fisheye files and arrays, judged by OpenCV: its projection and its FileStorage."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases
from support.lenses import lenses, seen_in_front
from support.same_rays import assert_same_rays

from omniscv import calibration, cameras
from omniscv.errors import ArgumentError

SIZE = {"width": 64, "height": 48}
LENS = cameras.create(
    "kannala-brandt", **SIZE, fx=30.0, fy=31.5, cx=33.25, cy=22.0, k=[0.1, -0.02, 0.003, 1e-5]
)


@cases(15)
@given(lenses, st.just(0.0) | st.floats(-0.1, 0.1))
def test_opencv_projects_our_rays_to_our_pixels_less_half(camera: cameras.Camera, skew: float) -> None:
    skewed = cameras.from_dict({**camera.to_dict(), "skew": skew})
    K, D = calibration.to_opencv_fisheye(skewed)
    pixels, directions = seen_in_front(skewed)
    if len(pixels) == 0:
        return
    alpha = float(K[0, 1] / K[0, 0])  # OpenCV's word for skew
    upright = np.array([[K[0, 0], 0, K[0, 2]], K[1], K[2]])
    still = np.zeros(3)
    theirs, _ = cv2.fisheye.projectPoints(directions[:, None], still, still, upright, D, alpha=alpha)
    # The ray's angle is found to a few 1e-16, times at most 1000 px, and steep by up to 1 / cos(80 deg)^2.
    np.testing.assert_allclose(theirs[:, 0], pixels - 0.5, rtol=0, atol=1e-9)
    assert_same_rays(skewed, calibration.from_opencv_fisheye(K, D, 64, 48))


terms = st.lists(st.integers(-20, 20).map(lambda n: n / 1000), min_size=12, max_size=12)


@cases(15)
@given(st.sampled_from([4, 5, 8, 12]), terms, st.floats(30, 60), st.floats(30, 60))
def test_the_plain_model_is_opencvs(count: int, terms: list[float], fx: float, fy: float) -> None:
    K = np.array([[fx, 0, 30.25], [0, fy, 22.5], [0, 0, 1]])
    D = np.array(terms[:count])
    camera = calibration.from_opencv(K, D, 64, 48)
    rays = camera.unproject()
    seen = rays.directions[rays.valid]
    assert len(seen) > 1000
    theirs, _ = cv2.projectPoints(seen[:, None], np.zeros(3), np.zeros(3), K, D)
    np.testing.assert_allclose(theirs[:, 0], camera.pixels()[rays.valid] - 0.5, rtol=0, atol=1e-9)
    text = calibration.dumps({"cam0": camera}, "opencv")
    assert_same_rays(camera, calibration.loads(text, "opencv")["cam0"])


def omnidir(K: Any, xi: float, D: Any, points: np.ndarray) -> np.ndarray:
    """cv::omnidir::projectPoints as opencv_contrib's manual defines it (its module is in no wheel): the plain
    model, of points of the unit sphere seen from (0, 0, -xi)."""
    seen = points / np.linalg.norm(points, axis=-1, keepdims=True) + (0, 0, xi)
    plane = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), np.eye(3), np.array(D))[0][:, 0]
    return (np.array(K) @ np.column_stack([plane, np.ones(len(plane))]).T)[:2].T


@cases(15)
@given(st.floats(0.2, 1.5), terms, st.floats(-0.1, 0.1))
def test_omnidir_is_ccalibs(xi: float, every: list[float], skew: float) -> None:
    D = every[:4]
    K = np.array([[40, 40 * skew, 30.25], [0, 42, 22.5], [0, 0, 1]])
    camera = calibration.from_opencv_omnidir(K, xi, D, 64, 48)
    rays = camera.unproject()
    seen = rays.directions[rays.valid]
    assert len(seen) > 500
    theirs = omnidir(K, xi, D, seen)
    np.testing.assert_allclose(theirs, camera.pixels()[rays.valid] - 0.5, rtol=0, atol=1e-8)
    again = calibration.to_opencv_omnidir(camera)
    for mine, given_ in zip(again, (K, xi, D), strict=True):
        np.testing.assert_allclose(mine, given_, rtol=1e-15, atol=1e-15)


CAMERAS = {
    "opencv": cameras.create(
        "pinhole", **SIZE, fx=40.0, fy=41.0, cx=31.0, cy=25.0, distortion=(0.1, -0.02, 1e-3, 0, 0.01)
    ),
    "opencv-fisheye": LENS,
    "opencv-omnidir": cameras.create("unified", **SIZE, fx=40.0, fy=41.0, xi=0.9, skew=0.01),
}


@pytest.mark.parametrize("format", CAMERAS)
@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_every_form_is_read_by_opencv_and_by_us(format: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"camera.{suffix}"
    calibration.save(path, {"cam0": CAMERAS[format]}, format)  # type: ignore[arg-type]
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.getNode("camera_matrix").mat().shape == (3, 3)
    assert storage.getNode("image_width").real() == 64
    assert_same_rays(calibration.load(path)["cam0"], CAMERAS[format])


def test_arrays_that_the_models_cannot_hold_are_refused() -> None:
    K = np.array([[30, 0, 3], [0, 30, 2], [0, 0, 1.0]])
    assert calibration.from_opencv(K, np.zeros(14), 8, 6) == calibration.from_opencv(K, np.zeros(4), 8, 6)
    with pytest.raises(ArgumentError, match="distortion_coefficients: expected 0"):
        calibration.from_opencv(K, [*[0.0] * 12, 0.1, 0], 8, 6)
    K[0, 1] = 0.1
    with pytest.raises(ArgumentError, match="camera_matrix: expected 0"):
        calibration.from_opencv(K, np.zeros(4), 8, 6)
    for wrong, D, name in (
        ([[30, 0, 3], [0.1, 30, 2], [0, 0, 1]], [0.0] * 4, "camera_matrix"),
        ([[0, 0, 3], [0, 30, 2], [0, 0, 1]], [0.0] * 4, "fx"),
        ([[30, 0, 3], [0, 30, 2], [0, 0, 2]], [0.0] * 4, "camera_matrix"),
        ([[30, 0, np.nan], [0, 30, 2], [0, 0, 1]], [0.0] * 4, "K"),
        ([[30, 0, 3], [0, 30], [0, 0, 1]], [0.0] * 4, "K"),
        (np.eye(3), [0.0, 0, 0, 0, 1], "distortion_coefficients"),
        (np.eye(3), "abcd", "distortion_coefficients"),
    ):
        with pytest.raises(ArgumentError, match=f"^{name}: expected"):
            calibration.from_opencv_fisheye(wrong, D, 64, 48)  # type: ignore[arg-type]
