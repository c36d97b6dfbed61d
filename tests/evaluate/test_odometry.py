"""Odometry end to end: images of the mock's room, COLMAP, scores and files; errors judged by evo."""

import csv
import json
import subprocess
import sys
import warnings

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from omniscv import evaluate
from omniscv.calibration.files import load_file, load_on_body
from omniscv.cameras import create
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError, OmniscvError
from omniscv.evaluate import Settings, odometry
from omniscv.evaluate.odometry import pose_estimation
from omniscv.evaluate.odometry.pose_estimation import path_length, reconstruct, rms, trajectory_errors
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.geometry.trajectory_files import read_trajectory, write_tum
from omniscv.job import load
from omniscv.make import make
from omniscv.sources.registry import open_source

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from evo.core import geometry, metrics, trajectory

ARC = odometry.flight(60)[:15:3]
MIRROR = RigCamera.turned(create("catadioptric-hyperbolic", 320, 320), pitch_deg=90)
RIG = Rig({"panorama": RigCamera(create("equirectangular", 512, 256)), "mirror": MIRROR})


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    with open_source("scene://four-wall") as source:
        done = []
        yield odometry.render(RIG, ARC, source, tmp_path_factory.mktemp("images"), done.append)
    assert done == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("name", ["panorama", "mirror"])
def test_an_arc_is_recovered(images, name):
    mounted = RIG.cameras[name]
    estimates = reconstruct(images[name], mounted.camera)
    assert list(estimates) == list(range(len(ARC)))
    errors = trajectory_errors(ARC, {i: pose @ mounted.pose.inverse() for i, pose in estimates.items()})
    assert rms(errors.position_m) < 0.01 * path_length(ARC)
    assert max(errors.eps_t_deg.max(), errors.eps_theta_deg.max()) < 2


def test_the_same_images_give_the_same_poses(images):
    camera = RIG.cameras["mirror"].camera
    first, again = (reconstruct(images["mirror"][:3], camera) for _ in range(2))
    assert len(first) == 3
    assert [pose.to_dict() for pose in first.values()] == [pose.to_dict() for pose in again.values()]


def test_the_rim_of_the_image_circle_has_no_features():
    camera = create("fisheye-equidistant", 200, 200, fov_deg=170)
    inner = pose_estimation.inner_mask(camera) > 0
    radius = np.hypot(*np.moveaxis(camera.pixels() - 100, -1, 0))
    assert inner[radius < 90].all()
    assert not inner[8:-8, 8:-8][radius[8:-8, 8:-8] > 96].any()
    assert pose_estimation.inner_mask(create("equirectangular", 64, 32)).all()


def test_a_report_of_a_flight_too_short_to_score(tmp_path, monkeypatch):
    """Two poses have no alignment: there are figures of what was registered, and no errors."""
    monkeypatch.setattr(odometry, "rig_of", lambda width, edge, rig_of=odometry.rig_of: rig_of(128, 96))
    path = tmp_path / "two.tum"
    path.write_text(write_tum(Trajectory.timed(ARC.poses[:2], (5.0, 6.5))))
    done = []
    options = {"options": {"trajectory": path}, "progress": lambda *at: done.append(at)}
    report = evaluate.run("odometry", Settings(tmp_path, quick=True, **options))
    assert done == [(1, 8), (2, 8), (4, 8), (6, 8), (8, 8)]
    values = {figure.name: figure for figure in report.figures}
    assert values["panorama: registered"].value == 0
    assert values["panorama: registered"].n == 2
    assert np.isnan(values["mirror: ATE, rms"].value)
    assert {figure.paper for figure in report.figures if "eps" in figure.name} == {8.0}
    written = report.write("odometry", tmp_path)
    names = "odometry.json", "odometry.csv", "odometry.png", "odometry/truth.tum"
    assert set(written) == {tmp_path / name for name in names}
    rows = list(csv.DictReader((tmp_path / "odometry.csv").read_text().splitlines()))
    assert [row["time_s"] for row in rows] == ["5.0", "6.5"] * 3
    assert {row["eps_t_deg"] for row in rows} == {""}
    assert json.loads((tmp_path / "odometry.json").read_text())["about"]["poses"] == 2
    assert read_trajectory(tmp_path / "odometry" / "truth.tum").seconds == (5.0, 6.5)
    for name, size in (("odometry.png", (1200, 460)), ("odometry/mirror/0001.png", (96, 96))):
        with Image.open(tmp_path / name) as picture:
            assert picture.size == size


def test_a_missing_pycolmap_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(OmniscvError, match=r"expected pycolmap; install omniscv\[evaluate\]"):
        evaluate.run("odometry", Settings(tmp_path))


@pytest.mark.soak
def test_a_command_that_loaded_pycolmap_can_still_be_stopped():
    """Importing it alone makes SIGTERM print a stack and end the process at once."""
    script = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))\n"
        "from omniscv.evaluate.odometry.pose_estimation import load_pycolmap\n"
        "load_pycolmap()\n"
        "os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (7, "")


def test_a_missing_trajectory_and_colours_of_floating_point_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"nothing\.tum"):
        evaluate.run("odometry", Settings(tmp_path, options={"trajectory": tmp_path / "nothing.tum"}))
    with open_source("scene://four-wall?lit=float32") as source, pytest.raises(ArgumentError, match="bytes"):
        odometry.render(RIG, ARC[:1], source, tmp_path, lambda done: None)


@pytest.mark.soak
def test_the_papers_bounds_are_kept(tmp_path):
    report = evaluate.run("odometry", Settings(tmp_path, quick=True))
    values = {figure.name: figure.value for figure in report.figures}
    assert values["panorama: registered"] >= 95
    assert values["panorama: ATE, rms, of the path"] <= 1
    assert values["panorama: turn, mean"] <= 0.5
    assert values["panorama: eps_t, largest"] <= 1
    assert values["panorama: eps_theta, largest"] <= 1
    for camera in ("panorama", "fisheye", "mirror"):
        assert values[f"{camera}: eps_t, largest"] < 8
        assert values[f"{camera}: eps_theta, largest"] < 8


EUROC = """
source: scene://four-wall
rig:
  cameras:
    left:
      camera: &fisheye {model: kannala-brandt, width: 512, height: 400, fx: 160, fy: 160}
      position: [-0.06, 0, 0]
    right: {camera: *fisheye, position: [0.06, 0, 0]}
imu: {position: [0, 0.03, -0.02]}
poses: {file: flight.tum}
modes: [lit]
out: slam
export: [euroc]
"""  # the rig of examples/slam/slam.yaml; its own path has places that COLMAP takes for each other


@pytest.mark.soak
def test_a_euroc_sequence_gives_its_trajectory(tmp_path):
    """From the exported files alone: pictures, intrinsics, extrinsics, the true state; for each fisheye."""
    (tmp_path / "flight.tum").write_text(write_tum(odometry.flight(24)))
    (tmp_path / "slam.yaml").write_text(EUROC)
    make(load(tmp_path / "slam.yaml"))
    root = tmp_path / "slam/exports/euroc/mav0"
    for name in ("cam0", "cam1"):
        sensor = root / name / "sensor.yaml"
        (entry,) = load_file(sensor).entries.values()
        (mounted,) = load_on_body(sensor).values()
        state = read_trajectory(root / "state_groundtruth_estimate0/data.csv", frame=mounted)
        pictures = sorted((root / name / "data").iterdir(), key=lambda picture: int(picture.stem))
        truth = [state.at(int(picture.stem) / 1e9, steps_beyond=1) for picture in pictures]
        estimates = reconstruct(pictures, entry.camera)
        assert len(estimates) == len(pictures) == 24
        assert rms(trajectory_errors(truth, estimates).position_m) <= 0.01 * path_length(truth)


DRAW = np.random.default_rng(3)
TRUTH = [
    Pose(place, turn)
    for place, turn in zip(DRAW.normal(size=(30, 3)), Rotation.random(30, rng=DRAW).as_matrix(), strict=True)
]


def estimated(noise=0.05, scale=0.3):
    """The true poses with noise, in another frame and scale."""
    turn = Rotation.from_euler("xyz", (40, -70, 160), degrees=True).as_matrix()
    small = Rotation.from_rotvec(noise * DRAW.normal(size=(len(TRUTH), 3))).as_matrix()
    return {
        i: Pose(
            scale * turn @ (pose.position + noise * DRAW.normal(size=3)) + (5, -3, 2),
            turn @ pose.rotation @ small[i],
        )
        for i, pose in enumerate(TRUTH)
    }


def in_evo(poses):
    rows = [np.vstack([np.column_stack([p.rotation, p.position]), [0, 0, 0, 1]]) for p in poses]
    return trajectory.PosePath3D(poses_se3=rows)


def test_evo_aligns_and_scores_alike():
    estimates = estimated()
    ours = trajectory_errors(TRUTH, estimates)
    reference = in_evo(TRUTH)
    theirs = in_evo(estimates.values())
    theirs.align(reference, correct_scale=True)
    metres = metrics.PoseRelation.translation_part
    degrees = metrics.PoseRelation.rotation_angle_deg
    for metric, values in (
        (metrics.APE(metres), ours.position_m),
        (metrics.APE(degrees), ours.eps_theta_deg),
        (metrics.RPE(metres, 1), ours.step_m),
        (metrics.RPE(degrees, 1), ours.step_deg),
    ):
        metric.process_data((reference, theirs))
        assert values == pytest.approx(metric.error, rel=1e-9, abs=1e-6 if metric.unit.value == "deg" else 0)
        assert rms(values) == pytest.approx(metric.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)
    assert path_length(TRUTH) == pytest.approx(reference.path_length)


def test_mirrored_points_are_turned_not_mirrored():
    points = DRAW.normal(size=(20, 3))
    mirrored = points * (1, 1, -1)
    scale, rotation, translation = pose_estimation.umeyama(points, mirrored)
    R, t, s = geometry.umeyama_alignment(points.T, mirrored.T, with_scale=True)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation, R, atol=1e-12)
    np.testing.assert_allclose(translation, t, atol=1e-12)
    assert scale == pytest.approx(s)


def test_the_papers_two_errors_are_its_formulas():
    errors = trajectory_errors(TRUTH, estimated(), origin := np.array([0.4, -0.2, 3.0]))
    for i, pose in enumerate(errors.aligned):
        t_gt = TRUTH[i].position - origin
        t_est = pose.position - origin
        cosine = t_gt @ t_est / np.linalg.norm(t_gt) / np.linalg.norm(t_est)
        assert errors.eps_t_deg[i] == pytest.approx(np.degrees(np.arccos(cosine)), abs=1e-6)
        trace = np.trace(TRUTH[i].rotation @ pose.rotation.T)
        assert errors.eps_theta_deg[i] == pytest.approx(np.degrees(np.arccos((trace - 1) / 2)), abs=1e-6)


def test_missing_poses_make_no_steps_and_too_few_or_those_on_a_line_have_no_alignment():
    estimates = estimated()
    del estimates[4], estimates[17], estimates[18]
    errors = trajectory_errors(TRUTH, estimates)
    assert errors.frames == sorted(estimates)
    assert len(errors.step_m) == len(errors.step_deg) == 29 - 2 - 3
    for count in (0, 2):
        with pytest.raises(ArgumentError, match="positions: expected 3 or more"):
            trajectory_errors(TRUTH, dict(list(estimated().items())[:count]))
    line = np.outer(np.arange(5), (1.0, 2, 3))
    for points, targets in ((line, DRAW.normal(size=(5, 3))), (DRAW.normal(size=(5, 3)), line)):
        with pytest.raises(ArgumentError, match="expected some off a line"):
            pose_estimation.umeyama(points, targets)
