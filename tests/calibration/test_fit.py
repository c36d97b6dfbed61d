"""The nearest camera of another model: known pairs are fitted, and errors are what they are said to be."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from omniscv import calibration, cameras
from omniscv.calibration import fitting
from omniscv.cli import run
from omniscv.errors import ArgumentError

SIZE = {"width": 160, "height": 120}
MEI = cameras.create("unified", **SIZE, fx=75.0, fy=76.0, cx=81.0, cy=59.0, xi=0.9)
DOUBLE = cameras.create("double-sphere", **SIZE, fx=45.0, fy=45.0, xi=-0.2, alpha=0.6)
LENS = cameras.create("kannala-brandt", **SIZE, fx=50.0, fy=50.5, k=(0.02, -0.008, 0.002, -0.0004))


def test_the_sphere_model_is_the_extended_one_with_beta_1() -> None:
    fitted = calibration.fit(MEI, "extended-unified")
    expected = {"fx": 75 / 1.9, "fy": 76 / 1.9, "cx": 81.0, "cy": 59.0, "alpha": 0.9 / 1.9, "beta": 1.0}
    for name, value in expected.items():
        assert fitted.camera.parameters()[name] == pytest.approx(value, abs=1e-7)
    assert fitted.max_px < 1e-9
    assert fitted.coverage == 1
    back = calibration.fit(fitted.camera, "unified")
    assert back.max_px < 1e-6
    assert back.camera.parameters()["xi"] == pytest.approx(0.9, abs=1e-5)


def test_an_equidistant_lens_is_a_polynomial_of_one_term_and_a_stretched_one_stays_stretched() -> None:
    fitted = calibration.fit(cameras.create("fisheye-equidistant", 120, 120, fov_deg=190), "ftheta")
    assert fitted.max_px < 1e-6
    assert fitted.coverage == 1
    # A polynomial whose columns are 5 % wider than its rows: two focal lengths, though it has none.
    bent = cameras.create("scaramuzza", **SIZE, coefficients=[-60.0, 0.0, 0.004], affine=(1.05, 0, 0))
    stretched = calibration.fit(bent, "kannala-brandt")
    assert stretched.max_px < 0.01
    assert stretched.camera.fx / stretched.camera.fy == pytest.approx(1.05, abs=1e-3)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("source", "model", "least", "most"),
    [
        (DOUBLE, "kannala-brandt", 0.0, 0.005),
        (LENS, "double-sphere", 0.0, 0.5),
        (LENS, "pinhole", 10.0, 40.0),  # by rays beyond 80 degrees, which are not fitted
        (DOUBLE, "fisheye-stereographic", 5.0, 10.0),  # sees another part of the rays
    ],
)
def test_the_errors_are_those_of_all_rays_that_both_cameras_see(
    source: cameras.Camera, model: str, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fitting, "_STEPS", 12)
    fitted = calibration.fit(source, model)
    pixels = source.pixels().reshape(-1, 2)
    rays = source.unproject(pixels)
    seen, valid = fitted.camera.project(rays.directions)
    both = valid & rays.valid
    off = np.linalg.norm(seen - pixels, axis=-1)[both]
    assert fitted.max_px == pytest.approx(off.max(), rel=1e-9)
    assert least <= fitted.max_px < most
    assert fitted.rms_px == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-9)
    assert fitted.coverage == pytest.approx(both.sum() / rays.valid.sum())


def test_no_other_camera_of_the_model_is_nearer() -> None:
    fitted = calibration.fit(DOUBLE, "extended-unified")
    pixels = DOUBLE.pixels()[8:-8:8, 8:-8:8].reshape(-1, 2)
    rays = DOUBLE.unproject(pixels)

    def rms(changes: dict[str, Any]) -> float:
        other = cameras.from_dict(fitted.camera.to_dict() | changes)
        seen, valid = other.project(rays.directions)
        return float(np.sqrt(np.mean(np.sum((seen - pixels)[valid & rays.valid] ** 2, axis=-1))))

    own = fitted.camera.parameters()
    for name, step in (("fx", 0.3), ("cy", 0.3), ("alpha", 0.02), ("beta", 0.05)):
        for sign in (-1, 1):
            assert rms({name: own[name] + sign * step}) > rms({})


def test_cameras_that_cannot_be_fitted_are_refused() -> None:
    for camera, model, says in (
        (cameras.model("noncentral-panorama").example(64), "pinhole", "camera: expected a central one"),
        (cameras.model("catadioptric-planar").example(64), "pinhole", r"camera: expected one .* along \+z"),
        (DOUBLE, "equirectangular", "model: expected one of pinhole"),
        (3, "pinhole", r"camera: expected a central one.*got 3"),
    ):
        with pytest.raises(ArgumentError, match=says):
            calibration.fit(camera, model)  # type: ignore[arg-type]


def test_the_command_reads_fits_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibration.save(tmp_path / "chain.yaml", {"cam0": DOUBLE, "cam1": LENS}, "kalibr")
    words = ["cameras", "fit", str(tmp_path / "chain.yaml"), "extended-unified"]
    assert run(words) == 2
    assert "--name: expected one of cam0, cam1" in capsys.readouterr().err
    out = tmp_path / "cameras.txt"
    assert run([*words, "--name", "cam0", "--json", "--out", str(out)]) == 0
    printed = json.loads(capsys.readouterr().out)
    expected = calibration.fit(DOUBLE, "extended-unified")
    assert printed["camera"] == expected.camera.to_dict()
    assert printed["max_px"] == pytest.approx(expected.max_px)
    assert calibration.load(out)["cam0"] == expected.camera
    model = "cameras fit fisheye-equidistant kannala-brandt --size 64x64 --set fov_deg=170 --format colmap"
    assert run([*model.split(), "--out", str(out)]) == 0
    assert "largest error" in capsys.readouterr().out
    assert list(calibration.load(out)) == ["1"]
