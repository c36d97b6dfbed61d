"""Fields of view at a model's limit, and one unit in the last place beyond it.

Story. At the limit a focal length divides by tan(90 deg), sin(180 deg) or pi - phi, of which float64 keeps
16 digits of something else: 360 deg in radians is not 2 pi. One ulp further the formulas still return
numbers, of a lens that cannot be. So the limit itself must work (or, where the model does not reach it, the
last number before it), and the next number must be refused, by name, with the limit and the value.
"""

import numpy as np
import pytest

from omniscv import cameras
from omniscv.errors import ArgumentError
from omniscv.testing.cameras import PIXEL_TOLERANCE, round_trip_error

SQUARE = {"width": 101, "height": 101}
KB = {"fx": 12.0, "fy": 12.0}
POLYNOMIAL = {"coefficients": (-20.0, 0, 0.012)}
# model, parameter, limit in degrees, whether the limit itself is served, other arguments
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
limits = pytest.mark.parametrize(("name", "key", "limit", "served", "others"), LIMITS)


def last_fov(limit, served):
    """The last number that the model serves."""
    return float(limit) if served else float(np.nextafter(limit, 0))


@limits
def test_one_ulp_beyond_is_refused(name, key, limit, served, others):
    beyond = float(np.nextafter(last_fov(limit, served), np.inf))
    sign = "<=" if served else "<"
    with pytest.raises(
        ArgumentError, match=rf"^{key}: expected a finite number > 0 and {sign} {limit}, got {beyond!r}$"
    ):
        cameras.create(name, **SQUARE, **others, **{key: beyond})


def test_no_lens_takes_focal_length_and_field_of_view():
    wanted = r"^focal: expected focal or fov_deg, got both \(50 px and 90 deg\)"
    for name in (name for name, key, _, _, others in LIMITS if key == "fov_deg" and not others):
        with pytest.raises(ArgumentError, match=wanted):
            cameras.create(name, **SQUARE, focal=50, fov_deg=90)


@pytest.mark.parametrize(("distance", "semi_latus_rectum"), [(1.0, 0.5), (0.01, 3.0), (1000.0, 0.001)])
def test_the_hyperboloids_limit_is_that_of_its_asymptote(distance, semi_latus_rectum):
    """It depends on the mirror: 360 deg less twice the asymptote's angle with the axis, b / a = tan.

    The rays of the mirror's far rim run along the line from the inner focus parallel to the asymptote.
    """
    make = {"distance": distance, "semi_latus_rectum": semi_latus_rectum}
    a = (np.hypot(distance, semi_latus_rectum) - semi_latus_rectum) / 2
    limit = 360 - 2 * np.degrees(np.arctan2(np.sqrt(semi_latus_rectum * a), a))
    camera = cameras.create("catadioptric-hyperbolic", **SQUARE, **make, fov_deg=limit * (1 - 1e-9))
    assert round_trip_error(camera) <= PIXEL_TOLERANCE
    rim = camera.unproject(np.array([101, 50.5])).directions
    np.testing.assert_allclose(2 * np.degrees(np.arctan2(rim[0], -rim[2])), limit, rtol=2e-9)
    with pytest.raises(ArgumentError, match=r"^fov_deg: expected a finite number > 0 and < "):
        cameras.create("catadioptric-hyperbolic", **SQUARE, **make, fov_deg=limit * (1 + 1e-9))


@pytest.mark.parametrize(
    ("name", "others"), [(name, others) for name, key, *_, others in LIMITS if key == "fov_deg"]
)
def test_points_beyond_the_field_of_view_are_not_seen(name, others):
    """To 1e-9 of the angle, on either side of its edge, all around."""
    camera = cameras.create(name, **SQUARE, **others, fov_deg=100)
    ahead = -1 if name.startswith("catadioptric") else 1
    azimuth = np.linspace(-np.pi, np.pi, 25) if name != "pinhole" else np.zeros(1)
    around = np.stack([np.cos(azimuth), np.sin(azimuth), np.full_like(azimuth, ahead)], axis=-1)
    for part, seen in ((1 - 1e-9, True), (1 + 1e-9, False)):
        angle = np.radians(50) * part
        points = around * [np.sin(angle), np.sin(angle), np.cos(angle)]
        assert (camera.project(points)[1] == seen).all()
