"""Non-central cameras: mirrors that bounce rays in 50 digits, points and their pixels, centres, lines."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.cases import cases
from support.mirrors import ray_errors, seen_by

from omniscv import cameras

SIZE = 100
FOCAL = 50.0
MIRRORS = {
    "noncentral-conical-mirror": {"half_angle_deg": 60, "distance": 0.3},
    "noncentral-spherical-mirror": {"mirror_radius": 0.5, "distance": 0.3},
}
MODELS = {"noncentral-panorama": {"radius": 1.0}, **MIRRORS}
metres = st.floats(-2, 2).map(lambda e: 10**e)  # 1 cm to 100 m
hair = st.floats(-13, -1).map(lambda e: 10**e)
# Of the last radius.
part = st.one_of(st.floats(1e-13, 1.2), hair, hair.map(lambda x: 1 - x), hair.map(lambda x: 1 + x))
half_angle = st.one_of(
    st.floats(0.5, 89.5),
    st.sampled_from([45.0, float(np.nextafter(45, 0)), float(np.nextafter(45, 90))]),
    hair.map(lambda x: 45 - x),
    hair.map(lambda x: 45 + x),
    st.floats(-9, 0).map(lambda e: 10**e),  # a needle
    st.floats(-12, 0).map(lambda e: 90 - 10**e),  # a plate
)


def create(name, width=SIZE, height=SIZE, **options):
    return cameras.create(name, width=width, height=height, **{**MODELS[name], **options})


def panorama(**options):
    return create("noncentral-panorama", **options)


def ball(**options):
    return create("noncentral-spherical-mirror", **options)


def cone(**options):
    return create("noncentral-conical-mirror", **options)


def check(camera, edge, part, azimuth, tolerance):
    """A pixel at a part of the last radius has the ray that bounces off the mirror, or none beyond the edge.

    The centre is (0, 0), so that pixels are as near to it as one likes; none is on a border to 1e-13.
    """
    pixel = part * min(edge, 1) * FOCAL * np.array([np.cos(azimuth), np.sin(azimuth)])
    r = np.hypot(*pixel) / FOCAL
    assume(min(abs(r / edge - 1), abs(r - 1)) > 5e-14)
    rays = camera.unproject(pixel)
    assert rays.valid == (r < edge and r < 1 and (r > 0 or camera.name == "noncentral-spherical-mirror"))
    if rays.valid:
        assert max(ray_errors(camera, pixel)) <= tolerance(1 - r / edge)
        hit = np.array(seen_by(camera, pixel)[0], dtype=float)
        assert (hit - rays.origins) @ rays.directions > 0  # the light comes in from beyond the mirror


@cases(30)
@given(metres, st.one_of(metres, st.floats(-18, 3).map(lambda e: 10**e)), part, st.floats(0, np.pi / 2))
def test_ball(radius, distance, part, azimuth):
    """A few roundings of 1e-16; towards grazing the ray turns as the root of what is left to the edge."""
    edge = radius / np.sqrt(distance * (distance + 2 * radius))
    camera = ball(mirror_radius=radius, distance=distance, focal=FOCAL, center=(0, 0))
    check(camera, edge, part, azimuth, lambda left: 2e-15 / np.sqrt(max(left, 1e-13)))


@cases(30)
@given(half_angle, metres, part, st.floats(0, np.pi / 2))
def test_cone(half_angle_deg, distance, part, azimuth):
    """A few roundings of 1e-16, no more at 45 degrees or at the edge than anywhere else.

    A cone that is all but flat loses digits of its angle.
    """
    camera = cone(half_angle_deg=half_angle_deg, distance=distance, focal=FOCAL, center=(0, 0))
    edge = np.tan(np.radians(half_angle_deg))
    check(camera, edge, part, azimuth, lambda left: 1e-15 * (1 + 1e-9 * edge))


def test_the_cone_has_no_ray_at_its_tip_and_ends_at_its_rim():
    """The last ring that is served meets the mirror just inside its rim. A ball shows the camera."""
    np.testing.assert_array_equal(ball(center=(0, 0)).unproject((0, 0)).directions, (0, 0, -1))
    camera = cone(mirror_radius=0.2)
    assert (
        camera.valid(camera.center + np.array([(0, 0), (1, 0), (0, -1), (1, 1)])).tolist()
        == [False] + [True] * 3
    )
    u = np.linspace(SIZE / 2, SIZE, 51)[1:]
    served = camera.valid(np.stack([u, np.full_like(u, SIZE / 2)], axis=-1))
    assert served.tolist() == [seen_by(camera, (x, SIZE / 2))[0][0] <= 0.2 for x in u]
    assert served.any()
    assert not served.all()


@pytest.mark.parametrize(
    ("camera", "tip", "half_angle"),
    [
        *((cone(half_angle_deg=deg), 0.3, np.radians(deg)) for deg in (5, 44)),
        (ball(), 0, np.arcsin(0.5 / 0.8)),
    ],
)
def test_no_point_is_found_within_a_cone_or_in_the_shadow_of_a_ball(camera, tip, half_angle):
    z = np.array([1.0, 5.0, 1e6])
    for part, visible in ((1 - 1e-9, False), (1 + 1e-9, True)):
        points = np.stack([(z - tip) * np.tan(half_angle) * part, 0 * z, z], axis=-1)
        assert (camera.project(points)[1] == visible).all()


def start(camera, pixel, rays):
    """Where on a ray, metres from its origin, the light comes in free: beyond the mirror's surface."""
    if camera.name != "noncentral-conical-mirror":
        return 3 * max(camera.parameters().get(key) or 0.0 for key in ("radius", "distance", "mirror_radius"))
    r = np.linalg.norm(pixel - camera.center) / camera.focal
    slope = np.tan(np.radians(camera.half_angle_deg))
    return 1.001 * r * camera.distance * slope / (slope - r) / np.hypot(*rays.directions[:2])


def last_radius(camera):
    """Return the largest radius, px, of valid pixels, less a few last digits of a pixel, by bisection."""
    low, high = 0.0, float(camera.width)
    for _ in range(200):
        middle = np.sqrt(low) * np.sqrt(high) if low else high / 2
        inside = camera.valid(camera.center + np.array([middle, 0.0]))
        low, high = (middle, high) if inside else (low, middle)
    return float(low - 4 * np.spacing(low + np.abs(camera.center).max()))


every_camera = st.one_of(
    st.builds(lambda r: panorama(radius=r), metres),
    st.builds(lambda tau, d: cone(half_angle_deg=tau, distance=d), half_angle, metres),
    st.builds(lambda r, d: ball(mirror_radius=r, distance=d), metres, metres),
)


@cases(25)
@given(every_camera, st.floats(-np.pi, np.pi), st.floats(0, 1), st.floats(0, 9).map(lambda e: 10**e))
def test_a_point_on_a_ray_is_seen_by_its_pixel(camera, azimuth, part, away):
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


def test_the_panorama_at_radius_0_is_the_equirectangular_to_the_bit():
    still = panorama(radius=0)
    plain = cameras.create("equirectangular", width=SIZE, height=SIZE)
    for part in ("directions", "origins"):
        np.testing.assert_array_equal(getattr(still.unproject(), part), getattr(plain.unproject(), part))
    points = np.random.default_rng(0).normal(size=(10_000, 3)) * np.logspace(-9, 9, 10_000)[:, None]
    points[:5] = (0, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, -1), (-0.0, 0, -1)
    for ours, theirs in zip(still.project(points), plain.project(points), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_panorama_rays_never_enter_the_cylinder_of_their_circle():
    points = np.array([[0.5, 0, 0.5], [0, 3, 0], [0.9999, -7, 0], [0, 0, 0]])
    assert not panorama().project(points)[1].any()
    pixels, valid = panorama().project(np.array([[0, -2, 1], [0, 2, 1], [0, 0, 1], [0, 0, 1 + 1e-9]]))
    np.testing.assert_array_equal(valid, (True, True, False, True))
    np.testing.assert_array_equal(pixels[[0, 1, 3]], [[50, 0], [50, 100], [50, 50]])


@pytest.mark.parametrize("name", MODELS)
def test_points_on_the_axis(name):
    """On its axis a mirror ball sees only what is before it, in the middle; the others see nothing."""
    z = np.array([-1e9, -1, 0, 0.1, 0.29, 0.3, 0.31, 0.8, 1.3, 1.31, 1e9])
    points = np.stack([0 * z, 0 * z, z], axis=-1)
    pixels, valid = create(name).project(points[:, [0, 2, 1]] if name == "noncentral-panorama" else points)
    np.testing.assert_array_equal(valid, (z <= 0.3) & (name == "noncentral-spherical-mirror"))
    assert (pixels[valid] == SIZE / 2).all()


def displaced(camera, count):
    """The largest distance, metres, between a pixel's own optical centre and the shared one."""
    rays = camera.unproject()
    views = camera.viewpoints(count)
    return np.nanmax(np.linalg.norm(rays.origins - views.centers[views.index], axis=-1))


def test_panorama_in_equal_steps_of_azimuth():
    """No column is further from its centre than the half step's chord, pi R / K at most."""
    camera = panorama(width=64, height=4)
    views = camera.viewpoints()
    np.testing.assert_array_equal(views.index, np.tile(np.arange(64), (4, 1)))
    np.testing.assert_array_equal(views.centers, camera.unproject().origins[0])
    np.testing.assert_array_equal(panorama(radius=0).viewpoints().centers, np.zeros((1, 3)))
    for count in (1, 5, 63, 64, 1000):
        views = camera.viewpoints(count)
        assert len(views.centers) == min(count, 64)
        sizes = np.bincount(views.index[0])
        assert np.ptp(sizes) <= 1
        assert displaced(camera, count) <= np.pi * sizes.max() / 64
        assert np.hypot(views.centers[:, 0], views.centers[:, 2]).max() <= 1 + 1e-15


@pytest.mark.parametrize("name", MIRRORS)
def test_mirrors_have_a_centre_for_each_ring_of_a_pixel_or_for_steps_of_height(name):
    """In fewer steps no pixel is further off than half of one; out of the image there is none."""
    camera = create(name, 64, 64)
    views = camera.viewpoints()
    valid = camera.valid()
    r = np.linalg.norm(camera.pixels() - camera.center, axis=-1)
    np.testing.assert_array_equal(views.index[valid], np.floor(r[valid]))
    np.testing.assert_array_equal(views.centers[:, :2], 0)
    many = camera.viewpoints(10_000)
    np.testing.assert_array_equal(many.centers, views.centers)
    np.testing.assert_array_equal(many.index, views.index)
    heights = camera.unproject().origins[valid][:, 2]
    for count in (1, 2, 7, 20):
        assert len(camera.viewpoints(count).centers) <= count
        assert displaced(camera, count) <= np.ptp(heights) / count / 2 + 1e-15
    beside = create(name, center=(1e4, 1e4)).viewpoints()
    assert beside.centers.shape == (0, 3)
    assert (beside.index == -1).all()


@pytest.mark.parametrize("name", MODELS)
def test_lines_are_plucker_coordinates(name):
    """Direction and moment are perpendicular, and the moment is the same from any point of the ray."""
    rays = create(name).unproject()
    lines = rays.lines()
    assert lines.shape == (SIZE, SIZE, 6)
    assert np.isnan(lines[~rays.valid]).all()
    direction = lines[rays.valid][:, :3]
    moment = lines[rays.valid][:, 3:]
    np.testing.assert_allclose((direction * moment).sum(axis=1), 0, rtol=0, atol=1e-15)
    further = np.cross(rays.origins[rays.valid] + 5 * direction, direction)
    np.testing.assert_allclose(further, moment, rtol=0, atol=5e-15)  # a 5 m arm's rounding


def test_the_lines_of_a_panorama_are_those_of_the_papers_text():
    """In the paper's frame (Z up, X ahead) from ``R_c (cos theta, sin theta, 0)``, theta to the left.

    The ``R_c sin(phi)`` that it prints in the moment is a central camera's: every line passes (0, 0, -R_c).
    """
    camera = panorama(radius=0.7)
    R_paper_c = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    u, v = np.moveaxis(camera.pixels(), -1, 0)
    theta = -(2 * u / SIZE - 1) * np.pi
    phi = v / SIZE * np.pi
    xi = np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)], axis=-1)
    moment = 0.7 * np.stack([np.sin(theta), -np.cos(theta), 0 * theta], axis=-1)
    expected = np.concatenate([xi, np.cos(phi)[..., None] * moment], axis=-1)
    lines = camera.unproject().lines().reshape(SIZE, SIZE, 2, 3) @ R_paper_c.T
    np.testing.assert_allclose(lines.reshape(expected.shape), expected, rtol=0, atol=1e-13)
