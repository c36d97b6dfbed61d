"""Lenses: shading by each projection's closed form, blur, glare, lateral colour; photometric files of TUM."""

import cv2
import numpy as np
import pytest

from omniscv import calibration, light
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.job.file import load
from omniscv.make import make
from omniscv.sensor import Sensor, optics

LAWS = {
    "fisheye-equidistant": lambda t: np.sin(t) / t,
    "fisheye-stereographic": lambda t: np.cos(t / 2) ** 4,
    "fisheye-equisolid": lambda t: np.ones_like(t),
    "fisheye-orthographic": lambda t: 1 / np.cos(t),
    "pinhole": lambda t: np.cos(t) ** 4,
}


@pytest.mark.parametrize("name", LAWS)
def test_shading_is_the_projections_own_or_a_table(name):
    fov = {"pinhole": 100, "fisheye-orthographic": 170}.get(name, 230)
    camera = create(name, width=101, height=101, fov_deg=fov)
    theta = np.arccos(np.clip(camera.unproject().directions[..., 2], -1, 1))
    off_axis = theta > np.radians(2)
    theta = theta[off_axis]
    shares = optics.shading(camera, "natural")[off_axis]
    np.testing.assert_allclose(shares, LAWS[name](theta), rtol=2e-4)
    table = optics.shading(camera, ((0.0, 1.0), (120.0, 0.4)))[off_axis]
    np.testing.assert_allclose(table, 1 - np.degrees(theta) / 200, atol=1e-3)


def test_blur_keeps_light_and_has_its_width_and_an_even_field_stays():
    valid = np.ones((65, 65), bool)
    point = np.zeros((65, 65, 3), np.float32)
    point[32, 32] = 1
    blurred = optics.blur(point, (2.0,), valid)[..., 0]
    x = np.arange(65) - 32
    assert blurred.sum() == pytest.approx(1, rel=1e-5)
    assert (blurred.sum(axis=0) * x**2).sum() == pytest.approx(4, rel=0.02)
    valid = create("fisheye-equidistant", width=64, height=64, fov_deg=180).valid()
    even = np.repeat(np.float32(0.4) * valid[..., None], 3, axis=-1).astype(np.float32)
    for sigmas in ((1.5,), (0.0, 1.0, 3.0)):
        np.testing.assert_allclose(optics.blur(even, sigmas, valid), even, atol=1e-6)


def test_black_in_a_white_field_reads_the_glare():
    light = np.ones((100, 100, 3), np.float32)
    light[50, 50] = 0
    shown = optics.glare(light, 0.03, np.ones((100, 100), bool))
    assert shown[50, 50] == pytest.approx(0.03, rel=1e-3)
    assert shown[0, 0] == pytest.approx(1, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("fisheye-equidistant", {"fov_deg": 170}), ("pinhole", {"focal": 40.0}),
     ("kannala-brandt", {"fx": 40.0, "fy": 41.0, "cx": 31.0, "cy": 33.0, "k": [0.01, 0, 0, 0]})],
)  # fmt: skip
def test_lateral_colour_is_seen_by_lenses_of_other_focal_lengths(name, parameters):
    camera = create(name, width=64, height=64, **parameters)
    sensor = Sensor(lateral=(0.004, -0.003))
    ray = np.array([0.1, 0.2, 1.0])
    ahead = np.array([0.0, 0.0, 1.0])
    for share, other in zip(sensor.lateral, sensor.lateral_cameras(camera), strict=True):
        (seen, _) = camera.project(ray)
        (moved, _) = other.project(ray)
        (centre, _) = camera.project(ahead)
        np.testing.assert_allclose(moved - centre, (seen - centre) * (1 + share), rtol=1e-9)


def test_a_panorama_has_no_natural_shading_and_no_lateral_colour():
    panorama = create("equirectangular", width=16, height=8)
    with pytest.raises(ArgumentError, match=r"shading: expected a fisheye .* got equirectangular"):
        optics.shading(panorama, "natural")
    with pytest.raises(ArgumentError, match=r"lateral: expected a lens with a focal length"):
        Sensor(lateral=(0.001, 0)).lateral_cameras(panorama)


def test_a_rolling_shutter_has_its_lens():
    turning = {"readout": 0.03, "angular_velocity_deg": [0, 30, 0]}
    camera = create("rolling-shutter", 64, 48, base={"model": "pinhole", "fov_deg": 80}, **turning)
    plain = create("pinhole", width=64, height=48, fov_deg=80)
    np.testing.assert_array_equal(optics.shading(camera, "natural"), optics.shading(plain, "natural"))
    longer = optics.magnified(camera, 0.01)
    assert longer.base.focal == pytest.approx(1.01 * plain.focal)
    assert (longer.readout, longer.to_dict()["angular_velocity_deg"]) == (0.03, [0, 30, 0])


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
    inverse = np.loadtxt(folder / "pcalib.txt")
    vignette = optics.read_vignette(folder / "vignette.png")
    camera = create("fisheye-stereographic", width=32, height=32, fov_deg=170)
    shares = optics.shading(camera, "natural")
    np.testing.assert_allclose(vignette, shares / shares.max(), atol=2e-5)
    picture = cv2.imread(str(folder / "images" / "00001.png"))[..., ::-1]
    lit = cv2.imread(str(next(tmp_path.glob("eye-1.lit.png"))))[..., ::-1] / 255.0
    valid = camera.valid()
    seen = inverse[picture[valid]] / 255 / vignette[valid][:, None] / shares.max()
    codes = 255 * light.light_to_srgb(lit[valid])
    assert np.abs(255 * light.light_to_srgb(seen) - codes).max() < 2.5
