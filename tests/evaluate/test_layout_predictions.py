"""Predictions as files, in the three forms that are read, and files that are none."""

import io
import json
import os

import numpy as np
import pytest
from PIL import Image
from support.rooms import L_SHAPE, PLAIN, room_of_plan

from omniscv import Pose, cameras
from omniscv.errors import ArgumentError
from omniscv.evaluate import layout
from omniscv.evaluate.layout.predictions import draw_maps, read
from omniscv.truth.layout_labels import cor_id

WIDTH = 256
PANORAMA = cameras.create("equirectangular", WIDTH, WIDTH // 2)
POSE = Pose.from_angles((0.3, -0.2, 1.5), yaw_deg=20)
PLANS = {"one": PLAIN, "two": L_SHAPE}
CORNERS = {name: cor_id(room_of_plan(plan), PANORAMA, POSE) for name, plan in PLANS.items()}


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
    predictions = read(tmp_path, list(CORNERS), WIDTH)
    for name, corners in CORNERS.items():
        assert predictions[name].corners == pytest.approx(corners, abs=1e-12)
        assert predictions[name].maps is None


@pytest.mark.parametrize(("suffix", "off", "mean_off"), [("png", 0, 0), ("jpg", 30, 1.0)])
def test_maps_come_back_as_they_were_written(tmp_path, suffix, off, mean_off):
    """JPEG's own loss aside."""
    for name, corners in CORNERS.items():
        as_maps(corners, tmp_path / name, suffix)
    predictions = read(tmp_path, list(CORNERS), WIDTH)
    for name, corners in CORNERS.items():
        assert predictions[name].corners is None
        change = np.abs(255 * np.array(predictions[name].maps) - draw_maps(corners, WIDTH))
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
    shot = layout.with_truth("shot", lit, room_of_plan(L_SHAPE), PANORAMA, POSE)
    layout.write(shot, tmp_path)
    predictions = read(tmp_path, ["shot"], WIDTH)["shot"]
    assert predictions.corners == pytest.approx(shot.corners, abs=5e-4)  # three decimals
    for read_back, drawn in zip(predictions.maps, shot.maps, strict=True):
        assert (255 * read_back).round() == pytest.approx(drawn)


def png(*size, mode="L"):
    stream = io.BytesIO()
    Image.new(mode, size).save(stream, "png")
    return stream.getvalue()


MAP, ONE = png(256, 128), CORNERS["one"]
"""A map, and corners of a room."""


def lines(corners):
    return "".join(f"{x} {y}\n" for x, y in corners.tolist()).encode()


HOSTILE = {
    "empty": ({}, r"expected one.json or one.txt, missing for 1 of .* got no other file"),
    "alone": ({"one_EM.png": MAP}, r"expected one_CM.png or one_CM.jpg, missing"),
    "twice": (
        {"one.txt": lines(ONE), "one.json": b"{}"},
        r"expected one file of .* got one.json and one.txt",
    ),
    "half": ({"one_EM.png": MAP[:60], "one_CM.png": MAP}, r"one_EM.png: expected a PNG or JPEG picture"),
    "bomb": (
        {"one_EM.png": png(8000, 4000, mode="1"), "one_CM.png": MAP},
        r"of at most \d+ pixels, got 8000 x",
    ),
    "square": ({"one_EM.png": MAP, "one_CM.png": png(64, 64)}, r"one_CM.png: .* got 64 x 64"),
    "text": ({"one.txt": b"1 2\n3 four\n"}, r"one.txt: lines: expected .*finite numbers"),
    "other json": ({"one.json": b'{"boxes": []}'}, r"one.json: expected a mapping with uv"),
    "deep json": ({"one.json": b"[" * 100_000}, r"one.json: expected a mapping with uv"),
    "nan": ({"one.json": b'{"uv": [[0.1, NaN]]}'}, r"one.json: uv: expected .*finite numbers"),
    "outside": ({"one.txt": lines(4 * ONE)}, r"one.txt: expected corners within 256 x 128 px"),
    "unpaired": ({"one.txt": lines(ONE[1:])}, r"one.txt: cor_id: expected at least 3 pairs"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_malformed_predictions_are_refused(tmp_path, kind):
    files, message = HOSTILE[kind]
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ArgumentError, match=message) as raised:
        read(tmp_path, ["one"], WIDTH)
    assert str(raised.value).startswith("predictions: ")
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) <= 1000


def test_missing_predictions_are_named(tmp_path):
    as_json(CORNERS["one"], tmp_path / "one")
    with pytest.raises(
        ArgumentError, match=r"expected two.json or two.txt, missing for 1 of the 2 panoramas"
    ):
        read(tmp_path, ["one", "two"], WIDTH)


def test_devices_are_not_read_to_their_end(tmp_path):
    os.symlink("/dev/zero", tmp_path / "one.txt")
    with pytest.raises(ArgumentError, match="expected a regular file"):
        read(tmp_path, ["one"], WIDTH)
