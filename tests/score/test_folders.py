"""Folders of predictions in all forms, against datasets and folders of images; reports that others read."""

import csv
import json

import cv2
import numpy as np
import pytest

import omniscv
from omniscv import Pose
from omniscv.cameras import create
from omniscv.cli import run
from omniscv.errors import ArgumentError
from omniscv.score.running import score

CAMERA = create("equirectangular", width=64, height=32)


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    out = tmp_path_factory.mktemp("truth")
    with omniscv.open_source("scene://four-wall") as scene:
        for name, yaw in (("a", 0), ("b", 70)):
            image = omniscv.render(
                CAMERA, Pose.from_angles((0.2, 0, 1.4), yaw), scene, ("lit", "object_mask", "depth")
            )
            image.save(out, name)
    return out


@pytest.fixture
def depth(truth):
    return {name: omniscv.compose.files.read(truth / f"{name}.depth.exr", "depth") for name in ("a", "b")}


def pfm(path, values):
    path.write_bytes(b"Pf\n%d %d\n-1.0\n" % values.shape[::-1] + values[::-1].astype("<f4").tobytes())


WRITERS = {
    ".npy": np.save,
    ".npz": lambda path, values: np.savez(path, depth=values),
    ".exr": lambda path, values: omniscv.compose.files.write_picture(
        path, values, omniscv.modalities.get("depth")
    ),
    ".tiff": lambda path, values: cv2.imwrite(str(path), values),
    ".pfm": pfm,
}


@pytest.mark.parametrize("suffix", WRITERS)
def test_predictions_of_every_form_are_read(tmp_path, truth, depth, suffix):
    for name, values in depth.items():
        WRITERS[suffix](tmp_path / f"{name}{suffix}", (1.1 * values).astype(np.float32))
    for item in score(tmp_path, truth):
        assert item.scores.by_pixel.abs_rel == pytest.approx(0.1, abs=1e-6)


def test_pictures_of_whole_numbers_take_a_unit(tmp_path, truth, depth):
    for name, values in depth.items():
        cv2.imwrite(str(tmp_path / f"{name}.depth.png"), np.rint(1000 * values).astype(np.uint16))
    for item in score(tmp_path, truth, unit_m=0.001):
        assert item.scores.by_solid_angle.mae < 0.0005


def test_another_size_is_said(tmp_path, truth, depth):
    for name, values in depth.items():
        np.save(tmp_path / f"{name}.npy", np.kron(values, np.ones((2, 2))))
    for item in score(tmp_path, truth):
        assert item.scores.by_pixel.abs_rel < 1e-6
        assert item.resampled == "128x64 px: read linearly between pixels, also across the seam"


def test_a_prediction_that_is_missing_is_named(tmp_path, truth, depth):
    np.save(tmp_path / "a.npy", depth["a"])
    with pytest.raises(ArgumentError, match="expected a prediction of 'b'"):
        score(tmp_path, truth)


def test_a_folder_without_images_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="expected a dataset, or images"):
        score(tmp_path, tmp_path)


def test_the_report_is_json_csv_and_one_page(tmp_path, truth, depth, capsys):
    for name, values in depth.items():
        np.save(tmp_path / f"{name}.npy", 1.05 * values)
    out = tmp_path / "report"
    assert run(["score", str(tmp_path), str(truth), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    assert report["mean"]["by_pixel"]["abs_rel"] == pytest.approx(0.05, abs=1e-6)
    rows = list(csv.DictReader((out / "report.csv").read_text().splitlines()))
    assert [(row["image"], row["weights"]) for row in rows[:2]] == [
        ("a", "by_pixel"),
        ("a", "by_solid_angle"),
    ]
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert "http" not in page
    assert "in doubt left out" in capsys.readouterr().out


def test_a_dataset_is_truth(tmp_path):
    from omniscv import dataset
    from omniscv.job import read
    from omniscv.make import make

    job = {
        "source": "scene://four-wall",
        "cameras": {"pano": {"model": "equirectangular", "width": 32, "height": 16}},
        "poses": [{"position": [0, 0, 1.5]}],
        "modes": ["lit", "mask", "depth"],
        "out": str(tmp_path / "set"),
    }
    make(read(job, tmp_path))
    for frame in dataset.open(tmp_path / "set"):
        np.save(tmp_path / f"{frame.key}.npy", 2 * frame.layer("depth"))
    (item,) = score(tmp_path, tmp_path / "set", align="median")
    assert item.scores.by_pixel.abs_rel < 1e-6
