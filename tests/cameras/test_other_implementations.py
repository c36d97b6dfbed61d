"""Where other programs differ from the model that they name, each case held against the model's own formula.

``docs/other-implementations.md`` cites these tests. They state what the installed versions do: a test that
fails after an update says that the other program has changed, perhaps for the better. Versions measured:
OpenCV 5.0.0, pycolmap 4.2.1, projectaria_tools 2.3.0 (its answers are kept in ``aria_fisheye624.json``).
"""

import json
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from omniscv import cameras

SIZE = {"width": 640, "height": 480}
F, CX, CY = 150.0, 320.5, 240.5
FOCALS = {"fx": F, "fy": F, "cx": CX, "cy": CY}
K = np.array([[F, 0, CX - 0.5], [0, F, CY - 0.5], [0, 0, 1]])
HALF = 0.5
NOWHERE = np.zeros(3)
AT_100 = np.array([np.sin(np.radians(100)), 0.0, np.cos(np.radians(100))])
ARIA = json.loads((Path(__file__).parent / "aria_fisheye624.json").read_text())


def colmap(model, *more):
    return pycolmap.Camera(model=model, **SIZE, params=[F, F, CX, CY, *more])


def is_none(answer):
    return answer is None or not np.isfinite(answer).any()


# -- OpenCV -------------------------------------------------------------------------------------


def test_opencv_fisheye_mirrors_what_is_beyond_90_degrees():
    """It takes atan(r / z) of x / z: at 100 degrees it answers the pixel of 80 degrees on the other side."""
    theirs = cv2.fisheye.projectPoints(AT_100[None, None], NOWHERE, NOWHERE, K, np.zeros(4))[0].ravel() + HALF
    ours, seen = cameras.create("kannala-brandt", **SIZE, **FOCALS).project(AT_100)
    assert seen
    np.testing.assert_allclose(ours, (CX + F * np.radians(100), CY), atol=1e-9)  # d(theta) = theta
    np.testing.assert_allclose(theirs, (CX - F * np.radians(80), CY), atol=1e-9)


def test_opencv_fisheye_unprojects_what_is_beyond_90_degrees_to_90():
    """It clamps theta: every such pixel comes out as the tangent of 90 degrees, 1e16."""
    pixel = np.array([CX + F * np.radians(100), CY])
    theirs = cv2.fisheye.undistortPoints(pixel[None, None] - HALF, K, np.zeros(4)).ravel()
    assert theirs[0] > 1e15
    ray = cameras.create("kannala-brandt", **SIZE, **FOCALS).unproject(pixel).directions
    np.testing.assert_allclose(ray, AT_100, rtol=0, atol=1e-15)


def test_opencv_projects_points_behind_the_camera():
    """``projectPoints`` answers the pixel of the opposite point, without a word; a pinhole sees neither."""
    ahead = np.array([0.3, 0.2, 1.0])
    theirs = cv2.projectPoints(np.stack([ahead, -ahead]), NOWHERE, NOWHERE, K, np.zeros(4))[0][:, 0]
    np.testing.assert_array_equal(theirs[0], theirs[1])
    _, seen = cameras.create("pinhole", **SIZE, **FOCALS).project(np.stack([ahead, -ahead]))
    np.testing.assert_array_equal(seen, [True, False])


BARREL = (-0.3, 0.0, 0.0, 0.0)  # r - 0.3 r^3 turns back at r = 1.054


@pytest.mark.parametrize("library", ["opencv", "colmap"])
def test_a_distortion_that_turned_back_puts_two_rays_into_one_pixel(library):
    """1.2 is beyond the turn: its pixel is that of 0.90111, which both answer when they are asked back."""
    beyond = np.array([[1.2, 0.0, 1.0]])
    if library == "opencv":
        pixel = cv2.projectPoints(beyond, NOWHERE, NOWHERE, K, np.array(BARREL))[0][:, 0]
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-15)
        back = cv2.undistortPoints(pixel[None], K, np.array(BARREL), criteria=criteria)[:, 0]
    else:
        lens = colmap("OPENCV", *BARREL)
        pixel = lens.img_from_cam(beyond)
        back = lens.cam_from_img(pixel)
    np.testing.assert_allclose(back, [[0.901110697, 0]], rtol=0, atol=1e-6)
    camera = cameras.create("pinhole", **SIZE, **FOCALS, distortion=BARREL)
    _, seen = camera.project(np.array([[1.2, 0, 1], [0.901110697, 0, 1]]))
    np.testing.assert_array_equal(seen, [False, True])


def test_opencv_undistorts_a_pixel_that_no_ray_has():
    """The last radius of r - 0.3 r^3 is 0.7027 f; ``undistortPoints`` finds a ray for 0.75 f."""
    pixel = np.array([CX + 0.75 * F, CY])
    theirs = cv2.undistortPoints(pixel[None, None] - HALF, K, np.array(BARREL)).ravel()
    r = theirs[0]
    assert np.isfinite(r)
    assert abs(r - 0.3 * r**3 - 0.75) > 0.01
    assert not cameras.create("pinhole", **SIZE, **FOCALS, distortion=BARREL).valid(pixel)


def test_opencv_undistorts_in_five_steps():
    """By itself it is 7e-4 off at a corner of a wide lens, a tenth of a pixel; told to go on, it is right."""
    distortion = np.array([-0.35, 0.12, 1e-3, -2e-3])
    camera = cameras.create("pinhole", **SIZE, **FOCALS, distortion=distortion)
    point = np.array([0.8, 0.5, 1.0])
    pixel, seen = camera.project(point)
    assert seen
    theirs = cv2.undistortPoints(pixel[None, None] - HALF, K, distortion).ravel()
    assert 1e-4 < np.abs(theirs - point[:2]).max() < 1e-2
    ray = camera.unproject(pixel).directions
    np.testing.assert_allclose(ray[:2] / ray[2], point[:2], rtol=0, atol=1e-13)


@pytest.mark.parametrize("model", ["pinhole", "kannala-brandt"])
def test_opencv_takes_skew_as_an_argument_or_not_at_all(model):
    """``projectPoints`` does not read K[0, 1]; that of the fisheye model takes it as ``alpha``."""
    skewed, ray = K.copy(), np.array([[[0.3, 0.2, 1.0]]])
    skewed[0, 1] = 0.1 * F
    project = cv2.projectPoints if model == "pinhole" else cv2.fisheye.projectPoints
    answers = [project(ray, NOWHERE, NOWHERE, matrix, np.zeros(4))[0] for matrix in (K, skewed)]
    np.testing.assert_array_equal(*answers)
    ours, _ = cameras.create(model, **SIZE, **FOCALS, skew=0.1).project(ray[0, 0])
    assert abs(ours[0] - HALF - answers[0].ravel()[0]) > 2
    if model == "kannala-brandt":
        theirs = cv2.fisheye.projectPoints(ray, NOWHERE, NOWHERE, K, np.zeros(4), alpha=0.1)[0].ravel()
        np.testing.assert_allclose(theirs + HALF, ours, rtol=0, atol=1e-9)


# -- COLMAP -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "more", "name", "own"),
    [
        ("EUCM", (0.6, 1.1), "extended-unified", {"alpha": 0.6, "beta": 1.1}),
        ("OPENCV_FISHEYE", (0,) * 4, "kannala-brandt", {}),
        ("RAD_TAN_THIN_PRISM_FISHEYE", (0,) * 12, "fisheye624", {}),
    ],
)
def test_colmap_sees_nothing_beyond_90_degrees(model, more, name, own):
    """``img_from_cam`` answers only points with z > 0: a lens of more than 180 degrees loses its rim."""
    assert is_none(colmap(model, *more).img_from_cam(AT_100))
    assert cameras.create(name, **SIZE, **FOCALS, **own).project(AT_100)[1]


def test_colmap_eucm_unprojects_no_pixel_beyond_90_degrees():
    camera = cameras.create("extended-unified", **SIZE, **FOCALS, alpha=0.6, beta=1.1)
    pixel, _ = camera.project(AT_100)
    lens = colmap("EUCM", 0.6, 1.1)
    assert is_none(lens.cam_from_img(pixel))
    np.testing.assert_allclose(camera.unproject(pixel).directions, AT_100, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("model", "more"), [("OPENCV_FISHEYE", (0,) * 4), ("RAD_TAN_THIN_PRISM_FISHEYE", (0,) * 12)]
)
def test_colmap_fisheyes_turn_pixels_beyond_90_degrees_to_the_front(model, more):
    """A pixel at theta = 1.7 rad, 97 degrees, comes out as x / z = 1.7: a ray at 59.5 degrees."""
    pixel = np.array([CX + 1.7 * F, CY])
    lens = colmap(model, *more)
    np.testing.assert_allclose(lens.cam_from_img(pixel), (1.7, 0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        lens.cam_ray_from_img(pixel), np.array([1.7, 0, 1]) / np.hypot(1.7, 1), rtol=0, atol=1e-9
    )
    ray = cameras.create("kannala-brandt", **SIZE, **FOCALS).unproject(pixel).directions
    np.testing.assert_allclose(ray, (np.sin(1.7), 0, np.cos(1.7)), rtol=0, atol=1e-15)


def test_colmap_division_unprojects_pixels_beyond_90_degrees_to_the_opposite_ray():
    """``cam_from_img`` answers x / z, and ``cam_ray_from_img`` takes (x / z, 1) for the ray; ``img_from_cam``
    is right."""
    camera = cameras.create("division", **SIZE, focal=F, cx=CX, cy=CY, k=-0.6)
    lens = colmap("DIVISION", -0.6)
    pixel, seen = camera.project(AT_100)
    assert seen
    np.testing.assert_allclose(lens.img_from_cam(AT_100), pixel, rtol=0, atol=1e-9)
    np.testing.assert_allclose(lens.cam_ray_from_img(pixel), -AT_100, rtol=0, atol=1e-12)
    np.testing.assert_allclose(camera.unproject(pixel).directions, AT_100, rtol=0, atol=1e-14)


# -- Project Aria -------------------------------------------------------------------------------


def test_aria_sees_points_behind_the_camera():
    """FISHEYE624 takes atan of r / z: a point with z < 0 gets the pixel of the opposite point."""
    f, cu, cv, *rest = ARIA["parameters"]
    camera = cameras.create(
        "fisheye624",
        **{"width": 2000, "height": 2000, "fx": f, "fy": f, "cx": cu + 1000.5, "cy": cv + 1000.5},
        **{"k": rest[:6], "p": rest[6:8], "s": rest[8:]},
    )
    rows = np.array(ARIA["rows"])
    behind = rows[rows[:, 2] < 0]
    assert len(behind) >= 5
    opposite, seen = camera.project(-behind[:, :3])
    assert seen.all()
    np.testing.assert_allclose(behind[:, 3:] + 1000.5, opposite, rtol=0, atol=1e-9)
    own, seen = camera.project(behind[:, :3])
    assert (np.linalg.norm(own[seen] - opposite[seen], axis=1) > 100).all()
