"""Calibrated lenses against pycolmap, OpenCV and Project Aria, where those are right: pixels to 1e-9.

COLMAP's top-left pixel has its centre at (0.5, 0.5), as ours; OpenCV's and Aria's have it at (0, 0). Their
parameters are ours in another order. Where they are wrong: ``test_other_implementations.py``.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from support.calibrated import SIZE, drawn_intrinsics, drawn_lens, drawn_rays

from omniscv import cameras

TOLERANCE = 1e-9  # px; and rad where rays are compared
DRAWS = 4
HALF = 0.5
ARIA = json.loads((Path(__file__).parent / "aria_fisheye624.json").read_text())


def focals(camera):
    return [camera.fx, camera.fy, camera.cx, camera.cy]


def without_skew(name, rng):
    described = drawn_lens(name, rng).to_dict()
    return cameras.from_dict({k: v for k, v in described.items() if k != "skew"})


def full_opencv(rng):
    k = drawn_lens("pinhole", rng).distortion[:8]
    return cameras.create("pinhole", **SIZE, **drawn_intrinsics(rng), distortion=k)


COLMAP = {
    "EUCM": (
        lambda rng: without_skew("extended-unified", rng),
        lambda camera: [*focals(camera), camera.alpha, camera.beta],
    ),
    "FULL_OPENCV": (full_opencv, lambda camera: [*focals(camera), *camera.distortion[:8]]),
    "OPENCV_FISHEYE": (
        lambda rng: without_skew("kannala-brandt", rng),
        lambda camera: [*focals(camera), *camera.k],
    ),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        lambda rng: without_skew("fisheye624", rng),
        lambda camera: [*focals(camera), *camera.k, *camera.p, *camera.s],
    ),
    "SIMPLE_DIVISION": (
        lambda rng: drawn_lens("division", rng),
        lambda camera: [camera.focal, camera.cx, camera.cy, camera.k],
    ),
    "DIVISION": (
        lambda rng: drawn_lens("division", rng),
        lambda camera: [camera.focal, camera.focal, camera.cx, camera.cy, camera.k],
    ),
}


@pytest.mark.parametrize("model", COLMAP)
@pytest.mark.parametrize("draw", range(DRAWS))
def test_colmap(model, draw):
    rng = np.random.default_rng([draw, *model.encode()])
    make, parameters = COLMAP[model]
    camera = make(rng)
    theirs = pycolmap.Camera(model=model, **SIZE, params=parameters(camera))
    points = drawn_rays(rng, 400, 85) * rng.uniform(0.1, 100, (400, 1))
    pixels, seen = camera.project(points)
    assert seen.mean() > 0.2
    np.testing.assert_allclose(pixels[seen], theirs.img_from_cam(points[seen]), rtol=0, atol=TOLERANCE)
    in_front = theirs.cam_from_img(pixels[seen])
    rays = np.concatenate([in_front, np.ones((len(in_front), 1))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    found = np.isfinite(in_front).all(axis=1)  # its Newton's steps do not always arrive
    assert found.mean() > 0.9
    ours = camera.unproject(pixels[seen][found]).directions
    np.testing.assert_allclose(ours, rays[found], rtol=0, atol=1e-8)


def opencv_pixels(points, k, K=None):
    K = np.eye(3) if K is None else K
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(k))[0][:, 0]


def opencv_matrix(camera):
    fx, fy, cx, cy = focals(camera)
    return np.array([[fx, 0, cx - HALF], [0, fy, cy - HALF], [0, 0, 1]])


@pytest.mark.parametrize("count", [4, 5, 8, 12])
@pytest.mark.parametrize("draw", range(DRAWS))
def test_opencv_rational_and_prism(count, draw):
    """Of 4, 5, 8 and 12 coefficients; and with skew, which ``projectPoints`` leaves out of K."""
    rng = np.random.default_rng([draw, count])
    skewed = drawn_lens("pinhole", rng)
    k = skewed.distortion[:count]
    camera = cameras.create("pinhole", **SIZE, **drawn_intrinsics(rng), distortion=k)
    points = drawn_rays(rng, 400, 70) * rng.uniform(0.1, 100, (400, 1))
    pixels, seen = camera.project(points)
    assert seen.mean() > 0.3
    theirs = opencv_pixels(points[seen], k, opencv_matrix(camera)) + HALF
    np.testing.assert_allclose(pixels[seen], theirs, rtol=0, atol=TOLERANCE)
    pixels, seen = skewed.project(points)
    x, y = opencv_pixels(points[seen], skewed.distortion).T
    u = skewed.cx + skewed.fx * (x + skewed.skew * y)
    np.testing.assert_allclose(
        pixels[seen], np.stack([u, skewed.cy + skewed.fy * y], axis=-1), rtol=0, atol=TOLERANCE
    )


@pytest.mark.parametrize("draw", range(DRAWS))
def test_opencv_undistorts_to_our_rays(draw):
    """Told to go on to the end; by itself it stops after five steps."""
    rng = np.random.default_rng(draw)
    camera = cameras.create(
        "pinhole", **SIZE, **drawn_intrinsics(rng, 400, 600), distortion=drawn_lens("pinhole", rng).distortion
    )
    pixels = rng.uniform(0, (SIZE["width"], SIZE["height"]), (200, 2))
    rays = camera.unproject(pixels)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-15)
    at = pixels[rays.valid] - HALF
    theirs = cv2.undistortPoints(at, opencv_matrix(camera), camera.distortion, criteria=criteria)[:, 0]
    assert rays.valid.mean() > 0.9
    ours = rays.directions[rays.valid]
    np.testing.assert_allclose(ours[:, :2] / ours[:, 2:], theirs, rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("draw", range(DRAWS))
def test_opencv_fisheye_with_skew(draw):
    rng = np.random.default_rng(draw)
    camera = drawn_lens("kannala-brandt", rng)
    points = drawn_rays(rng, 400, 85) * rng.uniform(0.1, 100, (400, 1))
    pixels, seen = camera.project(points)
    assert seen.mean() > 0.3
    theirs = cv2.fisheye.projectPoints(
        points[seen][:, None], np.zeros(3), np.zeros(3), opencv_matrix(camera), camera.k, alpha=camera.skew
    )[0][:, 0]
    np.testing.assert_allclose(pixels[seen], theirs + HALF, rtol=0, atol=TOLERANCE)


def aria_lens():
    """The lens of ``aria_fisheye624.json``: one focal length, then cu, cv, k0..k5, p0, p1, s0..s3."""
    f, cu, cv, *rest = ARIA["parameters"]
    terms = {"k": rest[:6], "p": rest[6:8], "s": rest[8:]}
    return cameras.create("fisheye624", **SIZE, fx=f, fy=f, cx=cu + HALF, cy=cv + HALF, **terms)


def test_aria():
    """Vectors made once with projectaria_tools, by its own projection::

    lens = np.array([...])                    # "parameters" of the file
    projection = CameraProjection(CameraModelType.FISHEYE624, lens)
    points = np.random.default_rng(0).normal(size=(40, 3)) + (0, 0, 0.7)
    rows = [[*p.tolist(), *projection.project(p).tolist()] for p in points]
    """
    rows = np.array(ARIA["rows"])
    in_front = rows[rows[:, 2] > 0.05]
    pixels, seen = aria_lens().project(in_front[:, :3])
    assert seen.sum() >= 20
    np.testing.assert_allclose(pixels[seen], in_front[seen, 3:] + HALF, rtol=0, atol=TOLERANCE)
    beside = ((in_front[:, 3:] < -HALF) | (in_front[:, 3:] > (639.5, 479.5))).any(axis=1)
    np.testing.assert_array_equal(seen, ~beside)
