"""A rig in a job: plan, record, render and datasets count and capture the same."""

import json
from pathlib import Path

import numpy as np
import pytest

from omniscv import Pose, Rig, RigCamera, calibration, cameras, dataset, open_source
from omniscv.errors import ArgumentError
from omniscv.job import Job, load
from omniscv.make import capture, costs, run
from omniscv.make.instants import frames_by_instant

LENS = cameras.create("kannala-brandt", width=20, height=20, fx=7.0, fy=7.0)
RIG = Rig({"cam0": RigCamera(LENS), "cam1": RigCamera.turned(LENS, yaw_deg=180, time_offset=0.5)})
TIMED = "0 0 0 1.5 0.5 -0.5 0.5 -0.5\n1 1 0 1.5 0.5 -0.5 0.5 -0.5\n2 2 0 1.5 0.5 -0.5 0.5 -0.5\n"
INLINE = """
  cameras:
    ahead: {camera: {model: fisheye-equidistant, width: 20, height: 20, fov_deg: 190}}
    behind: {camera: {model: fisheye-equidistant, width: 20, height: 20, fov_deg: 190}, yaw_deg: 180}
"""
POSES = "[{position: [0, 0, 1.5]}, {position: [0.5, 0, 1.5], yaw_deg: 30}]"


def job_of(tmp_path: Path, rig: str, poses: str, more: str = "") -> Job:
    text = f"source: scene://four-wall\nrig: {rig}\nposes: {poses}\nface_size: 16\n{more}"
    (tmp_path / "job.yaml").write_text(text, encoding="utf-8")
    return load(tmp_path / "job.yaml")


def frames_of(job: Job) -> list[dataset.Frame]:
    return [frame for shared in frames_by_instant(job) for frame in shared.frames]


def test_plan_record_and_render_need_the_same_captures(tmp_path: Path) -> None:
    sphere = "cameras: {sphere: {model: equirectangular, width: 32, height: 16}}\nrecord: room.sqlite\n"
    job = job_of(tmp_path, INLINE, POSES, sphere + "modes: [lit, depth]\n")
    assert [frame.key for frame in frames_of(job)] == [
        f"{name}-{i}" for i in (0, 1) for name in ("ahead", "behind", "sphere")
    ]
    planned = {cost.way: cost.requests for cost in costs(job)}
    assert planned["auto"] == planned["cube"] == 2 * 6 * 2  # one cube map a pose, in two modes
    assert capture(job, tmp_path / "room.sqlite").needed == planned["auto"]
    with open_source(tmp_path / "room.sqlite") as recorded:
        before = set(recorded.recorded_views())
    written = run(job)
    with open_source(tmp_path / "room.sqlite") as recorded:
        assert set(recorded.recorded_views()) == before
    assert {path.name.partition(".")[0] for path in written} == {frame.key for frame in frames_of(job)}
    behind = json.loads((tmp_path / "out" / "behind-0.json").read_text(encoding="utf-8"))
    turned = Pose.from_angles((0, 0, 1.5), yaw_deg=180)
    np.testing.assert_allclose(behind["pose"]["rotation"], turned.R_w_c, atol=1e-12)


@pytest.mark.parametrize("format", ["kalibr", "json"])
def test_a_rigs_file_and_a_trajectory_place_late_cameras(tmp_path: Path, format: str) -> None:
    calibration.save_rig(tmp_path / "rig", RIG, format)  # type: ignore[arg-type]
    (tmp_path / "path.txt").write_text(TIMED, encoding="utf-8")
    job = job_of(tmp_path, "rig", "path.txt")
    places = {frame.key: frame.pose.t_w_c.tolist() for frame in frames_of(job)}
    expected = {"cam0-0": 0.0, "cam1-0": 0.5, "cam0-1": 1.0, "cam1-1": 1.5}
    assert places == {stem: pytest.approx([x, 0, 1.5]) for stem, x in expected.items()}
    times = {frame.key: frame.time for frame in frames_of(job)}
    assert times == expected


@pytest.mark.parametrize(
    ("rig", "poses", "more", "says"),
    [
        ("1", POSES, "", "rig: expected a file's name or cameras"),
        ("none.yaml", POSES, "", "rig: .*none.yaml: expected"),
        ("{cameras: {}}", POSES, "", "rig: cameras: expected cameras by name"),
        (INLINE, POSES, "cameras: {ahead: {model: pinhole, width: 4, height: 3}}\n", "got ahead$"),
        ("rig", POSES, "", "cam1: time_offset 0.5 s, and poses without times"),
    ],
)
def test_a_rig_that_does_not_fit_is_refused(
    tmp_path: Path, rig: str, poses: str, more: str, says: str
) -> None:
    calibration.save_rig(tmp_path / "rig", RIG, "json")
    with pytest.raises(ArgumentError, match=says) as caught:
        job_of(tmp_path, rig, poses, more)
    assert "\n" not in str(caught.value)
