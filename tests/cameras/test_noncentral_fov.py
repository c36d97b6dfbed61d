"""Mirrors by field of view instead of focal length: the last ray, the limits, one ulp beyond."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

SIZE = 100
EDGE = np.array([SIZE, SIZE / 2])  # the last pixel of the image circle, to the right


def ball(fov_deg, mirror_radius=0.5, distance=0.3, **options):
    return cameras.create(
        "noncentral-spherical-mirror",
        width=SIZE,
        height=SIZE,
        mirror_radius=mirror_radius,
        distance=distance,
        fov_deg=fov_deg,
        **options,
    )


def cone(fov_deg, half_angle_deg=60.0, **options):
    return cameras.create(
        "noncentral-conical-mirror",
        width=SIZE,
        height=SIZE,
        half_angle_deg=half_angle_deg,
        distance=0.3,
        fov_deg=fov_deg,
        **options,
    )


def off_axis_deg(camera, pixel):
    """The angle of a pixel's ray from -z, where the image's middle looks."""
    x, y, z = camera.unproject(pixel).directions
    return np.degrees(np.arctan2(np.hypot(x, y), -z))


@cases(15)
@given(st.floats(0.001, 0.999), st.floats(-2, 2), st.floats(-2, 2))
def test_the_last_ray_of_a_ball(part, size, away):
    mirror_radius, distance = 10**size, 10**away
    limit = 360 - 2 * np.degrees(np.arcsin(mirror_radius / (mirror_radius + distance)))
    camera = ball(part * limit, mirror_radius, distance)
    inside = EDGE - (1e-9, 0)
    assert camera.valid(inside)
    assert not camera.valid(EDGE - (0, 1))
    # 1e-9 px are 1e-9 degrees or so, and more for a grazing ray, which turns as 1 / cos(i).
    assert off_axis_deg(camera, inside) == pytest.approx(part * limit / 2, abs=1e-8 / (1 - part))


@cases(15)
@given(st.floats(0.001, 0.999), st.floats(1, 89))
def test_the_last_ray_of_a_cone(part, half_angle_deg):
    fov_deg = 360 - (4 - 2 * part) * half_angle_deg
    camera = cone(fov_deg, half_angle_deg)
    inside = EDGE - (1e-9, 0)
    assert camera.valid(inside)
    assert off_axis_deg(camera, inside) == pytest.approx(fov_deg / 2, abs=1e-8)


def test_the_limit_of_a_ball_and_one_ulp_beyond():
    """The grazing ray: 360 degrees less the ball's own disc, as the camera sees it."""
    limit = 360 - 2 * np.degrees(np.arcsin(0.5 / 0.8))
    camera = ball(limit)
    assert camera.valid(EDGE - (1e-6, 0))
    with pytest.raises(ValueError, match=r"^fov_deg: expected .*<= 282\.6356\d+, got 282\.6356"):
        ball(float(np.nextafter(limit, 360)))


def test_the_limits_of_a_cone_are_open():
    """At 360 - 4 tau only the tip is left, at 360 - 2 tau the hit is infinitely far."""
    for fov_deg in (120, np.nextafter(120, 0), 240, 359, 0, -10, np.nan):
        with pytest.raises(ValueError, match=r"^fov_deg: expected a finite number > 120 and < 240, got"):
            cone(fov_deg)
    assert cone(np.nextafter(240, 0)).valid(EDGE - (1e-6, 0))
    narrow = cone(np.nextafter(120, 360))
    assert off_axis_deg(narrow, EDGE - (1e-6, 0)) == pytest.approx(60)


@pytest.mark.parametrize("create", [ball, cone])
def test_focal_or_fov_but_not_both(create):
    with pytest.raises(ValueError, match=r"^focal: expected focal or fov_deg, got both"):
        create(200, focal=50)
    assert create(None).focal == SIZE / 2
