"""The two forms of a pinhole's parameters, and parameters that lenses refuse."""

import numpy as np
import pytest

from omniscv import cameras
from omniscv.errors import ArgumentError

SIZE = {"width": 64, "height": 48}


def test_one_focal_length_is_described_by_focal_and_center():
    described = {"model": "pinhole", **SIZE, "focal": 30.0, "center": [10.0, 40.0]}
    camera = cameras.from_dict(described)
    assert camera.to_dict() == described
    assert camera == cameras.create("pinhole", **SIZE, fx=30, fy=30, cx=10, cy=40, distortion=[0.0] * 5)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.skew) == (30, 30, 10, 40, 0)
    wide = cameras.create("pinhole", **SIZE, fov_deg=90)
    assert wide.to_dict() == {"model": "pinhole", **SIZE, "focal": wide.focal, "center": [32.0, 24.0]}
    assert wide.focal == pytest.approx(32, rel=1e-15)


def test_the_field_of_view_limits_a_pinhole_of_two_focal_lengths():
    """The cone of 60 degrees ends at tan(30 degrees) f; given alone it spans the image's width."""
    camera = cameras.create("pinhole", **SIZE, fx=30.0, fy=30.0, fov_deg=60)
    r = 30 * np.tan(np.radians(30))
    np.testing.assert_array_equal(camera.valid([(32 + r - 1e-9, 24), (32 + r + 1e-9, 24)]), [True, False])


FOCALS = {"fx": 30.0, "fy": 30.0}
REFUSED = [
    ("pinhole", {"focal": 30, "fov_deg": 60}, "focal: expected focal or fov_deg, got both"),
    ("pinhole", {"focal": 30, **FOCALS}, "focal: expected focal, or fx and fy, got focal = 30, fx = 30"),
    ("pinhole", {"fx": 30}, "focal: expected focal, or fx and fy, got fx = 30"),
    ("pinhole", {"center": (1, 2), "cx": 1}, "center: expected it or cx and cy, got both"),
    ("pinhole", {"distortion": [0.1] * 14}, "distortion: expected 4, 5, 8 or 12 numbers .*got 14"),
    ("pinhole", {"distortion": 0.1}, "distortion: expected finite numbers"),
    ("pinhole", {"width": 10**400}, "width: expected a whole number of pixels <= 1000000"),
    ("pinhole", {"fx": 0, "fy": 1}, "fx: expected a finite number > 0, got 0"),
    ("ftheta", {"polynomial": [0.1, 30]}, r"polynomial: expected \(0, c1, c2, ...\) with c1 > 0, got"),
    ("ftheta", {"polynomial": [0, -30]}, r"polynomial: expected \(0, c1, c2, ...\) with c1 > 0, got"),
    ("ftheta", {"polynomial": [0, 30], "linear": (0.2, 0.2, 1)}, "linear: expected c - d e further from 0"),
    ("ftheta", {"polynomial": [0, 30], "max_angle_deg": 181}, "max_angle_deg: expected .* <= 180, got 181"),
    ("ftheta", {"polynomial": [0, 30], "reference": "up"}, "reference: expected one of angle-to-pixel"),
    ("double-sphere", {**FOCALS, "xi": 0, "alpha": 1.1}, "alpha: expected .* >= 0 and <= 1, got 1.1"),
    ("extended-unified", {**FOCALS, "alpha": 0.5, "beta": 0}, "beta: expected a finite number > 0, got 0"),
    ("unified", {**FOCALS, "xi": -1}, "xi: expected a finite number > -1, got -1"),
    ("unified", {**FOCALS, "xi": 1, "distortion": (1, 2)}, "distortion: expected 4 finite numbers"),
    ("fisheye624", {**FOCALS, "k": (1, 2, 3, 4)}, "k: expected 6 finite numbers"),
    ("division", {"focal": 30, "k": "much"}, "k: expected a finite number, got 'much'"),
    ("scaramuzza", {"coefficients": (0.0, 0, 1e-3)}, r"coefficients\[0\]: expected a finite number < 0"),
    ("scaramuzza", {"coefficients": (5e-324, 0, 1e-3)}, r"coefficients\[0\]: expected a finite number < 0"),
]


@pytest.mark.parametrize(("name", "arguments", "message"), REFUSED)
def test_parameters_outside_their_domain_are_refused(name, arguments, message):
    with pytest.raises(ArgumentError, match=f"^{message}"):
        cameras.create(name, **SIZE | arguments)
