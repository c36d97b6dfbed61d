"""Isaac Sim's attributes and NCore's f-theta cameras, judged by the formulas of their manuals."""

import json
import re
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyval
from support.cases import cases
from support.same_rays import assert_same_rays

from omniscv import calibration, cameras
from omniscv.errors import ArgumentError

SIZE = {"width": 64, "height": 48}
THETA = cameras.create(
    "ftheta", **SIZE, cx=31.0, cy=25.0, polynomial=(0, 0.03, 1e-5, 1e-6, 0), reference="pixel-to-angle"
)


def attributes(camera: cameras.Camera) -> dict[str, list[float]]:
    """The numbers of a layer by the last part of their names, by a parser that shares nothing with ours."""
    text = calibration.dumps({"cam0": camera}, "isaac")
    pairs = re.findall(r"omni:lensdistortion:\w+:(\w+) = \(?([^)\n]*)", text)
    return {name: [float(word) for word in words.split(",")] for name, words in pairs}


def test_isaacs_f_theta_gives_the_angle_of_a_pixels_distance() -> None:
    given_ = attributes(THETA)
    pixels = THETA.pixels().reshape(-1, 2)
    rays = THETA.unproject().directions.reshape(-1, 3)
    offset = pixels - 0.5 - given_["opticalCenter"]  # pixel centres at whole numbers
    angle = polyval(np.hypot(*offset.T), [given_[f"k{i}"][0] for i in range(5)])
    np.testing.assert_allclose(np.arctan2(np.hypot(*rays[:, :2].T), rays[:, 2]), angle, atol=1e-12)
    assert (given_["nominalWidth"], given_["nominalHeight"]) == ([64.0], [48.0])


@pytest.mark.parametrize("model", ["pinhole", "kannala-brandt"])
def test_isaacs_opencv_models_are_opencvs(model: str) -> None:
    terms: dict[str, Any] = {"distortion": (-0.05, 0.01, 1e-3, -2e-3, 0.01)}
    terms = terms if model == "pinhole" else {"k": (0.02, -0.01, 0.001, 0)}
    camera = cameras.create(model, **SIZE, fx=40.0, fy=41.0, cx=31.0, cy=25.0, **terms)
    given_ = {name: values[0] for name, values in attributes(camera).items()}
    K = np.array([[given_["fx"], 0, given_["cx"]], [0, given_["fy"], given_["cy"]], [0, 0, 1]])
    names = "k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4" if model == "pinhole" else "k1 k2 k3 k4"
    D = np.array([given_[name] for name in names.split()])
    project = cv2.projectPoints if model == "pinhole" else cv2.fisheye.projectPoints
    rays = camera.unproject()
    seen = rays.directions[rays.valid]
    pixels, _ = project(seen[:, None], np.zeros(3), np.zeros(3), K, D)
    np.testing.assert_allclose(pixels[:, 0], camera.pixels()[rays.valid] - 0.5, rtol=0, atol=1e-9)


terms = st.tuples(st.floats(20, 60), st.floats(-2, 2), st.floats(-1, 1))


@cases(15)
@given(terms, st.floats(0.9, 1.1), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_ncores_reference_gives_the_pixel(c: tuple[float, ...], a: float, d: float, e: float) -> None:
    lens = {"polynomial": (0.0, *c), "linear": (a, d, e), "max_angle_deg": 80}
    camera = cameras.create("ftheta", **SIZE, cx=31.0, cy=25.0, **lens)
    text = calibration.dumps({"cam0": camera}, "ncore")
    given_ = json.loads(text)["camera_model_parameters"]
    rays = camera.unproject()
    x, y, z = rays.directions[rays.valid].T
    rho = np.hypot(x, y)
    distance = polyval(np.arctan2(rho, z), given_["angle_to_pixeldist_poly"])
    c_, d_, e_ = given_["linear_cde"]
    scaled = distance / np.where(rho > 0, rho, 1) * np.stack([x, y])
    theirs = (np.array([[c_, d_], [e_, 1]]) @ scaled).T + given_["principal_point"]
    np.testing.assert_allclose(theirs, camera.pixels()[rays.valid] - 0.5, rtol=0, atol=1e-9)
    assert np.degrees(given_["max_angle"]) == pytest.approx(80)
    for read in (text, json.dumps(given_)):  # with or without their wrapping
        assert_same_rays(camera, calibration.loads(read, "ncore")["cam0"])


@pytest.mark.parametrize("camera", [THETA, cameras.model("ftheta").example(64)], ids=["back", "forth"])
def test_the_other_polynomial_is_near_the_inverse(camera: cameras.Camera) -> None:
    """What programs use that read both: within a tenth of a pixel over the image."""
    given_ = json.loads(calibration.dumps({"cam0": camera}, "ncore"))["camera_model_parameters"]
    rays = camera.unproject()
    offset = camera.pixels()[rays.valid] - camera.center
    across = np.hypot(*rays.directions[rays.valid][:, :2].T)
    angle = np.arctan2(across, rays.directions[rays.valid][:, 2])
    distance = np.hypot(*offset.T)
    by_angle = polyval(angle, given_["angle_to_pixeldist_poly"])
    by_distance = polyval(distance, given_["pixeldist_to_angle_poly"])
    assert np.abs(by_angle - distance).max() < 0.1
    step = np.abs(np.gradient(angle[np.argsort(distance)])).max()
    assert np.abs(by_distance - angle).max() < 0.1 * step + 5e-3


def test_models_and_names_that_formats_lack_are_refused() -> None:
    forth = cameras.model("ftheta").example(64)
    longer = cameras.create("ftheta", **SIZE, polynomial=(0, 30, 0, 0, 0, 0, 0.1))
    for name, camera, format, says in (
        ("cam0", forth, "isaac", "cam0: isaac: expected ftheta from pixel to angle"),
        ("front camera", THETA, "isaac", "name: expected letters"),
        ("cam0", longer, "ncore", r"cam0: ncore: expected ftheta.*got ftheta"),
    ):
        with pytest.raises(ArgumentError, match=says):
            calibration.dumps({name: camera}, format)
