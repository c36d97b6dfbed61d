"""The contract at extreme parameters, sizes and points.

A model refuses numbers with an ``ArgumentError``, or its cameras answer a point with a pixel
whose ray points to it, or mark the point as not seen.
"""

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from support.camera_contract import never_wrong
from support.cases import cases

from omniscv import cameras
from omniscv.errors import ArgumentError

TOLERANCE = 1e-5  # rad, beside what 1e-7 px turn the ray
scale = st.one_of(st.just(0.0), st.floats(-3, 3)).map(lambda e: float(np.float64(10) ** e))
size = st.one_of(st.integers(1, 70), st.integers(1, 10**6))
place = st.sampled_from([None, (0.5, 0.5), (0.0, 0.0), (-3.0, 2.0), (1e9, -1e9)])
coordinate = st.sampled_from(
    [0.0, -0.0, 1.0, -1.0, 0.3, -0.7, 1e-9, 1e9, -1e9, 1e300, np.nan, np.inf]
) | st.floats(-3, 3)
points = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=20).map(np.array)


@st.composite
def any_camera(draw):
    """A registered model's example, each of its numbers as it is or scaled by up to 1000."""
    cls = cameras.model(draw(st.sampled_from(cameras.names())))
    described = {**cls.example(64).to_dict(), "width": draw(size), "height": draw(size)}
    for key, value in described.items():
        if key in ("center", "cx", "cy"):
            drawn = draw(place)
            described[key] = drawn if key == "center" or drawn is None else drawn[key == "cy"]
        elif isinstance(value, float):
            described[key] = value * draw(scale)
        elif isinstance(value, list):
            described[key] = [number * draw(scale) for number in value]
    if draw(st.booleans()):
        described.pop("fov_deg", None)
    try:
        return cameras.from_dict({key: value for key, value in described.items() if value is not None})
    except ArgumentError as error:
        assert "\n" not in str(error)  # noqa: PT017 - not to be refused is as good
        assume(False)


@cases(60)
@example(cameras.FisheyeOrthographic(2, 61, focal=0.0015, center=(0.5, 32.0)), np.array([[1.0, 0, 0]]))
@given(any_camera(), points)
def test_a_point_that_is_seen_is_where_its_pixel_looks(camera, points):
    never_wrong(camera, points, TOLERANCE, at_the_border=2.0)


@cases(40)
@given(any_camera(), st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=20))
def test_a_valid_pixel_has_a_ray(camera, parts):
    rays = camera.unproject(np.array(parts) * (camera.width, camera.height))
    assert np.isfinite(rays.origins[rays.valid]).all()
    np.testing.assert_allclose(np.linalg.norm(rays.directions[rays.valid], axis=-1), 1, rtol=1e-12)


def test_images_and_polynomials_that_would_take_all_memory_are_refused():
    for name in cameras.names():
        described = cameras.model(name).example(64).to_dict()
        with pytest.raises(ArgumentError, match=r"size: expected at most 134217728 pixels"):
            cameras.from_dict({**described, "width": 10**6, "height": 10**6})
    with pytest.raises(ArgumentError, match=r"coefficients: expected at most 64 numbers, got 100000"):
        cameras.create("scaramuzza", 64, 64, coefficients=[-1.0] * 100_000)


def test_numbers_that_no_formula_holds_are_refused():
    for name, arguments in (
        ("catadioptric-hyperbolic", {"distance": 1e200, "semi_latus_rectum": 1.0}),
        ("fisheye-equidistant", {"fov_deg": 5e-324}),
    ):
        with pytest.raises(ArgumentError, match=r"expected .*, got "):
            cameras.create(name, 64, 64, **arguments)
