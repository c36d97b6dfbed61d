"""Errors of trajectories, judged by evo and by the paper's formulas as they are printed."""

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from evo.core import geometry, metrics, trajectory

from omniscv.errors import ArgumentError
from omniscv.evaluate.odometry.pose_estimation import path_length, rms, trajectory_errors, umeyama
from omniscv.geometry import Pose

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


def of_evo(metric, reference, estimate):
    metric.process_data((reference, estimate))
    return metric.get_statistic(metrics.StatisticsType.rmse), metric.error


def test_evo_aligns_and_scores_alike():
    estimates = estimated()
    ours = trajectory_errors(TRUTH, estimates)
    reference, theirs = in_evo(TRUTH), in_evo(estimates.values())
    theirs.align(reference, correct_scale=True)
    ate, each = of_evo(metrics.APE(metrics.PoseRelation.translation_part), reference, theirs)
    assert rms(ours.position_m) == pytest.approx(ate, rel=1e-9)
    assert ours.position_m == pytest.approx(each, rel=1e-9)
    _, turns = of_evo(metrics.APE(metrics.PoseRelation.rotation_angle_deg), reference, theirs)
    assert ours.eps_theta_deg == pytest.approx(turns, abs=1e-6)
    rpe, _ = of_evo(metrics.RPE(metrics.PoseRelation.translation_part, 1), reference, theirs)
    assert rms(ours.step_m) == pytest.approx(rpe, rel=1e-9)
    rpe, _ = of_evo(metrics.RPE(metrics.PoseRelation.rotation_angle_deg, 1), reference, theirs)
    assert rms(ours.step_deg) == pytest.approx(rpe, rel=1e-6)
    assert path_length(TRUTH) == pytest.approx(reference.path_length)


def test_mirrored_points_are_turned_not_mirrored():
    points = DRAW.normal(size=(20, 3))
    mirrored = points * (1, 1, -1)
    scale, rotation, translation = umeyama(points, mirrored)
    R, t, s = geometry.umeyama_alignment(points.T, mirrored.T, with_scale=True)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation, R, atol=1e-12)
    np.testing.assert_allclose(translation, t, atol=1e-12)
    assert scale == pytest.approx(s)


def test_the_papers_two_errors_are_its_formulas():
    errors = trajectory_errors(TRUTH, estimated(), origin := np.array([0.4, -0.2, 3.0]))
    for i, pose in enumerate(errors.aligned):
        t_gt, t_est = TRUTH[i].position - origin, pose.position - origin
        cosine = t_gt @ t_est / np.linalg.norm(t_gt) / np.linalg.norm(t_est)
        assert errors.eps_t_deg[i] == pytest.approx(np.degrees(np.arccos(cosine)), abs=1e-6)
        trace = np.trace(TRUTH[i].rotation @ pose.rotation.T)
        assert errors.eps_theta_deg[i] == pytest.approx(np.degrees(np.arccos((trace - 1) / 2)), abs=1e-6)


def test_steps_over_missing_frames_do_not_count():
    estimates = estimated()
    del estimates[4], estimates[17], estimates[18]
    errors = trajectory_errors(TRUTH, estimates)
    assert errors.frames == sorted(estimates)
    assert len(errors.step_m) == len(errors.step_deg) == 29 - 2 - 3


def test_too_few_poses_and_positions_on_a_line_have_no_alignment():
    for count in (0, 2):
        with pytest.raises(ArgumentError, match="positions: expected 3 or more"):
            trajectory_errors(TRUTH, dict(list(estimated().items())[:count]))
    line = np.outer(np.arange(5), (1.0, 2, 3))
    for points, targets in ((line, DRAW.normal(size=(5, 3))), (DRAW.normal(size=(5, 3)), line)):
        with pytest.raises(ArgumentError, match="expected some off a line"):
            umeyama(points, targets)
