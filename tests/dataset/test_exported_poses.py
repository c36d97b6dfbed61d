"""Exports whose poses are judged by the pictures of their dataset, which no code of the exports reads."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.overlapping import walk

from omniscv import cli
from omniscv.diagnostics.exported_poses import check_pictures

JOB = """
source: scene://four-wall
cameras: {flat: {model: pinhole, width: 48, height: 36, fov_deg: 80}}
imu: {rate: 200}
poses: {file: path.csv, frame: camera}
modes: [lit, depth]
export: [nerfstudio, colmap, poses, euroc]
out: dataset
"""
FILES = {
    "frames.jsonl": "camera-to-world, axes camera",
    "exports/colmap/sparse/0/images.txt": "world-to-camera, axes camera",
    "exports/euroc/mav0/state_groundtruth_estimate0/data.csv": "camera-to-world, axes camera",
    "exports/nerfstudio/transforms.json": "camera-to-world, axes opengl",
    "exports/poses/flat.tum": "camera-to-world, axes camera",
    "exports/poses/flat.euroc": "camera-to-world, axes camera",
    "exports/poses/flat.kitti": "camera-to-world, axes camera",
}
"""The convention that each file has."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("posed")
    R, t = walk(np.arange(4), 3, step_deg=5.0)
    rows = np.column_stack([np.arange(4) / 2, 0.8 * t, Rotation.from_matrix(R).as_quat()])
    (folder / "path.csv").write_text("\n".join(" ".join(f"{v:.9f}" for v in row) for row in rows))
    (folder / "job.yaml").write_text(JOB)
    assert cli.run(["dataset", "make", str(folder / "job.yaml"), "--set", f"out={folder / 'dataset'}"]) == 0
    return folder / "dataset"


def test_pictures_find_the_convention_that_each_format_has(folder, capsys):
    assert cli.run(["dataset", "check", str(folder), "--pictures"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(": flat: ")[0] for line in lines[:-1]] == [*FILES]
    for line, says in zip(lines, FILES.values(), strict=False):
        assert f"pictures: as said, {says}, depth along the ray: agreement 0." in line


def test_poses_that_are_no_longer_those_of_the_format_are_a_fault(folder):
    file = folder / "exports/colmap/sparse/0/images.txt"
    written = file.read_text()
    lines = [line.split(" ") for line in written.splitlines()]
    rows = [line for line in lines if len(line) > 8]
    turned = [[*row[:5], *(f"{100 * float(n)}" for n in row[5:8]), *row[8:]] for row in rows]
    file.write_text("\n\n".join(" ".join(line) for line in turned if line[0] != "#") + "\n\n")
    try:
        own, colmap = check_pictures(str(folder), "colmap")
    finally:
        file.write_text(written)
    assert not own[1]
    assert colmap[1]
    assert "pictures: world-to-camera, axes camera, positions in cm, depth along the ray" in colmap[0]


def test_datasets_that_cannot_be_asked_are_refused(copied, capsys):
    assert cli.run(["dataset", "check", str(copied), "--pictures", "--format", "webdataset"]) == 2
    assert "format: expected one of nerfstudio, colmap, poses, euroc" in capsys.readouterr().err
