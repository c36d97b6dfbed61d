"""``--camera FILE``, a calibration file as a camera of a job, and the examples of models."""

import json
import shlex

import numpy as np
import pytest

from omniscv import calibration, cameras
from omniscv.cli import run
from omniscv.errors import ArgumentError
from omniscv.job import load

K = [[21.0, 0.0, 15.5], [0.0, 21.5, 11.5], [0.0, 0.0, 1.0]]
D = [0.02, -0.008, 0.002, -0.0004]
FISHEYE = calibration.from_opencv_fisheye(K, D, 32, 24)
PLAIN = calibration.from_opencv(K, D, 32, 24)

MATRICES = {"camera": K, "rectification": np.eye(3).tolist(), "projection": np.c_[K, np.zeros(3)].tolist()}
ROS = json.dumps(
    {"image_width": 32, "image_height": 24, "camera_name": "narrow_stereo", "distortion_model": "MODEL"}
    | {"distortion_coefficients": {"rows": 1, "cols": 4, "data": D}}
    | {f"{of}_matrix": {"rows": 3, "cols": len(M[0]), "data": [*np.ravel(M)]} for of, M in MATRICES.items()}
)
"""A file of ROS; JSON is YAML."""


def written(folder, text, name="lens.yaml"):
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize(
    "keys", [("K", "D"), ("camera_matrix", "dist_coeffs"), ("cameraMatrix", "distCoeffs")]
)
def test_bare_matrices_need_a_size_and_four_coefficients_a_format(keys, tmp_path):
    path = written(tmp_path, f"{keys[0]}: {K}\n{keys[1]}: {D}\n")
    with pytest.raises(ArgumentError, match=r"opencv \(k1 k2 p1 p2 of the plain model\) or opencv-fisheye"):
        calibration.load(path, size=(32, 24))
    sizeless = r"missing key 'image_width': add it, or give the size \(--size\)"
    with pytest.raises(ArgumentError, match=sizeless):
        calibration.load(path, "opencv")
    assert calibration.load(path, "opencv", (32, 24)) == {"cam0": PLAIN}
    assert calibration.load(path, "opencv-fisheye", (32, 24)) == {"cam0": FISHEYE}
    with pytest.raises(ArgumentError, match="size: expected 32 x 24, got 64 x 48"):
        calibration.load(written(tmp_path, ROS.replace("MODEL", "plumb_bob"), "ros.yaml"), size=(64, 48))
    five = written(tmp_path, f"{keys[0]}: {K}\n{keys[1]}: [{[*D, 0.0]}]\n")
    assert calibration.load(five, size=(32, 24))["cam0"].name == "pinhole"


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


RENDER = ["render", "--source", "scene://four-wall", "--set", "face_size=32", "--out", "out"]


def rendered(here, stem):
    return cameras.from_dict(json.loads((here / "out" / f"{stem}.json").read_text())["camera"])


def test_a_calibration_file_is_a_camera_of_the_command_line(here, capsys):
    written(here, ROS.replace("MODEL", "equidistant"), "my.lens.yaml")
    assert run([*RENDER, "--camera", "my.lens.yaml"]) == 0
    assert rendered(here, "my-lens") == FISHEYE
    written(here, f"K: {K}\nD: {D}\n", "bare.yaml")
    bare = [*RENDER, "--camera", "bare.yaml", "--size", "32x24"]
    assert run(bare) == 2
    assert "--set camera.format=opencv" in capsys.readouterr().err
    assert run([*bare, "--set", "camera.format=opencv"]) == 0
    assert rendered(here, "bare") == PLAIN
    calibration.save("chain.yaml", {"cam0": FISHEYE, "cam1": PLAIN}, "kalibr")
    assert run([*RENDER, "--camera", "chain.yaml"]) == 2
    assert "chain.yaml: name: expected one of cam0, cam1; got None" in capsys.readouterr().err
    assert run([*RENDER, "--camera", "chain.yaml", "--set", "camera.name=cam1"]) == 0
    assert rendered(here, "chain") == PLAIN


def test_a_job_names_files_relative_to_its_own(here):
    (here / "jobs").mkdir()
    calibration.save("jobs/chain.yaml", {"cam0": FISHEYE, "cam1": PLAIN}, "kalibr")
    calibration.save("jobs/lens.json", {"cam0": PLAIN}, "json")
    calibration.save("other.json", {"cam0": FISHEYE}, "json")
    text = "source: scene://four-wall\nposes: [{position: [0, 0, 1.5]}]\nface_size: 32\nout: ../out\n"
    listed = "cameras: {left: {file: chain.yaml, name: cam0}, right: lens.json}\n"
    job = written(here / "jobs", text + listed, "job.yaml")
    assert load(job).cameras == {"left": FISHEYE, "right": PLAIN}
    assert run(["render", str(job), "--camera", "other.json"]) == 0
    assert rendered(here, "other") == FISHEYE


@pytest.mark.parametrize("name", cameras.names())
def test_the_example_of_a_model_is_its_typical_camera(name, here, monkeypatch, capsys):
    """As far as six digits say; images of these cameras have tests of their own."""
    jobs = []
    monkeypatch.setattr("omniscv.make.run", lambda job, *_, **__: jobs.append(job) or [])
    assert run(["cameras", name]) == 0
    *text, example = capsys.readouterr().out.splitlines()
    lens = cameras.model(name).lens
    assert lens is None or not lens.names or text[-1] == f"In lens files: {lens}"
    assert run(shlex.split(example.removeprefix("Example: omniscv "))) == 0
    typical = cameras.model(name).example(256)
    (camera,) = jobs[0].cameras.values()
    (pose,) = jobs[0].poses
    assert (camera.name, camera.width, camera.height) == (name, 256, typical.height)
    both = camera.valid() & typical.valid()
    assert both.mean() > 0.99 * typical.valid().mean()
    turned = camera.unproject().directions[both] - typical.unproject().directions[both]
    assert np.abs(turned).max() < 1e-4
    assert pose.angles()[1] == pytest.approx(typical.typical_pitch_deg)


def test_a_file_is_described_and_converted(here, capsys):
    """One command turns a chain into VINS's file; what that lacks is fitted, and the error is printed."""
    lens = cameras.create("double-sphere", 64, 48, fx=18, fy=18, xi=-0.2, alpha=0.6)
    calibration.save("chain.yaml", {"cam0": FISHEYE, "cam1": lens}, "kalibr")
    assert run(["cameras", "describe", "chain.yaml"]) == 0
    printed = capsys.readouterr().out
    assert "chain.yaml: kalibr" in printed
    assert "cam1: double-sphere, 64x48 px" in printed
    assert run(["cameras", "describe", "chain.yaml", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["cameras"]
    assert [row["model"] for row in rows] == ["kannala-brandt", "double-sphere"]
    one = ["cameras", "convert", "chain.yaml", "out.yaml", "--format", "camodocal", "--name"]
    assert run([*one, "cam0"]) == 0
    assert calibration.load("out.yaml") == {"cam0": FISHEYE}
    capsys.readouterr()
    assert run([*one, "cam1"]) == 2
    assert "camodocal: expected" in capsys.readouterr().err
    assert run(["cameras", "convert", "chain.yaml", "cameras.txt", "--format", "colmap", "--fit"]) == 0
    assert "largest error" in capsys.readouterr().out
    assert list(calibration.load("cameras.txt")) == ["1", "2"]
    assert run(["cameras", "describe", "nothing.yaml"]) == 2
