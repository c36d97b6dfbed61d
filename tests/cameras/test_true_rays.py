"""Central models against their formulas in 50 digits; calibrated ones are judged in ``tests/calibration``."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.cases import cases
from support.mirrors import DIGITS, bounce, hyperboloid, paraboloid, plane

from omniscv import cameras

SIZE = {"width": 400, "height": 400}
RADIUS = 200.0
EPS = 2.3e-16


def of(name, truth, **drawn):
    """Cameras of a model with the function of their rays by pixels, px off the centre; None: no ray."""
    return st.builds(
        lambda given: (cameras.create(name, **SIZE, **given), truth), st.fixed_dictionaries(drawn)
    )


def lens(phi_of):
    """A lens by its angle of t = r / f."""

    def truth(camera, x, y):
        r = mp.hypot(x, y)
        phi = mp.re(phi_of(r / mp.mpf(camera.focal)))
        return [mp.sin(phi) * x / r, mp.sin(phi) * y / r, mp.cos(phi)] if r else [0, 0, 1]

    return truth


def cylinder(camera, x, y):
    spans = [
        mp.radians(camera.parameters().get(key, deg)) for key, deg in (("fov_h_deg", 360), ("fov_v_deg", 180))
    ]
    azimuth = spans[0] * x / camera.width
    up = -spans[1] * y / camera.height
    if camera.parameters().get("profile") == "perspective":
        up = -mp.atan(2 * y / camera.height * mp.tan(spans[1] / 2))
    return [mp.cos(up) * mp.sin(azimuth), -mp.sin(up), mp.cos(up) * mp.cos(azimuth)]


def mirror(body):
    def truth(camera, x, y):
        f = mp.mpf(camera.focal)
        seen = bounce(body(camera), x / f, y / f)
        return seen and seen[1]

    return truth


def hyperbolic(q, d, spread):
    """Its camera rays miss the mirror from a radius on; the image reaches to some times that."""
    edge = np.sqrt(2 * q * (np.hypot(d, q) + q)) / d
    return {"semi_latus_rectum": q, "distance": d, "focal": RADIUS / (spread * edge)}


def fields(most):
    return st.one_of(st.floats(1, most), st.floats(-12, 0).map(lambda e: most - 10**e))


scales = st.floats(-2, 2).map(lambda e: 10**e)
# 1 cm to 100 m; and mirrors as long and as flat as float64 has them: xi rounds to 1 from q / d = 1e-8 on.
metres = st.one_of(scales, st.floats(-7.5, 7.5).map(lambda e: 10**e))
hyperboloid_of = mirror(lambda camera: hyperboloid(camera.distance, camera.semi_latus_rectum))
CASES = {
    "equidistant": of("fisheye-equidistant", lens(lambda t: t), fov_deg=fields(360)),
    "stereographic": of("fisheye-stereographic", lens(lambda t: 2 * mp.atan(t / 2)), fov_deg=fields(359.9)),
    "orthographic": of("fisheye-orthographic", lens(mp.asin), fov_deg=fields(180)),
    "equisolid": of("fisheye-equisolid", lens(lambda t: 2 * mp.asin(t)), fov_deg=fields(360)),
    "pinhole": of("pinhole", lambda camera, x, y: [x, y, mp.mpf(camera.focal)], fov_deg=fields(170)),
    "equirectangular": of("equirectangular", cylinder),
    "angular": of("cylindrical", cylinder, fov_h_deg=fields(360), fov_v_deg=fields(180)),
    "perspective": of(
        "cylindrical", cylinder, fov_h_deg=fields(360), fov_v_deg=fields(170), profile=st.just("perspective")
    ),
    "parabolic": of(
        "catadioptric-parabolic", mirror(lambda camera: paraboloid(camera.semi_latus_rectum)),
        semi_latus_rectum=metres, focal=metres,
    ),
    "hyperbolic": st.builds(hyperbolic, metres, metres, scales).map(
        lambda given: (cameras.create("catadioptric-hyperbolic", **SIZE, **given), hyperboloid_of)
    ),
    "planar": of("catadioptric-planar", mirror(lambda _: plane(1)), focal=scales.map(lambda x: RADIUS / x)),
}  # fmt: skip
hair = st.floats(-16, 0).map(lambda e: 10**e)
part = st.one_of(st.floats(0, 1), hair, hair.map(lambda x: 1 - x))  # anywhere, next to 0 and next to 1


@pytest.mark.parametrize("name", CASES)
@cases(15)
@given(st.data(), part, st.floats(-np.pi, np.pi))
def test_rays(name, data, part, azimuth):
    """As exact as the pixel's own radius; where a mirror is missed there is none."""
    camera, truth = data.draw(CASES[name])
    pixel = camera.center + part * RADIUS * (1 - 1e-14) * np.array([np.cos(azimuth), np.sin(azimuth)])
    rays = camera.unproject(pixel)
    with mp.workdps(DIGITS):
        x, y = (mp.mpf(p) - mp.mpf(c) for p, c in zip(pixel.tolist(), camera.center.tolist(), strict=True))
        found = [truth(camera, k * x, k * y) for k in (1, 1 + 100 * mp.mpf(EPS), 1 - 100 * mp.mpf(EPS))]
        assume(len({each is None for each in found}) == 1)  # not on the mirror's very edge
        assert rays.valid == (found[0] is not None)
        if rays.valid:
            ray, more, less = (mp.matrix(each) / mp.norm(mp.matrix(each)) for each in found)
            off = mp.norm(mp.matrix([mp.mpf(v) for v in rays.directions.tolist()]) - ray)
            assert off <= 4 * mp.norm(more - less) / 100 + 4 * EPS


def test_fisheyes_have_180_degrees_by_default():
    for name in ("equidistant", "stereographic", "orthographic", "equisolid"):
        camera = cameras.create(f"fisheye-{name}", **SIZE)
        assert camera == cameras.create(f"fisheye-{name}", **SIZE, fov_deg=180)


def test_orthographic_sees_sideways_but_not_behind():
    """z = 0 is the rim; one denormal behind it is out of sight."""
    camera = cameras.create("fisheye-orthographic", width=512, height=512, focal=200)
    points = np.array([[1, 0, 0.0], [1, 0, -0.0], [0, -1, 5e-324], [0.6, 0.8, 1e-300], [1, 0, -5e-324]])
    pixels, seen = camera.project(points)
    np.testing.assert_array_equal(seen, (True, True, True, True, False))
    np.testing.assert_allclose(np.linalg.norm(pixels[:4] - camera.center, axis=1), 200, rtol=0, atol=1e-10)
