"""``project`` of the non-central models: the inverse of ``unproject``, and no pixel where none sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

SIZE = 100
metres = st.floats(-2, 2).map(lambda e: 10**e)  # 1 cm to 100 m
far = st.floats(0, 9).map(lambda e: 10**e)
unit = st.floats(0, 1)
half_angle = st.one_of(  # a needle, a plate
    st.floats(1, 89), st.floats(-9, 0).map(lambda e: 10**e), st.floats(-12, 0).map(lambda e: 90 - 10**e)
)
panorama = st.builds(lambda r: create("noncentral-panorama", radius=r), metres)
cone = st.builds(
    lambda tau, d: create("noncentral-conical-mirror", half_angle_deg=tau, distance=d), half_angle, metres
)
ball = st.builds(
    lambda r, d: create("noncentral-spherical-mirror", mirror_radius=r, distance=d), metres, metres
)


def create(name, **parameters):
    return cameras.create(name, width=SIZE, height=SIZE, **parameters)


def scale(camera):
    """The model's largest length, metres."""
    return max(camera.parameters().get(key) or 0.0 for key in ("radius", "distance", "mirror_radius"))


def start(camera, pixel, rays):
    """Where on a ray, metres from its origin, the light comes in free: beyond the mirror's surface."""
    if camera.name != "noncentral-conical-mirror":
        return 3 * scale(camera)
    r, slope = np.linalg.norm(pixel - camera.center) / camera.focal, np.tan(np.radians(camera.half_angle_deg))
    z_hit = camera.distance * slope / (slope - r)
    return 1.001 * r * z_hit / np.hypot(*rays.directions[:2])


def last_radius(camera):
    """Return the largest radius, px, of valid pixels, less a few last digits of a pixel, by bisection."""
    low, high = 0.0, float(camera.width)
    for _ in range(200):
        middle = np.sqrt(low) * np.sqrt(high) if low else high / 2
        inside = camera.valid(camera.center + np.array([middle, 0.0]))
        low, high = (middle, high) if inside else (low, middle)
    return float(low - 4 * np.spacing(low + np.abs(camera.center).max()))


@cases(25)
@given(st.one_of(panorama, cone, ball), st.floats(-np.pi, np.pi), unit, far)
def test_a_point_on_a_ray_is_seen_by_its_pixel(camera, azimuth, part, away):
    """Pixels anywhere between the centre and the last one; points from beside the mirror to 1e9 m."""
    reach = last_radius(camera)
    pixel = camera.center + part * reach * (1 - 1e-12) * np.array([np.cos(azimuth), np.sin(azimuth)])
    rays = camera.unproject(pixel)
    if not rays.valid:
        assert camera.name == "noncentral-conical-mirror"
        assert np.linalg.norm(pixel - camera.center) < 1e-12  # the tip
        return
    seen, valid = camera.project(rays.origins + start(camera, pixel, rays) * away * rays.directions)
    assert valid
    np.testing.assert_allclose(seen, pixel, rtol=0, atol=1e-9)  # the contract asks 1e-6


CONE = ("noncentral-conical-mirror", {"half_angle_deg": 60, "distance": 0.3})
BALL = ("noncentral-spherical-mirror", {"mirror_radius": 0.5, "distance": 0.3})


def test_the_panorama_at_radius_0_is_the_equirectangular_to_the_bit():
    still = cameras.create("noncentral-panorama", width=65, height=33, radius=0)
    plain = cameras.create("equirectangular", width=65, height=33)
    for part in ("directions", "origins"):
        np.testing.assert_array_equal(getattr(still.unproject(), part), getattr(plain.unproject(), part))
    points = np.random.default_rng(0).normal(size=(10_000, 3)) * np.logspace(-9, 9, 10_000)[:, None]
    points[:5] = (0, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, -1), (-0.0, 0, -1)
    for ours, theirs in zip(still.project(points), plain.project(points), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_panorama_rays_never_enter_the_cylinder_of_their_circle():
    camera = cameras.create("noncentral-panorama", width=SIZE, height=SIZE, radius=1.0)
    points = np.array([[0.5, 0, 0.5], [0, 3, 0], [0.9999, -7, 0], [0, 0, 0]])
    assert not camera.project(points)[1].any()
    pixels, valid = camera.project(np.array([[0, -2, 1], [0, 2, 1], [0, 0, 1], [0, 0, 1 + 1e-9]]))
    np.testing.assert_array_equal(valid, (True, True, False, True))
    np.testing.assert_array_equal(pixels[[0, 1, 3]], [[50, 0], [50, 100], [50, 50]])


@pytest.mark.parametrize(("name", "parameters"), [("noncentral-panorama", {"radius": 0.5}), CONE, BALL])
def test_points_on_the_axis(name, parameters):
    """On its axis a mirror ball sees only what is before it, in the middle; the others see nothing."""
    z = np.array([-1e9, -1, 0, 0.1, 0.29, 0.3, 0.31, 0.8, 1.3, 1.31, 1e9])
    points = np.stack([0 * z, 0 * z, z], axis=-1)
    if name == "noncentral-panorama":
        points = points[:, [0, 2, 1]]
    pixels, valid = create(name, **parameters).project(points)
    np.testing.assert_array_equal(valid, (z <= 0.3) & (name == "noncentral-spherical-mirror"))
    assert (pixels[valid] == SIZE / 2).all()
