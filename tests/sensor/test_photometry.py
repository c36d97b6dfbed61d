"""Photometric files of TUM monoVO: read, written, exported; their law is I = G(t V B)."""

import cv2
import numpy as np
import pytest

from omniscv import calibration, light
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.job.file import load
from omniscv.make import make
from omniscv.sensor import optics


def test_a_response_is_the_inverse_of_its_transfer(tmp_path):
    path = optics.write_response(tmp_path / "pcalib.txt", "srgb")
    words = path.read_text().split(" ")
    assert (len(words), float(words[0]), float(words[-1])) == (256, 0, 255)
    codes = np.arange(256) / 255  # IEC 61966-2-1
    light_of_codes = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(np.loadtxt(path) / 255, light_of_codes, atol=1e-8)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_vignette_of_another_program_is_relative_to_its_largest_value(tmp_path, dtype):
    pixels = np.random.default_rng(1).integers(40, 200, (6, 9)).astype(dtype)
    cv2.imwrite(str(tmp_path / "vignette.png"), pixels)
    shares = optics.read_vignette(tmp_path / "vignette.png", (6, 9))
    np.testing.assert_allclose(shares, pixels / pixels.max(), atol=1e-6)
    with pytest.raises(ArgumentError, match="expected a vignette of the image's size, 9 x 5, got 9 x 6"):
        optics.read_vignette(tmp_path / "vignette.png", (5, 9))


def test_a_dataset_is_exported_with_its_photometric_calibration(tmp_path):
    """By the files alone, pictures give back the light: B = G^-1(I) / V."""
    keys = {"shading": "natural", "electrons": 1e9, "full_well": 1e9, "bits": 16, "exposure_s": 0.02}
    job = load(
        {
            "source": "scene://four-wall",
            "cameras": {"eye": {"model": "fisheye-stereographic", "width": 32, "height": 32, "fov_deg": 170},
                        "flat": {"model": "pinhole", "width": 32, "height": 24, "fov_deg": 80}},
            "poses": [{"position": [0, 0, 1.2], "yaw_deg": yaw, "time": 3 + yaw} for yaw in (0, 0.5)],
            "sensor": keys, "export": ["tum_mono"], "face_size": 32, "out": str(tmp_path),
        }
    )  # fmt: skip
    make(job)
    folder = tmp_path / "exports" / "tum_mono" / "eye"
    assert (folder / "times.txt").read_text() == "00000 3 20\n00001 3.5 20\n"
    assert not (folder / "camera.txt").exists()  # DSO has no such lens
    flat = calibration.load(folder.with_name("flat") / "camera.txt")
    assert list(flat.values()) == [job.cameras["flat"]]
    inverse, vignette = np.loadtxt(folder / "pcalib.txt"), optics.read_vignette(folder / "vignette.png")
    camera = create("fisheye-stereographic", width=32, height=32, fov_deg=170)
    shares = optics.shading(camera, "natural")
    np.testing.assert_allclose(vignette, shares / shares.max(), atol=2e-5)
    picture = cv2.imread(str(folder / "images" / "00001.png"))[..., ::-1]
    lit = cv2.imread(str(next(tmp_path.glob("eye-1.lit.png"))))[..., ::-1] / 255.0
    valid = camera.valid()
    seen = inverse[picture[valid]] / 255 / vignette[valid][:, None] / shares.max()
    codes = 255 * light.light_to_srgb(lit[valid])
    assert np.abs(255 * light.light_to_srgb(seen) - codes).max() < 2.5
