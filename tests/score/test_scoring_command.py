"""The command: other cameras, files with a camera, labels and normals, sets, protocols, two predictions."""

import csv
import json

import numpy as np
import pytest

import omniscv
from omniscv import Pose, cameras
from omniscv.cli import run
from omniscv.errors import ArgumentError
from omniscv.score import projection
from omniscv.score.running import all_groups, score

CAMERA = cameras.create("equirectangular", width=128, height=64)
PINHOLE = cameras.create("pinhole", width=48, height=36, fov_deg=80)
POSE = Pose.from_angles((0.2, 0, 1.4), 20)


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    out = tmp_path_factory.mktemp("truth")
    with omniscv.open_source("scene://four-wall") as scene:
        for name, x in (("a", 0.2), ("b", -0.5), ("c", 0.7)):
            pose = Pose.from_angles((x, 0, 1.4), 20)
            image = omniscv.render(CAMERA, pose, scene, ("lit", "object_mask", "depth", "normals"))
            image.save(out, name)
    return out


def layer(truth, name, kind="depth"):
    return omniscv.compose.files.read(next(truth.glob(f"{name}.{kind}.*")), kind)


def predictions(folder, truth, change, kind="depth"):
    folder.mkdir()
    for name in ("a", "b", "c"):
        np.save(folder / f"{name}.npy", change(layer(truth, name, kind), name))
    return folder


def report(out, *arguments):
    assert run(["score", *map(str, arguments), "--out", str(out)]) == 0
    return json.loads((out / "report.json").read_text())


@pytest.mark.parametrize("yaw", [0, 140])
def test_a_pinhole_prediction_is_compared_at_its_own_pixels(tmp_path, truth, yaw):
    """What the pinhole sees exactly, 10 % too far, against a panorama: 10 % off, but for the panorama's
    sampling."""
    folder = tmp_path / "views"
    folder.mkdir()
    with omniscv.open_source("scene://four-wall") as scene:
        for name, x in (("a", 0.2), ("b", -0.5), ("c", 0.7)):
            image = omniscv.render(PINHOLE, Pose.from_angles((x, 0, 1.4), 20 + yaw), scene, ("depth",))
            np.save(folder / f"{name}.npy", 1.1 * image.depth)
    content = report(
        tmp_path / "out", folder, truth, "--predicted-camera", "pinhole", "--set-predicted", "fov_deg=80",
        "--turn", f"{yaw},0,0", "--intervals",
    )  # fmt: skip
    assert content["mean"]["by_solid_angle"]["abs_rel"] == pytest.approx(0.1, abs=0.004)
    low, high = content["mean_within"]["by_solid_angle"]["abs_rel"]
    assert low < 0.1 < high


def test_what_another_camera_sees_is_bounded_by_the_neighbours():
    depth = np.tile(np.linspace(2, 2.5, 128), (64, 1))
    depth[:, 60:64] = 9
    doubt = np.zeros((64, 128), bool)
    error = np.full((64, 128), 0.01)
    other = cameras.create("equirectangular", width=64, height=32)
    seen = projection.seen_by(depth, doubt, error, CAMERA, other, None)
    assert seen.depth.shape == (32, 64)
    assert seen.doubt[:, [30, 32]].all()  # beside the step
    assert not seen.doubt[:, 5:28].any()
    exact = 2 + 0.5 * (np.arange(64) * 2 + 0.5) / 127
    assert (np.abs(seen.depth - exact) <= seen.error)[:, 5:28].all()


def test_resizing_reads_across_the_seam_and_past_missing_values():
    values = np.tile([4.0, 2.0, 2.0, 2.0], (2, 1))
    wide = projection.resized(values, (2, 8), wraps=True)
    assert wide[0] == pytest.approx([3.5, 3.5, 2.5, 2, 2, 2, 2, 2.5])
    assert projection.resized(values, (2, 8), wraps=False)[0, [0, 7]] == pytest.approx([4, 2])
    values[0, 1] = 0
    assert projection.resized(values, (2, 8), wraps=True)[0, 1:4].tolist() == [4, 0, 0]


def test_files_are_truth_with_a_camera(tmp_path, truth):
    values = layer(truth, "a")
    np.save(tmp_path / "a.depth.npy", 1000 * values)
    np.savez(tmp_path / "p.npz", depth=1.2 * values)
    content = report(
        tmp_path / "out", tmp_path / "p.npz", tmp_path / "a.depth.npy", "--camera", "equirectangular",
        "--truth-unit", "0.001",
    )  # fmt: skip
    assert content["mean"]["by_pixel"]["abs_rel"] == pytest.approx(0.2, abs=1e-5)
    assert content["images"][0]["name"] == "a"
    assert content["without_interval"]


def test_normals_and_labels_of_folders(tmp_path, truth, capsys):
    turned = predictions(tmp_path / "n", truth, lambda n, _: n * np.array([1, -1, -1]), "normals")
    assert report(tmp_path / "out-n", turned, truth, "--what", "normals")["mean"]["by_pixel"]["mean_deg"] > 30
    assert "reads as frame (x, -y, -z)" in capsys.readouterr().err
    equal = predictions(tmp_path / "l", truth, lambda labels, _: labels.astype(np.uint16), "labels")
    content = report(tmp_path / "out-l", equal, truth, "--what", "labels")
    assert content["mean"]["by_solid_angle"]["miou"] == 1
    assert (tmp_path / "out-l" / "report.html").read_text().count("data:image/png") == 3


@pytest.mark.parametrize("align", ["median", "scale", "scale-shift", "disparity-scale-shift"])
def test_a_set_has_one_alignment(tmp_path, truth, align):
    """Predictions in one unknown unit are exact; in a unit for each image, they are not."""
    shared = predictions(tmp_path / "shared", truth, lambda depth, _: 3.0 * depth)
    errors = [item.scores.by_solid_angle.abs_rel for item in score(shared, truth, align=align, per="set")]
    assert max(errors) < 3e-5
    factors = {"a": 3.0, "b": 4.0, "c": 6.0}
    own = predictions(tmp_path / "own", truth, lambda depth, name: factors[name] * depth)
    assert max(item.scores.by_pixel.abs_rel for item in score(own, truth, align=align)) < 1e-6
    assert max(item.scores.by_pixel.abs_rel for item in score(own, truth, align=align, per="set")) > 0.1


def test_two_predictions_are_compared_by_scene(tmp_path, truth, capsys):
    first = predictions(tmp_path / "first", truth, lambda depth, _: 1.10 * depth)
    second = predictions(tmp_path / "second", truth, lambda depth, name: (1.02 + ord(name) % 2 / 100) * depth)
    content = report(tmp_path / "out", first, truth, "--beside", second, "--also", "edges,points")
    rows = {(row["weights"], row["measure"]): row for row in content["differences"]["second"]}
    row = rows["by_pixel", "abs_rel"]
    assert row["scenes"] == 3
    assert row["mean"] == pytest.approx(-(2 * 0.07 + 0.08) / 3, abs=1e-6)
    assert row["low"] < row["mean"] < row["high"] < 0
    assert content["beside"]["second"]["mean"]["by_pixel"]["abs_rel"] < 0.04
    assert content["mean_extra"]["boundary_f1"] == pytest.approx(1)
    lines = list(csv.DictReader((tmp_path / "out" / "report.csv").read_text().splitlines()))
    assert {line["prediction"] for line in lines} == {"first", "second"}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "second less first" in page
    assert "http" not in page
    assert "second less first, by solid angle, 3 scenes" in capsys.readouterr().out


def test_a_protocol_says_its_own_figures_beside(tmp_path, truth, capsys):
    folder = predictions(tmp_path / "p", truth, lambda depth, _: 1.1 * depth)
    content = report(tmp_path / "out", folder, truth, "--protocol", "depth-any-camera")
    assert content["mean_extra"]["depth-any-camera: abs_rel"] == pytest.approx(0.1, abs=1e-6)
    assert run(["score", str(folder), str(truth), "--protocol", "depth-anywhere"]) == 2
    assert "form: expected disparity, as the protocol depth-anywhere has it" in capsys.readouterr().err


def test_groups_of_a_folder_are_those_of_all_its_images(tmp_path, truth):
    folder = predictions(tmp_path / "p", truth, lambda depth, _: 1.1 * depth)
    total = all_groups(score(folder, truth))
    assert total.bands[..., 1].sum() / total.bands[..., 0].sum() == pytest.approx(0.1, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"what": "colours"}, "what: expected"),
        ({"per": "scene"}, "per: expected"),
        ({"also": ("all",)}, "also: expected"),
        ({"protocol": "best"}, "protocol: expected"),
        ({"what": "labels", "predicted_camera": lambda w, h: PINHOLE}, "predicted camera: expected depth"),
    ],
    ids=["what", "per", "also", "protocol", "camera of labels"],
)
def test_wrong_options_are_refused(tmp_path, truth, options, expected):
    with pytest.raises(ArgumentError, match=expected):
        score(tmp_path, truth, **options)


def test_frames_of_some_cameras_of_a_dataset_are_scored(tmp_path, capsys):
    from omniscv import dataset
    from omniscv.job import read
    from omniscv.make import make

    job = {
        "source": "scene://four-wall",
        "cameras": {
            "pano": {"model": "equirectangular", "width": 32, "height": 16},
            "ring": {"model": "noncentral-panorama", "width": 32, "height": 16, "radius": 0.2},
        },
        "poses": [{"position": [0, 0, 1.5]}],
        "modes": ["depth"],
        "out": str(tmp_path / "set"),
    }
    make(read(job, tmp_path))
    for frame in dataset.open(tmp_path / "set"):
        np.save(tmp_path / f"{frame.key}.npy", 2 * frame.layer("depth"))
    (item,) = score(tmp_path, tmp_path / "set", cameras=("pano",))
    assert item.name.startswith("pano")
    assert run(["score", str(tmp_path), str(tmp_path / "set")]) == 2
    expected = "expected a camera with one optical centre, got 'noncentral-panorama'"
    assert f"{expected}: choose a dataset's cameras with --cameras" in capsys.readouterr().err
    with pytest.raises(ArgumentError, match="cameras: expected"):
        score(tmp_path, tmp_path / "set", cameras=("other",))
