"""Exports whose poses are judged by the pictures of their dataset, which no code of the exports reads."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.overlapping import walk

from omniscv import cli, storage
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
TUM = "exports/poses/flat.tum"
FILES = {
    "frames.jsonl": "camera-to-world, axes camera",
    "exports/colmap/sparse/0/images.txt": "world-to-camera, axes camera",
    "exports/euroc/mav0/state_groundtruth_estimate0/data.csv": "camera-to-world, axes camera",
    "exports/nerfstudio/transforms.json": "camera-to-world, axes opengl",
    TUM: "camera-to-world, axes camera",
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


def test_pictures_find_the_convention_that_each_format_has_and_poses_that_no_longer_have_it(folder, capsys):
    rows = [line.split() for line in (folder / TUM).read_text().splitlines() if line[0] != "#"]
    in_cm = [[time, *(f"{100 * float(n)}" for n in row[:3]), *row[3:]] for time, *row in rows]
    (folder / TUM).write_text("".join(f"{' '.join(row)}\n" for row in in_cm))
    assert cli.run(["dataset", "check", str(folder), "--pictures"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(": flat: ")[0] for line in lines] == [*FILES]
    for line, (file, says) in zip(lines, FILES.items(), strict=True):
        said = f"as said, {says}" if file != TUM else f"{says}, positions in cm"
        assert f"pictures: {said}, depth along the ray" in line
        assert file == TUM or "depth along the ray: agreement 0." in line


def test_a_url_is_asked_as_its_folder_is(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("OMNISCV_CACHE", str(tmp_path))
    url = f"memory://{tmp_path.name}"
    for path in folder.rglob("*"):
        if path.is_file():
            storage.folder(url).put(path.relative_to(folder).as_posix(), path)
    lines = list(check_pictures(url))
    assert lines == list(check_pictures(str(folder)))
    assert len(lines) == len(FILES)


def test_datasets_that_cannot_be_asked_are_refused(copied, capsys):
    assert cli.run(["dataset", "check", str(copied), "--pictures", "--format", "webdataset"]) == 2
    assert "format: expected one of nerfstudio, colmap, poses, euroc" in capsys.readouterr().err
