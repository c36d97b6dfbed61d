"""Any camera, any pixel, any point: drawn near the places where models fail.

Sizes from 1 px, centres beside the image, parameters over the whole of their domains up to the last number;
pixels at corners, next to the rim and to the centre; points next to the axes, far and near.
"""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from examples import takes_center
from omniscv import cameras
from omniscv.testing.cameras import PIXEL_TOLERANCE, check_projection


def up_to(limit, closed):
    """(0, limit), as often as not within a few last digits of the limit; itself only where it is in."""
    last = float(limit) if closed else float(np.nextafter(limit, 0))
    near = st.floats(-14, 0).map(lambda e: min(limit - limit * 10**e, last)).filter(lambda x: x > 0)
    return st.one_of(st.floats(1e-3, last), near, st.just(last))


positive = st.floats(-6, 6).map(lambda e: 10**e)
size = st.one_of(st.integers(1, 4), st.integers(1, 400))
place = st.one_of(st.none(), st.tuples(st.floats(-50, 450), st.floats(-50, 450)))


def model(name, **parameters):
    """Cameras of a model, of any size, with centres beside the image, too, where it takes one."""
    sizes = {"width": size, "height": size}
    if takes_center(name) == ("center",):
        sizes["center"] = place
    return st.fixed_dictionaries({**sizes, **parameters}).map(lambda given: cameras.create(name, **given))


focals = {"fx": st.floats(1, 300), "fy": st.floats(1, 300)}
small = st.floats(-0.1, 0.1)
central = st.one_of(
    model("equirectangular"),
    model("cylindrical", fov_h_deg=up_to(360, True), fov_v_deg=up_to(180, True)),
    model("cylindrical", fov_v_deg=up_to(180, False), profile=st.just("perspective")),
    model("fisheye-equidistant", fov_deg=up_to(360, True)),
    model("fisheye-stereographic", fov_deg=up_to(360, False)),
    model("fisheye-orthographic", fov_deg=up_to(180, True)),
    model("fisheye-equisolid", fov_deg=up_to(360, True)),
    model("fisheye-orthographic", focal=positive),
    model("fisheye-equisolid", focal=positive),
    # Nearer to 360 degrees most directions lie within the rounding of the image's centre.
    model("catadioptric-parabolic", semi_latus_rectum=positive, fov_deg=up_to(359.99, True)),
    model("catadioptric-hyperbolic", semi_latus_rectum=positive, distance=positive),
    model("catadioptric-planar", fov_deg=up_to(180, False)),
    model("kannala-brandt", fx=st.floats(1, 300), fy=st.floats(1, 300), k=st.tuples(*[st.floats(-1, 1)] * 4)),
    model("pinhole", fov_deg=up_to(180, False)),
    model("pinhole", **focals, skew=small, distortion=st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8)),
    model("pinhole", **focals, distortion=st.lists(small, min_size=12, max_size=12)),
    model("fisheye624", **focals, k=st.tuples(*[st.floats(-0.3, 0.3)] * 6), s=st.tuples(*[small] * 4)),
    model("double-sphere", **focals, xi=up_to(2, True).map(lambda x: x - 1), alpha=up_to(1, True)),
    model("extended-unified", **focals, alpha=up_to(1, True), beta=st.floats(-3, 3).map(lambda e: 10**e)),
    model("unified", **focals, xi=st.floats(-0.99, 5), distortion=st.tuples(*[small] * 4)),
    model("division", focal=st.floats(1, 300), k=st.floats(-10, 10)),
    model("field-of-view", **focals, omega=st.floats(1e-3, 3.1)),
    model("ftheta", polynomial=st.tuples(st.just(0), st.floats(1, 300), *[st.floats(-50, 50)] * 4)),
)
metres = st.floats(-2, 2).map(lambda e: 10**e)  # 1 cm to 100 m
noncentral = st.one_of(
    model("noncentral-panorama", radius=metres),
    model("noncentral-conical-mirror", half_angle_deg=st.floats(1, 89), distance=metres),
    model("noncentral-spherical-mirror", mirror_radius=metres, distance=metres),
)
hair = st.floats(-16, 0).map(lambda e: 10**e)
coordinate = st.one_of(
    st.floats(-3, 3, allow_subnormal=False),
    hair,
    hair.map(lambda x: -x),
    hair.map(lambda x: 1 - x),
    st.floats(-1e150, 1e150, allow_subnormal=False),
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e9, -1e9, 1e-300]),
)
points = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=30).map(np.array)
part = st.one_of(st.floats(0, 1), hair, hair.map(lambda x: 1 - x))
place_in_image = st.lists(st.tuples(part, part, st.floats(-4, 4)), min_size=1, max_size=30).map(np.array)


@cases(20)
@given(st.one_of(central, noncentral), points)
def test_no_point_gets_a_wrong_pixel(camera, points):
    check_projection(camera, points)


@cases(20)
@given(central, place_in_image, st.floats(-9, 9))
def test_every_pixel_comes_back(camera, places, exponent):
    """Pixels next to the edges of the image, and next to the rim and the centre of the image circle."""
    circle = min(camera.width, camera.height) / 2 * places[:, :1]
    around = np.stack([np.cos(places[:, 2]), np.sin(places[:, 2])], axis=-1)
    pixels = np.concatenate([places[:, :2] * (camera.width, camera.height), camera.center + circle * around])
    rays = camera.unproject(pixels)
    again, seen = camera.project(10**exponent * rays.directions[rays.valid])
    assert seen.all()
    np.testing.assert_allclose(again, pixels[rays.valid], rtol=0, atol=PIXEL_TOLERANCE)
