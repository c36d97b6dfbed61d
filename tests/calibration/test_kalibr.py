"""Kalibr's camchain, judged by cv2.fisheye and by Mei's model written from its definition."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from mpmath import mp, mpf
from support.lens_formulas import FORMULAS
from support.same_rays import assert_same_rays

from omniscv import calibration, cameras
from omniscv.errors import ArgumentError

SIZE = {"width": 61, "height": 48}
MIRRORS = [
    cameras.create("catadioptric-planar", **SIZE, focal=40.0),
    cameras.create("catadioptric-parabolic", **SIZE, semi_latus_rectum=0.03, focal=700.0, center=(30, 25.5)),
    cameras.create("catadioptric-hyperbolic", **SIZE, distance=0.1, semi_latus_rectum=0.06, focal=40.0),
    cameras.create("catadioptric-hyperbolic", **SIZE, distance=3.0, semi_latus_rectum=0.1, fov_deg=200),
]


def entry(camera: cameras.Camera) -> dict[str, Any]:
    return dict(yaml.safe_load(calibration.dumps({"cam0": camera}, "kalibr"))["cam0"])


def chain(model: str, intrinsics: list[float], distortion: str = "none", k: Sequence[float] = ()) -> str:
    return yaml.safe_dump(
        {
            "cam0": {
                "camera_model": model,
                "intrinsics": [float(value) for value in intrinsics],
                "distortion_model": distortion,
                "distortion_coeffs": list(k),
                "resolution": [61, 48],
                "rostopic": "/cam0/image_raw",
                "T_cam_imu": np.eye(4).tolist(),
            }
        }
    )


def mei(intrinsics: list[float], direction: np.ndarray) -> list[float]:
    """Mei's projection in 50 digits: onto the unit sphere, then from the point xi behind its centre."""
    with mp.workdps(50):
        xi, fu, fv, pu, pv = map(mpf, intrinsics)
        x, y, z = map(mpf, direction.tolist())
        length = mp.sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        return [float(pu + fu * x / (z + xi)), float(pv + fv * y / (z + xi))]


def assert_mei_sees_our_pixels(intrinsics: list[float], camera: cameras.Camera, R_mei_c: np.ndarray) -> None:
    np.testing.assert_array_equal(R_mei_c @ R_mei_c.T, np.eye(3))
    assert np.linalg.det(R_mei_c) == 1  # a frame, not a reflection of the world
    rays = camera.unproject()
    pixels, directions = camera.pixels()[rays.valid][::7], rays.directions[rays.valid][::7]
    assert len(pixels) > 100
    theirs = np.array([mei(intrinsics, R_mei_c @ direction) for direction in directions])
    # A direction's last place is 1e-16, and worth focal * (1 + xi) / (z + xi)^2 px, here up to 1e5.
    np.testing.assert_allclose(theirs, pixels - 0.5, rtol=0, atol=1e-9)


@pytest.mark.parametrize("camera", MIRRORS, ids=lambda camera: camera.name)
def test_a_mirror_is_meis_model_half_a_turn_about_x(camera: cameras.Camera) -> None:
    numbers = entry(camera)
    assert (numbers["camera_model"], numbers["distortion_model"]) == ("omni", "none")
    assert_mei_sees_our_pixels(numbers["intrinsics"], camera, np.diag([1, -1, -1]))
    again = calibration.loads(calibration.dumps({"cam0": camera}, "kalibr"), "kalibr")["cam0"]
    assert again.name == camera.name
    assert_same_rays(camera, again)


@pytest.mark.parametrize(
    ("turn", "xi"),
    [((1, -1, -1), xi) for xi in (0.0, 1e-3, 0.7, 0.9999, 1.0)]
    + [((-1, 1, -1), xi) for xi in (0.0, 0.7, 1.0)]
    + [((1, 1, 1), xi) for xi in (0.0, 0.7, 1.3)],
)
def test_one_negative_focal_length_makes_a_mirror(turn: tuple[int, ...], xi: float) -> None:
    intrinsics = [xi, 30.0 * turn[0], 30.0 * turn[1], 29.5, 23.25]
    camera = calibration.loads(chain("omni", intrinsics), "kalibr")["cam0"]
    assert camera.name.startswith("catadioptric-" if -1 in turn else "unified")
    assert_mei_sees_our_pixels(intrinsics, camera, np.diag(turn))


RADTAN = [-0.05, 0.01, 1e-3, -2e-3]
LENSES = {
    "pinhole-radtan": ("pinhole", {"distortion": np.array(RADTAN + [0.0] * 8)}),
    "omni-radtan": ("unified", {"xi": 0.9, "distortion": np.array(RADTAN)}),
    "eucm-none": ("extended-unified", {"alpha": 0.6, "beta": 1.1}),
    "ds-none": ("double-sphere", {"xi": -0.2, "alpha": 0.6}),
}


@pytest.mark.parametrize("name", LENSES)
def test_pixels_are_kalibrs_plus_half_a_pixel(name: str) -> None:
    """By the definitions of the models' papers."""
    (formula, own), (model, distortion) = LENSES[name], name.split("-")
    focals = {"fx": 20.0, "fy": 21.0, "cx": 29.5, "cy": 23.25}
    values = [*(value for value in own.values() if isinstance(value, float)), *focals.values()]
    k = RADTAN if distortion == "radtan" else []
    camera = calibration.loads(chain(model, values, distortion, k), "kalibr")["cam0"]
    rays = camera.unproject()
    assert np.count_nonzero(rays.valid) > 500
    theirs = SimpleNamespace(skew=0.0, **own, **focals)
    with mp.workdps(30):
        projected = [
            FORMULAS[formula](theirs, *map(mpf, ray)) for ray in rays.directions[rays.valid][::7].tolist()
        ]
    expected = camera.pixels()[rays.valid][::7] - 0.5
    np.testing.assert_allclose(np.array(projected, float), expected, rtol=0, atol=1e-9)
    text = calibration.dumps({"cam0": camera}, "kalibr")
    assert (entry(camera)["camera_model"], entry(camera)["distortion_model"]) == (model, distortion)
    assert_same_rays(camera, calibration.loads(text, "kalibr")["cam0"])


def test_a_hyperboloid_that_xi_does_not_tell_from_a_paraboloid_is_refused() -> None:
    """Its xi is 1 in 53 bits; read back it would be a paraboloid, which sees where this mirror has ended."""
    camera = cameras.create("catadioptric-hyperbolic", **SIZE, distance=1.0, semi_latus_rectum=1e-9)
    with pytest.raises(ArgumentError, match="xi rounds to 1"):
        calibration.dumps({"cam0": camera}, "kalibr")


def test_a_chain_keeps_its_names() -> None:
    text = calibration.dumps({"cam1": MIRRORS[0], "cam0": MIRRORS[1]}, "kalibr")
    assert {name: camera.name for name, camera in calibration.loads(text, "kalibr").items()} == {
        "cam1": "catadioptric-planar",
        "cam0": "catadioptric-parabolic",
    }
    with pytest.raises(ArgumentError, match="cam0, cam1"):
        calibration.dumps({"left": MIRRORS[0]}, "kalibr")
