"""What sources say of light, and what composition makes of it."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import omniscv
from mock_server import load_scene
from mock_server.scene import Scene
from omniscv import light
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.geometry.trajectory import Trajectory
from omniscv.job.file import load
from omniscv.make import render
from omniscv.modalities import TRANSFERS
from omniscv.sources import Capabilities, SourceWrapper
from omniscv.sources.scene import SceneSource

POSE = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=10)
SQUARES = {"kind": "checker", "colors": [[0, 0, 0], [1, 1, 1]], "scale": 0.1}
BALL = {"texture": SQUARES, "solids": [{"sphere": 3.0, "at": [0, 0, 1.5]}]}
CHECKERS = Scene("checkers", {"sky": [0, 0, 0], "objects": {"Ball": BALL}})
"""Black and white squares of two degrees."""
PANORAMA = create("equirectangular", width=16, height=8)


def with_transfer(scene, transfer, lit="uint8"):
    return SceneSource(scene, Capabilities(transfer=transfer), lit=lit)


class AsLight(SourceWrapper):
    """Captures as floating-point light, by the definition of sRGB."""

    def capture(self, requests):
        for capture in super().capture(requests):
            v = capture.pixels / 255
            values = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
            yield replace(capture, pixels=values.astype(np.float32))


@pytest.mark.parametrize("transfer", ["srgb", "unknown"])
def test_area_averages_light_where_the_transfer_is_known(transfer):
    options = {"filter": "area", "face_size": 256}
    with with_transfer(CHECKERS, transfer) as source:
        shown = omniscv.render(PANORAMA, POSE, source, **options).lit
        of_light = omniscv.render(PANORAMA, POSE, AsLight(source), **options).lit
    off = shown - 255 * (1.055 * of_light ** (1 / 2.4) - 0.055)
    assert np.abs(off).max() <= 0.51 if transfer == "srgb" else np.median(off) < -20


@pytest.mark.parametrize("filter", ["nearest", "bilinear", "bicubic"])
def test_other_filters_show_the_codes_as_before(filter):
    shown = []
    for transfer in ("srgb", "unknown"):
        with with_transfer(load_scene("four-wall"), transfer) as source:
            shown.append(omniscv.render(PANORAMA, POSE, source, filter=filter, face_size=32).lit)
    np.testing.assert_array_equal(*shown)


def test_a_recording_keeps_the_transfer_and_one_of_two_has_none(tmp_path):
    path = tmp_path / "room.sqlite"
    for transfer, x, held in (("film", 0, "film"), ("linear", 1, "unknown")):
        pose = omniscv.Pose.from_angles((x, 0, 1))
        with with_transfer(load_scene("four-wall"), transfer) as scene, omniscv.record(scene, path) as source:
            image = omniscv.render(PANORAMA, pose, source, face_size=16)
        with omniscv.open_source(path) as source:
            assert source.capabilities.transfer == held
            replayed = omniscv.render(PANORAMA, pose, source, face_size=16)
        assert (image.transfer, replayed.transfer) == (transfer, held)
        assert replayed.description().get("transfer", "unknown") == held


def test_the_transfer_is_an_option_of_sources():
    with omniscv.open_source("scene://four-wall") as source:
        assert source.capabilities.transfer == "linear"
    with omniscv.open_source("scene://four-wall", transfer="film") as source:
        assert source.capabilities.transfer == source.without(["Lamp"]).capabilities.transfer == "film"
    with pytest.raises(ArgumentError, match="expected one of srgb, linear, film, unknown; got 'rgb'"):
        omniscv.open_source("scene://four-wall", transfer="rgb")


def test_colours_are_shown_as_srgb():
    with with_transfer(load_scene("four-wall"), "linear", lit="float32") as source:
        floats = omniscv.render(PANORAMA, POSE, source, face_size=32)
    np.testing.assert_array_equal(floats.to_srgb(), np.rint(255 * light.light_to_srgb(floats.lit)))
    with with_transfer(load_scene("four-wall"), "srgb") as source:
        codes = omniscv.render(PANORAMA, POSE, source, face_size=32)
    assert codes.to_srgb() is codes.lit
    linear = replace(codes, transfer="linear").to_srgb()
    np.testing.assert_array_equal(linear, np.rint(255 * light.light_to_srgb(codes.lit / 255)))


def test_motion_blur_is_the_mean_of_light(tmp_path):
    job = load(
        {
            "source": "scene://four-wall",
            "source_options": {"transfer": "srgb"},
            "cameras": {"eye": {"model": "fisheye-equidistant", "width": 32, "height": 32, "fov_deg": 120}},
            "poses": [{"position": [0, 0, 1.2], "yaw_deg": 30 * i, "time": i} for i in range(2)],
            "times": "poses",
            "exposure": {"seconds": 0.5, "instants": 3},
            "face_size": 32,
            "out": str(tmp_path),
        }
    )
    render.run(job)
    path = Trajectory(job.poses, job.times_ns)
    total = 0
    with omniscv.open_source("scene://four-wall") as source:
        for late in (-0.5 / 3, 0, 0.5 / 3):
            pose = path.at(round(1e9 * late), steps_beyond=1)
            image = omniscv.render(job.cameras["eye"], pose, source, face_size=32)
            total = total + light.light_of_codes(image.lit, "srgb") / 3
    shown = omniscv.compose.files.read(tmp_path / "eye-0.lit.png", "lit")
    assert np.abs(shown - 255 * light.light_to_srgb(total)).max() <= 0.5 + 1e-3


def test_files_hold_the_transfer(tmp_path):
    camera = create("equirectangular", width=8, height=4)
    room = load_scene("four-wall")
    for transfer in TRANSFERS:
        with with_transfer(room, transfer) as source:
            omniscv.render(camera, POSE, source, ("lit", "object_mask"), face_size=8).save(tmp_path, transfer)
    said = {name: b"sRGB" in (tmp_path / f"{name}.lit.png").read_bytes() for name in TRANSFERS}
    assert said == {"srgb": True, "film": True, "linear": False, "unknown": False}
    assert b"sRGB" not in (tmp_path / "srgb.labels.png").read_bytes()
    with Image.open(tmp_path / "srgb.lit.png") as picture:
        assert (picture.info["srgb"], picture.info["gamma"]) == (0, 0.45455)
    with with_transfer(room, "linear", lit="float32") as source:
        omniscv.render(camera, POSE, source, face_size=8).save(tmp_path, "light")
    rec_709 = 0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329
    with OpenEXR.File(str(tmp_path / "light.lit.exr")) as file:
        np.testing.assert_allclose(file.header()["chromaticities"], rec_709)


def test_an_unknown_transfer_is_warned_of_once(tmp_path):
    keys = {
        "source": "mock://four-wall",
        "cameras": {"eye": {"model": "equirectangular", "width": 16, "height": 8}},
        "poses": [{"position": [x, 0, 1]} for x in (0, 1)], "face_size": 16, "out": str(tmp_path),
    }  # fmt: skip
    area = {"filter": "area"}
    for more, count in (({}, 0), (area, 1), ({"sensor": {}}, 1), ({**area, "modes": ["depth"]}, 0)):
        lines = []
        render.run(load(keys | more), warn=lines.append)
        assert len([line for line in lines if line.startswith("transfer: ")]) == count
    lines = []
    render.run(load(keys | {"filter": "area", "source_options": {"transfer": "srgb"}}), warn=lines.append)
    assert not lines
