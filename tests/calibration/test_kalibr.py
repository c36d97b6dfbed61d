"""Kalibr's camchain, judged by its models as their papers define them."""

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


def test_a_chain_keeps_its_names() -> None:
    first, second = cameras.Pinhole(61, 48), cameras.Unified(61, 48, 40.0, 40.0, xi=0.7)
    text = calibration.dumps({"cam1": first, "cam0": second}, "kalibr")
    again = calibration.loads(text, "kalibr")
    assert {name: camera.name for name, camera in again.items()} == {"cam1": "pinhole", "cam0": "unified"}
    with pytest.raises(ArgumentError, match="cam0, cam1"):
        calibration.dumps({"left": first}, "kalibr")
    for mirror in ("planar", "parabolic", "hyperbolic"):  # whose pictures Kalibr has no model of
        camera = cameras.model(f"catadioptric-{mirror}").example(64)
        with pytest.raises(ArgumentError, match=f"got catadioptric-{mirror}"):
            calibration.dumps({"cam0": camera}, "kalibr")
    with pytest.raises(ArgumentError, match="fy: expected a finite number >= 0"):  # a mirror of others
        calibration.loads(chain("omni", [0.7, 30.0, -30.0, 29.5, 23.25]), "kalibr")
