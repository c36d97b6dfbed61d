"""Where lenses end: at the first turn of their curve, found in 50 digits, and at limits of fields of view."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras
from omniscv.errors import ArgumentError
from omniscv.testing.contracts import PIXEL_TOLERANCE, round_trip_error

DIGITS = 50
SIZE = {"width": 640, "height": 640}
F = 100.0


class Lens(NamedTuple):
    """A camera, and the curve of its rays: angle (rad) and radius (px) by a parameter that grows from 0."""

    camera: cameras.Camera
    angle: Callable
    radius: Callable
    most: float  # of the parameter
    apart: float = 1e-12  # relative: radii on both sides of the border that can be told apart


def opencv(x, y, k):
    """The distortion of OpenCV's documentation, calib3d."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (*k, *[0] * (12 - len(k)))
    r2 = x**2 + y**2
    c = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * c + 2 * p1 * x * y + p2 * (r2 + 2 * x**2) + s1 * r2 + s2 * r2**2
    v = y * c + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y + s3 * r2 + s4 * r2**2
    return np.array([u, v])


def by_angle(name, radius, most=np.pi, f=F, **parameters):
    """A lens whose parameter is the angle, by its published formula, of a focal length of 1."""
    camera = cameras.create(name, **SIZE | {"fx": f, "fy": f} | parameters)
    return Lens(camera, lambda t: t, lambda t: f * radius(t), most)


def kannala_brandt(k):
    terms = [mp.mpf(each) for each in (1.0, *k)]
    return by_angle("kannala-brandt", lambda t: sum(c * t ** (2 * i + 1) for i, c in enumerate(terms)), k=k)


def double_sphere(xi, alpha):
    """Its border is at 190 px."""

    def radius(t):
        shifted = xi + mp.cos(t)
        return mp.sin(t) / (alpha * mp.hypot(mp.sin(t), shifted) + (1 - mp.mpf(alpha)) * shifted)

    return by_angle("double-sphere", radius, f=190 * np.sqrt(2 * alpha - 1), xi=xi, alpha=alpha)


def rational(k):
    """k1, k2, p1, p2, k3, k4, k5, k6 of a pinhole."""
    terms = [mp.mpf(each) for each in k]
    most = np.arctan(4.0)
    return by_angle("pinhole", lambda t: opencv(mp.tan(t), 0, terms)[0], most, width=10_000, distortion=k)


def scaramuzza(*coefficients):
    camera = cameras.create("scaramuzza", width=800, height=800, coefficients=coefficients)

    def angle(rho):
        return mp.atan2(rho, -sum(a * rho**i for i, a in enumerate(coefficients)))

    return Lens(camera, angle, lambda rho: rho, 600.0, 1e-9)


TURNING = {
    "kannala-brandt": kannala_brandt((-0.1, 0, 0, 0)),
    "kannala-brandt, two terms": kannala_brandt((0.02, -0.008, 0, -0.0004)),
    "kannala-brandt, all terms": kannala_brandt((-0.3, 0.1, -0.02, 0.001)),
    "kannala-brandt, early": kannala_brandt((1.0, -1.0, 0, 0)),
    "kannala-brandt, late": kannala_brandt((0, 0, 0, -1e-4)),
    "kannala-brandt, rises again": kannala_brandt((-0.2, 0.012, 0, 0)),  # the second branch is not the lens
    "double-sphere, xi < 0": double_sphere(-0.2, 0.55),
    "double-sphere, xi > 0": double_sphere(0.9, 0.65),
    "pinhole": rational((-0.3, 0, 0, 0, 0, 0, 0, 0)),
    "pinhole, three terms": rational((-0.35, 0.12, 0, 0, -0.02, 0, 0, 0)),
    "pinhole, rises again": rational((0.1, -0.7, 0, 0, 0.3, 0, 0, 0)),
    "pinhole, rational": rational((0.2, -0.05, 0, 0, 0.01, 0.8, 0.3, 0.1)),
    "scaramuzza": scaramuzza(-150.0, 0, 1e-3, 0, -2e-8),
    "scaramuzza, cubic": scaramuzza(-150.0, 0, 1e-3, -4e-6, 0),
    "scaramuzza, linear": scaramuzza(-80.0, 0.1, 0, 0, -1e-8),
    "scaramuzza, nearer again": scaramuzza(-200.0, 0, -1e-3),  # to the axis, from rho = 447 px on
    "scaramuzza, away again": scaramuzza(-120.0, 0, 4e-3, -3.3e-5, 5e-8),
}
turning = pytest.mark.parametrize("name", TURNING)


@functools.cache
@mp.workdps(DIGITS)
def first_turn(lens):
    """(angle, radius) where one of them first stops growing with the other: on a grid, and then by halves."""
    grid = [mp.mpf(x) for x in np.linspace(0, lens.most, 251)[1:-1].tolist()]
    falls = next(i for i, s in enumerate(grid) if not grows(lens, s))
    low, high = grid[falls - 1], grid[falls]
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if grows(lens, middle) else (low, middle)
    return float(lens.angle(low)), float(lens.radius(low))


def grows(lens, s):
    h = mp.mpf(10) ** -20 * s
    return all(curve(s + h) > curve(s - h) > 0 for curve in (lens.angle, lens.radius))


def ray(angle, azimuth=0.0):
    across = np.sin(angle)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(angle)], axis=-1)


@turning
def test_the_lens_ends_at_the_first_turn(name):
    lens = TURNING[name]
    angle, radius = first_turn(lens)
    camera = cameras.from_dict({**lens.camera.to_dict(), "width": 10_000} | centred(lens.camera))
    for part, valid in ((0.5, True), (1 - lens.apart, True), (1 + lens.apart, False), (1.05, False)):
        pixels = camera.center + radius * part * np.array([[1, 0], [-1, 0], [0.8, -0.6], [-0.8, 0.6]])
        inside = ((pixels >= 0) & (pixels <= (camera.width, camera.height))).all(axis=1)
        assert inside[:2].all()
        np.testing.assert_array_equal(camera.valid(pixels), inside & valid, err_msg=str(part))
    for past, seen in ((-0.1, True), (-1e-9, True), (1e-9, False), (0.1, False)):
        assert camera.project(ray(min(angle + past, np.pi)))[1] == seen, past


def centred(camera):
    """The principal point in the middle of an image 10,000 px wide."""
    described = camera.to_dict()
    return {"cx": 5000.0} if "cx" in described else {"center": [5000.0, camera.center[1]]}


def test_a_slope_that_only_touches_zero_is_no_turn():
    """d' = (1 - theta^2)^2, 0 at 1 rad but never negative, though the solver's roots are off by 1e-8."""
    lens = kannala_brandt((-2 / 3, 1 / 5, 0, 0))
    for theta in (0.9, 1 - 1e-6, 1 + 1e-6, 1.5, 3.0):
        pixel, seen = lens.camera.project(ray(theta))
        r = float(lens.radius(mp.mpf(theta)))
        assert seen == (r <= 320)
        if seen:
            np.testing.assert_allclose(pixel, (320 + r, 320), rtol=0, atol=1e-9)


def test_a_threefold_root_is_a_turn():
    """d' = (1 - theta^2)^3: the solver scatters the roots 1e-5 around 1 rad, and none is real."""
    camera = kannala_brandt((-1.0, 3 / 5, -1 / 7, 0)).camera
    r_end = F * (1 - 1 + 3 / 5 - 1 / 7)
    assert camera.valid(np.array([320 + r_end * (1 - 1e-9), 320]))
    assert not camera.valid(np.array([320 + r_end * (1 + 1e-9), 320]))
    for theta, seen in ((0.99, True), (1.01, False), (1.5, False)):
        assert camera.project(ray(theta))[1] == seen


@pytest.mark.parametrize("k", [(0.2, 0.05, 0, 0, 0.01, -0.3, 0, 0), (0.2, 0.1, 0, 0, 0.02, 0.1, 0, 0)])
def test_terms_without_a_turn_do_not_limit_the_image(k):
    """The first has a pole: the image reaches to infinity."""
    assert rational(k).camera.valid(np.array([[0.5, 0.5], [9999.5, 639.5]])).all()


@pytest.mark.parametrize(
    "distortion", [(-0.3, 0, 3e-3, -2e-3), (-0.3, 0.01, 0, 0, 0, 0, 0, 0, 2e-3, 0, -3e-3, 0)]
)
def test_domains_of_tangential_terms_and_prisms(distortion):
    """On the disc's rim, and nowhere within, the distortion stretches some direction by nothing."""
    camera = cameras.create("pinhole", width=10_000, height=640, fx=F, fy=F, distortion=distortion)
    # the largest x / z that the camera sees to the right
    rim = 0.0
    high = 20.0
    for _ in range(60):
        middle = (rim + high) / 2
        rim, high = (middle, high) if camera.project(np.array([middle, 0, 1.0]))[1] else (rim, middle)

    def least_stretch(r):
        """The least eigenvalue of the derivative's symmetric part around the circle, by differences."""
        a = np.linspace(0, 2 * np.pi, 721)
        at = r * np.stack([np.cos(a), np.sin(a)])
        h = 1e-6
        steps = h * np.array([[[1.0], [0.0]], [[0.0], [1.0]]])
        dx, dy = (
            (opencv(*(at + aside), distortion) - opencv(*(at - aside), distortion)) / (2 * h)
            for aside in steps
        )
        off = (dx[1] + dy[0]) / 2
        return ((dx[0] + dy[1]) / 2 - np.hypot((dx[0] - dy[1]) / 2, off)).min()

    assert abs(least_stretch(rim)) < 1e-5
    assert all(least_stretch(part * rim) > 0 for part in (0.2, 0.5, 0.8, 0.95, 0.999))


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
    beyond = float(np.nextafter(limit, np.inf)) if closed else float(limit)
    sign = "<=" if closed else "<"
    says = rf"^{key}: expected a finite number > 0 and {sign} {limit}, got {beyond!r}$"
    with pytest.raises(ArgumentError, match=says):
        cameras.create(name, **SQUARE, **others, **{key: beyond})


@pytest.mark.parametrize(
    ("name", "others"), [(name, others) for name, key, *_, others in LIMITS if key == "fov_deg"]
)
def test_points_beyond_the_field_of_view_are_not_seen(name, others):
    camera = cameras.create(name, **SQUARE, **others, fov_deg=100)
    ahead = -1 if name.startswith("catadioptric") else 1
    azimuth = np.linspace(-np.pi, np.pi, 25) if name != "pinhole" else np.zeros(1)
    around = np.stack([np.cos(azimuth), np.sin(azimuth), np.full_like(azimuth, ahead)], axis=-1)
    for part, seen in ((1 - 1e-9, True), (1 + 1e-9, False)):
        angle = np.radians(50) * part
        pixels, found = camera.project(around * [np.sin(angle), np.sin(angle), np.cos(angle)])
        assert (found == seen).all()
        if seen and not others:
            np.testing.assert_allclose(np.linalg.norm(pixels - camera.center, axis=1), 50.5, rtol=1e-8)


@pytest.mark.parametrize(("distance", "semi_latus_rectum"), [(1.0, 0.5), (0.01, 3.0), (1000.0, 0.001)])
def test_the_limit_of_a_hyperboloid_is_its_asymptote(distance, semi_latus_rectum):
    """360 deg less twice the asymptote's angle with the axis, b / a = tan."""
    mirror = {"distance": distance, "semi_latus_rectum": semi_latus_rectum}
    a = (np.hypot(distance, semi_latus_rectum) - semi_latus_rectum) / 2
    limit = 360 - 2 * np.degrees(np.arctan2(np.sqrt(semi_latus_rectum * a), a))
    camera = cameras.create("catadioptric-hyperbolic", **SQUARE, **mirror, fov_deg=limit * (1 - 1e-9))
    assert round_trip_error(camera) <= PIXEL_TOLERANCE
    assert 2 * off_axis_deg(camera, (101, 50.5)) == pytest.approx(limit, rel=2e-9)
    with pytest.raises(ArgumentError, match=r"^fov_deg: expected a finite number > 0 and < "):
        cameras.create("catadioptric-hyperbolic", **SQUARE, **mirror, fov_deg=limit * (1 + 1e-9))


ACROSS = 100
EDGE = np.array([ACROSS, ACROSS / 2])  # the last pixel of the image circle, to the right


def create(name, fov_deg, **own):
    return cameras.create(name, width=ACROSS, height=ACROSS, fov_deg=fov_deg, **own)


def off_axis_deg(camera, pixel):
    """Return the angle of a pixel's ray from -z, the direction of the image's middle."""
    x, y, z = camera.unproject(np.array(pixel)).directions
    return np.degrees(np.arctan2(np.hypot(x, y), -z))


@cases(15)
@given(st.floats(0.001, 0.999), st.floats(-2, 2), st.floats(-2, 2))
def test_the_last_ray_of_a_ball(part, size, away):
    radius = 10**size
    distance = 10**away
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
    for fov_deg in (120, 240, np.nan):
        with pytest.raises(ValueError, match=r"^fov_deg: expected a finite number > 120 and < 240, got"):
            create("noncentral-conical-mirror", fov_deg, **CONE)
    assert create("noncentral-conical-mirror", np.nextafter(240, 0), **CONE).valid(EDGE - (1e-6, 0))
    narrow = create("noncentral-conical-mirror", np.nextafter(120, 360), **CONE)
    assert off_axis_deg(narrow, EDGE - (1e-6, 0)) == pytest.approx(60)
