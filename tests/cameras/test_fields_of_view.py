"""Fields of view at a model's limit, one unit in the last place beyond it, and mirrors by field of view.

One ulp beyond a limit the formulas still return numbers, of a lens that cannot exist.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras
from omniscv.errors import ArgumentError
from omniscv.testing.contracts import PIXEL_TOLERANCE, round_trip_error

SQUARE = {"width": 101, "height": 101}
KB = {"fx": 12.0, "fy": 12.0}
POLYNOMIAL = {"coefficients": (-20.0, 0, 0.012)}
# model, parameter, limit in degrees, whether the limit itself is accepted, other arguments
LIMITS = [
    ("cylindrical", "fov_h_deg", 360, True, {}),
    ("cylindrical", "fov_v_deg", 180, True, {}),
    ("cylindrical", "fov_v_deg", 180, False, {"profile": "perspective"}),
    ("fisheye-equidistant", "fov_deg", 360, True, {}),
    ("fisheye-stereographic", "fov_deg", 360, False, {}),
    ("fisheye-orthographic", "fov_deg", 180, True, {}),
    ("fisheye-equisolid", "fov_deg", 360, True, {}),
    ("catadioptric-parabolic", "fov_deg", 360, False, {}),
    ("catadioptric-planar", "fov_deg", 180, False, {}),
    ("scaramuzza", "fov_deg", 360, True, POLYNOMIAL),
    ("kannala-brandt", "fov_deg", 360, True, KB),
    ("pinhole", "fov_deg", 180, False, {}),
]
BALL = {"mirror_radius": 0.5, "distance": 0.3}
CONE = {"half_angle_deg": 60.0, "distance": 0.3}


@pytest.mark.parametrize(("name", "key", "limit", "closed", "others"), LIMITS)
def test_one_ulp_beyond_is_refused(name, key, limit, closed, others):
    """``chart.limits`` approaches the limits themselves."""
    beyond = float(np.nextafter(limit, np.inf)) if closed else float(limit)
    sign = "<=" if closed else "<"
    says = rf"^{key}: expected a finite number > 0 and {sign} {limit}, got {beyond!r}$"
    with pytest.raises(ArgumentError, match=says):
        cameras.create(name, **SQUARE, **others, **{key: beyond})


def test_no_lens_takes_focal_length_and_field_of_view():
    others = {name: {} for name, key, *_, others in LIMITS if key == "fov_deg" and not others}
    others |= {"noncentral-spherical-mirror": BALL, "noncentral-conical-mirror": CONE}
    says = r"^focal: expected focal or fov_deg, got both \(50 px and 90 deg\)"
    for name, own in others.items():
        with pytest.raises(ArgumentError, match=says):
            cameras.create(name, **SQUARE, **own, focal=50, fov_deg=90)


@pytest.mark.parametrize(
    ("name", "others"), [(name, others) for name, key, *_, others in LIMITS if key == "fov_deg"]
)
def test_points_beyond_the_field_of_view_are_not_seen(name, others):
    """To 1e-9 of the angle, on both sides of its edge, all around."""
    camera = cameras.create(name, **SQUARE, **others, fov_deg=100)
    ahead = -1 if name.startswith("catadioptric") else 1
    azimuth = np.linspace(-np.pi, np.pi, 25) if name != "pinhole" else np.zeros(1)
    around = np.stack([np.cos(azimuth), np.sin(azimuth), np.full_like(azimuth, ahead)], axis=-1)
    for part, seen in ((1 - 1e-9, True), (1 + 1e-9, False)):
        angle = np.radians(50) * part
        points = around * [np.sin(angle), np.sin(angle), np.cos(angle)]
        assert (camera.project(points)[1] == seen).all()


@pytest.mark.parametrize(("distance", "semi_latus_rectum"), [(1.0, 0.5), (0.01, 3.0), (1000.0, 0.001)])
def test_the_limit_of_a_hyperboloid_is_its_asymptote(distance, semi_latus_rectum):
    """360 deg less twice the asymptote's angle with the axis, b / a = tan.

    The rays of the mirror's far rim run along the line from the inner focus parallel to the asymptote.
    """
    mirror = {"distance": distance, "semi_latus_rectum": semi_latus_rectum}
    a = (np.hypot(distance, semi_latus_rectum) - semi_latus_rectum) / 2
    limit = 360 - 2 * np.degrees(np.arctan2(np.sqrt(semi_latus_rectum * a), a))
    camera = cameras.create("catadioptric-hyperbolic", **SQUARE, **mirror, fov_deg=limit * (1 - 1e-9))
    assert round_trip_error(camera) <= PIXEL_TOLERANCE
    assert 2 * off_axis_deg(camera, (101, 50.5)) == pytest.approx(limit, rel=2e-9)
    with pytest.raises(ArgumentError, match=r"^fov_deg: expected a finite number > 0 and < "):
        cameras.create("catadioptric-hyperbolic", **SQUARE, **mirror, fov_deg=limit * (1 + 1e-9))


# -- non-central mirrors ------------------------------------------------------------------------

SIZE = 100
EDGE = np.array([SIZE, SIZE / 2])  # the last pixel of the image circle, to the right


def create(name, fov_deg, **own):
    return cameras.create(name, width=SIZE, height=SIZE, fov_deg=fov_deg, **own)


def off_axis_deg(camera, pixel):
    """Return the angle of a pixel's ray from -z, the direction of the image's middle."""
    x, y, z = camera.unproject(np.array(pixel)).directions
    return np.degrees(np.arctan2(np.hypot(x, y), -z))


@cases(15)
@given(st.floats(0.001, 0.999), st.floats(-2, 2), st.floats(-2, 2))
def test_the_last_ray_of_a_ball(part, size, away):
    radius, distance = 10**size, 10**away
    limit = 360 - 2 * np.degrees(np.arcsin(radius / (radius + distance)))
    camera = create("noncentral-spherical-mirror", part * limit, mirror_radius=radius, distance=distance)
    inside = EDGE - (1e-9, 0)
    assert camera.valid(inside)
    assert not camera.valid(EDGE - (0, 1))
    # 1e-9 px are 1e-9 degrees or so, and more for a grazing ray, which turns as 1 / cos(i).
    assert off_axis_deg(camera, inside) == pytest.approx(part * limit / 2, abs=1e-8 / (1 - part))


@cases(15)
@given(st.floats(0.001, 0.999), st.floats(1, 89))
def test_the_last_ray_of_a_cone(part, half_angle_deg):
    fov_deg = 360 - (4 - 2 * part) * half_angle_deg
    camera = create("noncentral-conical-mirror", fov_deg, half_angle_deg=half_angle_deg, distance=0.3)
    assert camera.valid(EDGE - (1e-9, 0))
    assert off_axis_deg(camera, EDGE - (1e-9, 0)) == pytest.approx(fov_deg / 2, abs=1e-8)


def test_the_limit_of_a_ball_and_one_ulp_beyond():
    """The grazing ray: 360 degrees less the ball's own disc, as the camera sees it."""
    limit = 360 - 2 * np.degrees(np.arcsin(0.5 / 0.8))
    assert create("noncentral-spherical-mirror", limit, **BALL).valid(EDGE - (1e-6, 0))
    with pytest.raises(ValueError, match=r"^fov_deg: expected .*<= 282\.6356\d+, got 282\.6356"):
        create("noncentral-spherical-mirror", float(np.nextafter(limit, 360)), **BALL)


def test_the_limits_of_a_cone_are_open():
    """At 360 - 4 tau only the tip is left, at 360 - 2 tau the hit is infinitely far."""
    for fov_deg in (120, np.nextafter(120, 0), 240, 359, 0, -10, np.nan):
        with pytest.raises(ValueError, match=r"^fov_deg: expected a finite number > 120 and < 240, got"):
            create("noncentral-conical-mirror", fov_deg, **CONE)
    assert create("noncentral-conical-mirror", np.nextafter(240, 0), **CONE).valid(EDGE - (1e-6, 0))
    narrow = create("noncentral-conical-mirror", np.nextafter(120, 360), **CONE)
    assert off_axis_deg(narrow, EDGE - (1e-6, 0)) == pytest.approx(60)
