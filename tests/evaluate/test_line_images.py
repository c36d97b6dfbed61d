"""The formulas of line images, against the cameras' own projection and against mpmath."""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniscv.evaluate.calibration.estimation import models

FOCAL = 512.0
SIZE = 1024
MODELS = models(FOCAL)
NAMES = sorted(MODELS)
VALUES = st.floats(0.5, 1.5).map(lambda value: value * SIZE / 2)

# The angle from the axis, by radius and r_vl: each model's own definition, as the paper has it.
ANGLES = {
    "equi-angular": lambda r, v: r / (2 * v / mpmath.pi),
    "stereographic": lambda r, v: 2 * mpmath.atan(r / (2 * (v / 2))),
    "orthogonal": lambda r, v: mpmath.asin(r / v),
    "equi-solid": lambda r, v: 2 * mpmath.asin(r / (mpmath.sqrt(2) * v)),
    "para-catadioptric": lambda r, v: sphere_angle(r / v, 1),
    "hyper-catadioptric": lambda r, v: hyperboloid_angle(r, v),
}


def sphere_angle(rho, xi):
    scale = (xi + mpmath.sqrt(1 + (1 - xi**2) * rho**2)) / (rho**2 + 1)
    return mpmath.atan2(scale * rho, scale - xi)


def hyperboloid_angle(r, v):
    """Where a camera's ray meets a hyperboloid of revolution, seen from its inner focus, by its definition:
    the distances from the foci differ by 2a."""
    d, p2 = mpmath.mpf(1), v / FOCAL
    a2 = mpmath.sqrt(d**2 + p2**2) - p2
    cosine = 1 / mpmath.sqrt(1 + (r / FOCAL) ** 2)
    # s: from the camera, at the outer focus, to the mirror; s - sqrt(s^2 - 2 s d cosine + d^2) = 2a
    s = (d**2 - a2**2) / (2 * (d * cosine - a2))
    across, ahead = s * (r / FOCAL) * cosine, s * cosine - d
    return mpmath.atan2(across, -ahead)


def radii(name, v, shares):
    """Radii within the model's domain."""
    most = {"orthogonal": v, "equi-solid": 1.41 * v, "equi-angular": 1.99 * v}.get(name, SIZE / 2)
    return np.asarray(shares) * min(most, SIZE / 2)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10)
@given(v=VALUES, share=st.floats(0.05, 0.98))
def test_alpha_and_its_slope_are_those_of_the_model(name, v, share):
    (r,) = radii(name, v, [share])
    with mpmath.workdps(30):

        def alpha(x):
            return -x * mpmath.cot(ANGLES[name](x, mpmath.mpf(v)))

        expected, slope = float(alpha(mpmath.mpf(r))), float(mpmath.diff(alpha, mpmath.mpf(r)))
    assert MODELS[name].alpha(np.array(r), v) == pytest.approx(expected, rel=1e-9, abs=1e-9 * v)
    assert MODELS[name].slope(np.array(r), v) == pytest.approx(slope, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10)
@given(v=VALUES, seed=st.integers(0, 999))
def test_the_images_of_a_lines_points_are_on_its_line_image(name, v, seed):
    camera = MODELS[name].camera(SIZE, v)
    rng = np.random.default_rng(seed)
    start, along = rng.normal(size=(2, 3))
    points = start + np.linspace(-5, 5, 40)[:, None] * along
    pixels, seen = camera.project(points)
    normal = np.cross(start, along) / np.linalg.norm(np.cross(start, along))
    if "catadioptric" in name:  # the image's middle sees -z
        normal[2] = -normal[2]
    x, y = (pixels[seen] - camera.center).T
    value = normal[0] * x + normal[1] * y - normal[2] * MODELS[name].alpha(np.hypot(x, y), v)
    assert np.abs(value).max(initial=0) <= 1e-8 * v
