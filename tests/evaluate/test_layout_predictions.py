"""Predictions as files, in the three forms that are read, and files that are none."""

import json
import os

import numpy as np
import pytest
from PIL import Image
from support.rooms import L_SHAPE, PLAIN, room_of_plan

from omniscv import Pose, cameras
from omniscv.errors import ArgumentError
from omniscv.evaluate.layout import panoramas
from omniscv.evaluate.layout.predictions import draw_maps, read
from omniscv.truth.layout_labels import cor_id

WIDTH = 256
PANORAMA = cameras.create("equirectangular", WIDTH, WIDTH // 2)
POSE = Pose.from_angles((0.3, -0.2, 1.5), yaw_deg=20)
CORNERS = {
    "one": cor_id(room_of_plan(PLAIN), PANORAMA, POSE),
    "two": cor_id(room_of_plan(L_SHAPE), PANORAMA, POSE),
}


def as_json(corners, path):
    uv = (corners / [WIDTH, WIDTH // 2]).tolist()
    path.with_suffix(".json").write_text(json.dumps({"z0": 50.0, "z1": -59.0, "uv": uv}))


def as_txt(corners, path):
    np.savetxt(path.with_suffix(".txt"), corners, fmt="%.17g")


def as_maps(corners, path, suffix="png"):
    for kind, drawn in zip(("EM", "CM"), draw_maps(corners, WIDTH), strict=True):
        Image.fromarray(drawn).save(f"{path}_{kind}.{suffix}")


@pytest.mark.parametrize("form", [as_json, as_txt])
def test_corners_come_back_as_they_were_written(tmp_path, form):
    (tmp_path / "deeper").mkdir()
    for name, corners in CORNERS.items():
        form(corners, tmp_path / "deeper" / name)
    (tmp_path / "log.txt").write_text("of another program")
    found = read(tmp_path, list(CORNERS), WIDTH)
    for name, corners in CORNERS.items():
        assert found[name].corners == pytest.approx(corners, abs=1e-12)
        assert found[name].maps is None


@pytest.mark.parametrize(("suffix", "off", "mean_off"), [("png", 0, 0), ("jpg", 30, 1.0)])
def test_maps_come_back_as_they_were_written(tmp_path, suffix, off, mean_off):
    """JPEG's own loss aside."""
    for name, corners in CORNERS.items():
        as_maps(corners, tmp_path / name, suffix)
    found = read(tmp_path, list(CORNERS), WIDTH)
    for name, corners in CORNERS.items():
        assert found[name].corners is None
        for read_back, drawn in zip(found[name].maps, draw_maps(corners, WIDTH), strict=True):
            change = np.abs(255 * read_back - drawn)
            assert change.max() <= off + 1e-9
            assert change.mean() <= mean_off + 1e-9


def test_deep_and_coloured_maps_are_read_too(tmp_path):
    deep = np.linspace(0, 65535, 32 * 16).reshape(16, 32).astype(np.uint16)
    Image.fromarray(deep).save(tmp_path / "one_EM.png")
    Image.new("RGB", (32, 16), (255, 255, 255)).save(tmp_path / "one_CM.png")
    edges, corners = read(tmp_path, ["one"], WIDTH)["one"].maps
    assert edges == pytest.approx(deep / 65535)
    assert (corners == 1).all()


def test_the_truth_that_is_written_can_be_read_as_a_prediction(tmp_path):
    lit = np.zeros((WIDTH // 2, WIDTH, 3), np.uint8)
    shot = panoramas.with_truth("shot", lit, room_of_plan(L_SHAPE), PANORAMA, POSE)
    panoramas.write(shot, tmp_path)
    found = read(tmp_path, ["shot"], WIDTH)["shot"]
    assert found.corners == pytest.approx(shot.corners, abs=5e-4)  # three decimals
    for read_back, drawn in zip(found.maps, shot.maps, strict=True):
        assert (255 * read_back).round() == pytest.approx(drawn)


def half(path):
    as_maps(CORNERS["one"], path)
    picture = path.with_name("one_EM.png")
    picture.write_bytes(picture.read_bytes()[:200])


def bomb(path):
    """A PNG of 32 million pixels in a few kilobytes."""
    as_maps(CORNERS["one"], path)
    Image.new("1", (8000, 4000)).save(path.with_name("one_EM.png"))


def square(path):
    as_maps(CORNERS["one"], path)
    Image.new("L", (64, 64)).save(path.with_name("one_CM.png"))


def twice(path):
    as_json(CORNERS["one"], path)
    as_txt(CORNERS["one"], path)


def alone(path):
    as_maps(CORNERS["one"], path)
    path.with_name("one_CM.png").unlink()


def content(name, text):
    def write(path):
        path.with_name(name).write_bytes(text)

    return write


def outside(path):
    as_txt(CORNERS["one"] * 4, path)


def unpaired(path):
    as_txt(CORNERS["one"][1:], path)


HOSTILE = {
    "empty": (lambda path: None, r"expected one.json or one.txt, missing for 1 of .* got no other file"),
    "alone": (alone, r"expected one_CM.png or one_CM.jpg, missing"),
    "twice": (twice, r"expected one file of the corners of one, got one.json and one.txt"),
    "half": (half, r"one_EM.png: expected a PNG or JPEG picture"),
    "bomb": (
        bomb,
        r"one_EM.png: expected a map twice as wide as high, of at most \d+ pixels, got 8000 x 4000",
    ),
    "square": (square, r"one_CM.png: .* got 64 x 64"),
    "no numbers": (content("one.txt", b"1 2\n3 four\n"), r"one.txt: lines: expected .*finite numbers"),
    "other json": (content("one.json", b'{"boxes": []}'), r"one.json: expected a mapping with uv"),
    "deep json": (content("one.json", b"[" * 100_000), r"one.json: expected a mapping with uv"),
    "no number": (content("one.json", b'{"uv": [[0.1, NaN]]}'), r"one.json: uv: expected .*finite numbers"),
    "outside": (outside, r"one.txt: expected corners within 256 x 128 px"),
    "unpaired": (unpaired, r"one.txt: cor_id: expected at least 3 pairs"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_files_that_are_no_predictions_are_refused_in_a_line(tmp_path, kind):
    write, message = HOSTILE[kind]
    write(tmp_path / "one")
    with pytest.raises(ArgumentError, match=message) as raised:
        read(tmp_path, ["one"], WIDTH)
    assert str(raised.value).startswith("predictions: ")
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) <= 1000


def test_what_is_missing_for_one_of_several_is_named(tmp_path):
    as_json(CORNERS["one"], tmp_path / "one")
    with pytest.raises(
        ArgumentError, match=r"expected two.json or two.txt, missing for 1 of the 2 panoramas"
    ):
        read(tmp_path, ["one", "two"], WIDTH)


def test_devices_are_not_read_to_their_end(tmp_path):
    os.symlink("/dev/zero", tmp_path / "one.txt")
    with pytest.raises(ArgumentError, match="expected a regular file"):
        read(tmp_path, ["one"], WIDTH)
