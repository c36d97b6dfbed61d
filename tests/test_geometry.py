"""Poses and frames: laws, and Unreal's own table of cube faces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

import omniscv
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, cube_rotations

angle = st.one_of(st.floats(-180, 180), st.sampled_from([-180.0, -90.0, 0.0, 90.0, 180.0]))
hair = st.floats(0, 1e-3)
poles = st.one_of(st.sampled_from([-90.0, 90.0]), hair.map(lambda d: 90 - d), hair.map(lambda d: d - 90))
pitch = st.one_of(st.floats(-90, 90), poles)
coordinate = st.floats(-1e4, 1e4)
position = st.tuples(coordinate, coordinate, coordinate)

# Protocol reference, section 4: rotator, forward, image right, image up, in Unreal's axes.
X, Y, Z = np.eye(3)
FACES = {
    "front": ((0, 0, 0), X, Y, Z),
    "right": ((0, 90, 0), Y, -X, Z),
    "back": ((0, 180, 0), -X, -Y, Z),
    "left": ((0, -90, 0), -Y, X, Z),
    "up": ((90, 0, 0), Z, Y, -X),
    "down": ((-90, 0, 0), -Z, Y, X),
}


def mirrored(v):
    return v * (1, -1, 1)


@pytest.mark.parametrize("face", FACES)
def test_faces_look_where_unreal_says(face):
    rotator, forward, right, up = FACES[face]
    R_w_c = omniscv.Pose.from_unreal((0, 0, 0), rotator).R_w_c
    np.testing.assert_array_equal(R_w_c @ (0, 0, 1), mirrored(forward))
    np.testing.assert_array_equal(R_w_c @ (1, 0, 0), mirrored(right))
    np.testing.assert_array_equal(R_w_c @ (0, -1, 0), mirrored(up))
    np.testing.assert_array_equal(dict(cube_rotations())[face], R_w_c)


@cases(15)
@given(position, pitch, angle, angle)
def test_unreal_or_angles_and_back_is_the_same_pose(location, pitch_deg, yaw, roll):
    pose = omniscv.Pose.from_unreal(location, (pitch_deg, yaw, roll))
    again = omniscv.Pose.from_unreal(*pose.to_unreal())
    # Matrices, not angles: yaw and roll are one turn at the poles. 1e-9 rad is 1e-6 px at f = 1000.
    np.testing.assert_allclose(again.R_w_c, pose.R_w_c, atol=2e-9)
    np.testing.assert_allclose(again.t_w_c, pose.t_w_c, rtol=1e-14, atol=1e-12)

    again = omniscv.Pose.from_angles(pose.position, *pose.angles())
    np.testing.assert_allclose(again.R_w_c, pose.R_w_c, atol=2e-9)
    for both in (pose @ pose.inverse(), pose.inverse() @ pose):
        np.testing.assert_allclose(both.rotation, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(both.position, 0, atol=1e-10)  # rounding of 10 km


@cases(15)
@given(position, pitch, angle, angle, position)
def test_up_right_in_unreal_is_up_right_here(location, pitch_deg, yaw, roll, target):
    """A point's coordinates along Unreal's forward, right and up are ours along z, x and -y."""
    p, y, r = np.radians((pitch_deg, yaw, roll))
    (sp, sy, sr) = np.sin((p, y, r))
    (cp, cy, cr) = np.cos((p, y, r))
    # Roll, then pitch, then yaw about fixed axes, written out as three turns (not the closed form).
    turn_yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    turn_pitch = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    turn_roll = np.array([[1, 0, 0], [0, cr, sr], [0, -sr, cr]])
    seen = (turn_yaw @ turn_pitch @ turn_roll).T @ (np.array(target) - location)  # forward, right, up, cm
    pose = omniscv.Pose.from_unreal(location, (pitch_deg, yaw, roll))
    p_c = pose.to_camera(mirrored(np.array(target)) / 100)
    np.testing.assert_allclose(p_c, np.array([seen[1], -seen[2], seen[0]]) / 100, atol=1e-9)


def test_level_pose():
    np.testing.assert_array_equal(omniscv.Pose.from_angles((1, 2, 3)).R_w_c, R_LEVEL)
    left = omniscv.Pose.from_angles((0, 0, 0), yaw_deg=90)
    np.testing.assert_allclose(left.to_world((0, 0, 2)), (0, 2, 0), atol=1e-15)
    up = omniscv.Pose.from_angles((0, 0, 0), pitch_deg=30)
    assert up.to_world((0, 0, 1))[2] == pytest.approx(0.5)
    rolled = omniscv.Pose.from_angles((0, 0, 0), roll_deg=90)
    np.testing.assert_allclose(rolled.to_world((1, 0, 0)), (0, 0, -1), atol=1e-15)  # right side down


def test_wrong_arguments_are_named_and_a_pose_cannot_be_changed():
    for build, named in (
        (lambda: omniscv.Pose.from_angles((np.nan, 0, 0)), "position"),
        (lambda: omniscv.Pose.from_angles((0, 0)), "position"),
        (lambda: omniscv.Pose.from_unreal((0, 0, 0), (0, np.inf, 0)), "rotation_deg"),
        (lambda: omniscv.Pose((0, 0, 0), np.diag([1, 1, -1])), "rotation"),
        (lambda: omniscv.Pose((0, 0, 0), 2 * np.eye(3)), "rotation"),
        (lambda: omniscv.Pose("here", np.eye(3)), "position"),
    ):
        with pytest.raises(ValueError, match=rf"^{named}: expected .*got "):
            build()
    with pytest.raises(ValueError):
        omniscv.Pose.from_angles((0, 0, 0)).position[0] = 1


@cases(15)
@given(position, position)
def test_the_point_is_ahead_and_the_image_upright(where, target):
    apart = np.subtract(target, where)
    if np.hypot(*apart[:2]) < 1e-3:
        return
    pose = omniscv.Pose.look_at(where, target)
    x, y, z = pose.to_camera(target)
    distance = np.linalg.norm(apart)
    assert np.hypot(x, y) <= 1e-12 * max(1, distance)
    assert z == pytest.approx(distance)
    yaw, pitch, roll = pose.angles()
    assert roll == pytest.approx(0, abs=1e-9)
    assert pitch == pytest.approx(np.degrees(np.arcsin(apart[2] / distance)), abs=1e-6)
    assert np.cos(np.radians(yaw)) == pytest.approx(apart[0] / np.hypot(*apart[:2]), abs=1e-9)


def test_no_way_is_up_along_the_axis():
    for target in ((1, 2, 3), (1, 2, 9), (1, 2, -9)):
        with pytest.raises(ArgumentError, match=r"target: expected a point that is not along 'up'"):
            omniscv.Pose.look_at((1, 2, 3), target)
    omniscv.Pose.look_at((1, 2, 3), (1, 2, 9), up=(1, 0, 0))
