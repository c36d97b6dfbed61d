"""Inverse and look-at poses: laws, not samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

import omniscv
from omniscv.errors import ArgumentError

coordinate = st.floats(-100, 100)
place = st.tuples(coordinate, coordinate, coordinate)
angle = st.floats(-180, 180)


@cases(15)
@given(place, angle, st.floats(-90, 90), angle)
def test_a_pose_and_its_inverse_are_the_identity(position, yaw, pitch, roll):
    pose = omniscv.Pose.from_angles(position, yaw, pitch, roll)
    for both in (pose @ pose.inverse(), pose.inverse() @ pose):
        np.testing.assert_allclose(both.rotation, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(both.position, 0, atol=1e-12)  # rounding of 100 m


@cases(15)
@given(place, place)
def test_the_point_is_ahead_and_the_image_upright(position, target):
    apart = np.subtract(target, position)
    if np.hypot(*apart[:2]) < 1e-3:
        return
    pose = omniscv.Pose.look_at(position, target)
    x, y, z = pose.to_camera(target)
    distance = np.linalg.norm(apart)
    assert np.hypot(x, y) <= 1e-12 * max(1, distance)
    assert z == pytest.approx(distance)
    yaw, pitch, roll = pose.angles()
    assert roll == pytest.approx(0, abs=1e-9)
    assert pitch == pytest.approx(np.degrees(np.arcsin(apart[2] / distance)), abs=1e-6)
    assert np.cos(np.radians(yaw)) == pytest.approx(apart[0] / np.hypot(*apart[:2]), abs=1e-9)


@pytest.mark.parametrize("target", [(1, 2, 3), (1, 2, 9), (1, 2, -9)])
def test_no_way_is_up_along_the_axis(target):
    with pytest.raises(ArgumentError, match=r"target: expected a point that is not along 'up'"):
        omniscv.Pose.look_at((1, 2, 3), target)
    if target != (1, 2, 3):
        omniscv.Pose.look_at((1, 2, 3), target, up=(1, 0, 0))
