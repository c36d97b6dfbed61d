"""A sensor in Python and in a job: keys, presets, layers, bytes."""

import cv2
import numpy as np
import pytest

import mock_server
import omniscv
from omniscv import light
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.job.file import load
from omniscv.make import capture, make, run
from omniscv.sensor import PRESETS, Sensor, optics
from omniscv.sources.scene import SceneSource

JOB = {
    "source": "mock://four-wall",
    "cameras": {"eye": {"model": "fisheye-equidistant", "width": 48, "height": 48, "fov_deg": 180}},
    "poses": [{"position": [0, 0, 1.2], "yaw_deg": yaw} for yaw in (0, 40, 80, 120)],
    "modes": ["lit", "object_mask", "depth"],
    "face_size": 32,
}
NOISY = {"seed": 3, "electrons": 4000, "read_noise": 5, "prnu": 0.01, "black_level": 64, "mosaic": "rggb"}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("recorded") / "room.sqlite"
    capture(load(JOB), path)
    return str(path)


def job(recorded, out, **keys):
    return load(JOB | {"source": recorded, "out": str(out)} | keys)


def bytes_of(folder, *kinds):
    paths = [path for path in sorted(folder.iterdir()) if path.name.split(".")[1] in kinds]
    return {path.name: path.read_bytes() for path in paths}


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_defaults(name):
    sensor = Sensor(preset=name, seed=4, read_noise=0)
    assert (sensor.seed, sensor.read_noise, sensor.bits) == (4, 0, PRESETS[name]["bits"])
    assert sensor == Sensor(**sensor.to_dict())


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"bits": 17}, "bits: expected a whole number <= 16, got 17"),
        ({"blur": [1, 1, 1, 1, 1, 1]}, r"blur: expected 1 to 5 standard deviations, got \[1, 1"),
        ({"shading": [[10, 1], [0, 1]]}, "shading: expected natural, a file, or at least two pairs"),
        ({"black_level": 300, "bits": 8}, "black_level: expected less than 255, got 300"),
    ],
)
def test_a_wrong_key_is_refused(keys, message):
    with pytest.raises(ArgumentError, match=message):
        Sensor(**keys)


def test_without_noise_codes_come_back():
    codes = np.random.default_rng(1).integers(0, 256, (32, 32, 3), np.uint8)
    sensor = Sensor(electrons=1e12, full_well=1e12, bits=16)
    shown = sensor.develop(sensor.expose(light.decode(codes, "srgb")))
    assert np.abs(shown.astype(int) - codes).max() <= 1  # codes below 1 differ by less than one of 16 bits

    sensor = Sensor(electrons=(3e9, 6e9, 2e9), full_well=8e9, bits=16, mosaic="rggb")  # grey is grey
    shown = sensor.develop(sensor.expose(np.full((32, 32, 3), 0.25, np.float32)))
    assert np.abs(shown.astype(int) - 137).max() <= 1
    sensor = Sensor(electrons=(5000, 9000, 4000), full_well=10_000).exposed(2)  # full wells are white
    assert (sensor.develop(sensor.expose(np.full((8, 8, 3), 0.9, np.float32))) >= 254).all()


@pytest.mark.parametrize("mosaic", ["rggb", "bggr", "grbg", "gbrg"])
def test_demosaicing_returns_flats_and_ramps(mosaic):
    sensor = Sensor(electrons=1e12, full_well=1e12, bits=16, mosaic=mosaic)
    flat = np.broadcast_to(np.array([0.2, 0.5, 0.7], np.float32), (32, 32, 3))
    assert (sensor.develop(sensor.expose(flat)) == light.encode(np.ascontiguousarray(flat), "srgb")).all()
    ramp = np.repeat(np.linspace(0.2, 0.8, 64, dtype=np.float32)[None, :, None], 32, axis=0).repeat(3, axis=2)
    full = cv2.demosaicing(sensor.expose(ramp), getattr(cv2, f"COLOR_Bayer{mosaic.upper()}2RGB_EA"))
    assert np.abs(full[4:-4, 4:-4] / 65535 - ramp[4:-4, 4:-4]).max() <= 1.01 / 65535


def test_a_sensor_changes_no_other_layer(recorded, tmp_path):
    run(job(recorded, tmp_path / "plain"))
    run(job(recorded, tmp_path / "sensed", sensor=NOISY))
    kinds = "lit", "object_mask", "labels", "depth", "depth_error", "label_edge"
    assert bytes_of(tmp_path / "plain", *kinds) == bytes_of(tmp_path / "sensed", *kinds)
    assert not bytes_of(tmp_path / "plain", "raw", "sensor")
    assert len(bytes_of(tmp_path / "sensed", "raw", "sensor")) == 8
    run(job(recorded, tmp_path / "depth", sensor=NOISY, modes=["depth"]))
    assert not bytes_of(tmp_path / "depth", "lit")
    assert len(bytes_of(tmp_path / "depth", "sensor", "depth")) == 8
    codes = cv2.imread(str(tmp_path / "sensed" / "eye-0.raw.png"), cv2.IMREAD_UNCHANGED)
    assert (codes.dtype, codes.shape) == (np.uint16, (48, 48))


def test_parts_resuming_and_order_change_no_bytes(recorded, tmp_path):
    whole = job(recorded, tmp_path / "whole", sensor=NOISY)
    make(whole)
    parts = job(recorded, tmp_path / "parts", sensor=NOISY)
    for i in (1, 0):
        make(parts, shard=(i, 2), workers=2)
    expected = bytes_of(tmp_path / "whole", "raw", "sensor", "lit")
    assert len(expected) == 12
    assert bytes_of(tmp_path / "parts", "raw", "sensor", "lit") == expected
    (tmp_path / "whole" / "eye-2.raw.png").unlink()
    make(whole, existing="resume")
    assert bytes_of(tmp_path / "whole", "raw", "sensor", "lit") == expected
    with pytest.raises(ArgumentError, match=r"options\.sensor\.seed is 3"):
        make(job(recorded, tmp_path / "whole", sensor=NOISY | {"seed": 4}), existing="resume")
    run(job(recorded, tmp_path / "turned", sensor=NOISY, poses=JOB["poses"][::-1]))
    for i in range(4):
        assert bytes_of(tmp_path / "turned", "raw")[f"eye-{i}.raw.png"] == expected[f"eye-{3 - i}.raw.png"]


def test_a_job_composes_lateral_colour_by_three_cameras(recorded, tmp_path):
    keys = {"lateral": [0.02, -0.02], "electrons": 1e9, "full_well": 1e9, "bits": 16}
    run(job(recorded, tmp_path, sensor=keys, poses=JOB["poses"][:1]))
    sensor = Sensor(**keys)
    camera = create("fisheye-equidistant", width=48, height=48, fov_deg=180)
    pose = load(JOB).poses[0]
    lenses = camera, *sensor.lateral_cameras(camera)
    with omniscv.open_source(recorded) as source:
        green, *others = (omniscv.render(lens, pose, source, face_size=32) for lens in lenses)
    due = sensor.apply(green, "eye", lateral=others)["sensor"]
    shown = cv2.imread(str(tmp_path / "eye.sensor.png"))[..., ::-1]
    np.testing.assert_array_equal(shown, due)


def test_a_vignette_of_a_file_is_relative_to_the_job(recorded, tmp_path):
    share = np.linspace(0.2, 1, 48 * 48).reshape(48, 48)
    optics.write_vignette(tmp_path / "vignette.png", share)
    np.testing.assert_allclose(optics.read_vignette(tmp_path / "vignette.png"), share, atol=1e-5)
    (tmp_path / "job.yaml").write_text(
        f"source: {recorded}\nposes: [{{position: [0, 0, 1.2]}}]\nface_size: 32\n"
        "cameras: {eye: {model: fisheye-equidistant, width: 48, height: 48, fov_deg: 180}}\n"
        "sensor: {shading: vignette.png, electrons: 1.0e+9, full_well: 1.0e+9, bits: 16}\n"
    )
    read = load(tmp_path / "job.yaml")
    assert "sha256" in read.sensor.to_dict()["shading"]
    run(read)
    lit, shown = (cv2.imread(str(tmp_path / "out" / f"eye.{kind}.png")) for kind in ("lit", "sensor"))
    due = light.encode((light.decode(lit, "srgb") * share[..., None]).astype(np.float32), "srgb")
    assert np.abs(shown.astype(int) - due).max() <= 1
    with pytest.raises(ArgumentError, match=r"shading: expected natural, a table, or a file .*none\.png"):
        load(JOB | {"sensor": {"shading": str(tmp_path / "none.png")}})


def test_floating_point_light_stays_light():
    scene = mock_server.load_scene("four-wall")
    camera = create("equirectangular", width=32, height=16)
    pose = omniscv.Pose.from_angles((0, 0, 1.2))
    sensor = Sensor(electrons=1e9, full_well=1e9, bits=16)
    with SceneSource(scene, lit="float32") as source:
        image = omniscv.render(camera, pose, source)
    shown = sensor.apply(image)["sensor"]
    assert np.abs(shown.astype(int) - np.rint(255 * light.light_to_srgb(image.lit))).max() <= 1
