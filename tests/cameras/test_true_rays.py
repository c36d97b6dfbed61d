"""Central models against their published formulas in 50 digits, to a few roundings.

Formulas give the ray of a pixel; mirrors are bodies that light bounces off. That ``project`` is the inverse
of ``unproject``, the contract holds; calibrated lenses are judged by the programs of ``tests/calibration``.
"""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.cases import cases
from support.mirrors import DIGITS, bounce, hyperboloid, paraboloid, plane

from omniscv import cameras

SIZE, RADIUS = {"width": 400, "height": 400}, 200.0
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
    azimuth, up = spans[0] * x / camera.width, -spans[1] * y / camera.height
    if camera.parameters().get("profile") == "perspective":
        up = -mp.atan(2 * y / camera.height * mp.tan(spans[1] / 2))
    return [mp.cos(up) * mp.sin(azimuth), -mp.sin(up), mp.cos(up) * mp.cos(azimuth)]


def scaramuzza(camera, x, y):
    """(u'', v'', -f(rho)) by ``u = u_0 + c u'' + d v''``, ``v = v_0 + e u'' + v''``: Cramer's rule."""
    c, d, e = map(mp.mpf, camera.affine.tolist())
    across = [(x - d * y) / (c - d * e), (c * y - e * x) / (c - d * e)]
    rho = mp.hypot(*across)
    return [*across, -sum(mp.mpf(a) * rho**i for i, a in enumerate(camera.coefficients.tolist()))]


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
    "a lens of 190 degrees": of(
        "scaramuzza", scaramuzza,
        coefficients=st.just((-179.5, 0, 1.9e-3, -3.2e-6, 9.1e-9)), affine=st.just((0.9995, 2e-4, -3e-4)),
    ),
    "sheared, a1 is not 0": of(
        "scaramuzza", scaramuzza, coefficients=st.just((-200.0, 0.05, 2e-3)), affine=st.just((1.3, 0.2, -0.1))
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


@pytest.mark.parametrize(
    ("name", "phi_of", "most"),
    [
        ("fisheye-equidistant", lambda t: t, 360),
        ("fisheye-stereographic", lambda t: 2 * mp.atan(t / 2), 359.9),
        ("fisheye-orthographic", mp.asin, 180),
        ("fisheye-equisolid", lambda t: 2 * mp.asin(t), 360),
        ("pinhole", mp.atan, 179),
    ],
)
@pytest.mark.parametrize("part", [1e-3, 0.3, 1 - 1e-4])
def test_focal_length_follows_the_field_of_view(name, phi_of, most, part):
    """The rim of the image circle, of a pinhole the border of the image, sees ``fov_deg / 2``."""
    camera = cameras.create(name, **SIZE, fov_deg=part * most)
    with mp.workdps(DIGITS):
        found = 2 * mp.degrees(mp.re(phi_of(mp.mpf(RADIUS) / mp.mpf(camera.focal))))
    assert float(found) == pytest.approx(part * most, rel=1e-10)


def test_default_fields_of_view():
    """180 degrees where neither ``focal`` nor ``fov_deg`` is given, for every lens."""
    for name in ("equidistant", "stereographic", "orthographic", "equisolid"):
        camera = cameras.create(f"fisheye-{name}", **SIZE)
        assert camera == cameras.create(f"fisheye-{name}", **SIZE, fov_deg=180)
        assert abs(camera.unproject((400, 200)).directions[2]) <= 3e-8  # orthographic: the root of a rounding


# -- where images end -------------------------------------------------------------------------------


def test_orthographic_sees_sideways_but_not_behind():
    """z = 0 is the rim; one denormal behind it is out of sight."""
    camera = cameras.create("fisheye-orthographic", width=512, height=512, focal=200)
    points = np.array([[1, 0, 0.0], [1, 0, -0.0], [0, -1, 5e-324], [0.6, 0.8, 1e-300], [1, 0, -5e-324]])
    pixels, seen = camera.project(points)
    np.testing.assert_array_equal(seen, (True, True, True, True, False))
    np.testing.assert_allclose(np.linalg.norm(pixels[:4] - camera.center, axis=1), 200, rtol=0, atol=1e-10)


def test_the_cylinder_ends():
    """Directions beyond its field of view are nowhere in the image."""
    camera = cameras.create("cylindrical", width=90, height=90, fov_h_deg=180, fov_v_deg=60)
    h, v = np.radians([[89.9999, 0], [90.0001, 0], [-90.0001, 0], [180, 0], [0, 29.9999], [0, 30.0001]]).T
    rays = np.stack([np.cos(v) * np.sin(h), -np.sin(v), np.cos(v) * np.cos(h)], axis=-1)
    np.testing.assert_array_equal(camera.project(rays)[1], (True, False, False, False, True, False))


def test_nothing_behind_a_pinhole_is_seen():
    camera = cameras.create("pinhole", width=90, height=90)
    points = np.array([[0, 0, -1.0], [0, 0, 0], [0.1, 0.1, -5], [1, 0, 0], [1, 0, -1e-300], [0, 0, 1e-300]])
    np.testing.assert_array_equal(camera.project(points)[1], (False,) * 5 + (True,))
