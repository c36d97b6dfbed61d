"""The formulas of line images, against the cameras' own projection."""

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


def radii(name, v, shares):
    """Radii within the model's domain."""
    most = {"orthogonal": v, "equi-solid": 1.41 * v, "equi-angular": 1.99 * v}.get(name, SIZE / 2)
    return np.asarray(shares) * min(most, SIZE / 2)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10)
@given(v=VALUES, share=st.floats(0.05, 0.98))
def test_the_slope_is_that_of_alpha(name, v, share):
    (r,) = radii(name, v, [share])
    model, h = MODELS[name], 1e-5 * r
    before, after = (model.alpha(np.array(r + step), v) for step in (-h, h))
    assert model.slope(np.array(r), v) == pytest.approx((after - before) / (2 * h), rel=1e-6, abs=1e-6)


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
