"""The IMU against integration of its measurements, and noise against the Allan deviation."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omniscv import truth
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory, nanoseconds
from omniscv.sensor.imu import Imu, ImuNoise, ImuTrack

SECONDS = 10.0


def loop(rate=20.0):
    """A rig that runs a loop of 10 s, nods and rolls."""
    times = np.arange(SECONDS * rate + 1) / rate
    turn = 2 * np.pi * times / SECONDS
    x, y, z = 2 * np.cos(turn), 1.5 * np.sin(2 * turn), 1.5 + 0.1 * np.sin(3 * turn)
    angles = np.stack([np.degrees(turn), 10 * np.sin(2 * turn), 5 * np.cos(3 * turn)], axis=-1)
    poses = tuple(Pose.from_angles(p, *a) for p, a in zip(np.stack([x, y, z], axis=-1), angles, strict=True))
    return Trajectory.timed(poses, times.tolist(), "spline")


def dead_reckoned(samples, gravity):
    """Rotation and position at the end, by the trapezium rule from the first state."""
    dt = np.diff(samples.times_ns) / 1e9
    R = samples.rotations[0]
    v = samples.velocities_w[0]
    p = samples.positions_w[0]
    acceleration = R @ samples.specific_force[0] + gravity
    for k in range(len(dt)):
        rate = (samples.angular_velocity[k] + samples.angular_velocity[k + 1]) / 2
        R = R @ Rotation.from_rotvec(rate * dt[k]).as_matrix()
        following = R @ samples.specific_force[k + 1] + gravity
        p = p + v * dt[k] + (2 * acceleration + following) / 6 * dt[k] ** 2
        v = v + (acceleration + following) / 2 * dt[k]
        acceleration = following
    return R, p


@pytest.mark.parametrize(
    "imu", [Imu(), Imu(position=(0.1, -0.2, 0.3), yaw_deg=30, pitch_deg=-50, roll_deg=9)]
)
def test_dead_reckoning(imu):
    """Of ideal measurements at 200 Hz it ends within 1 mm and 1e-4 degree after 10 s, wherever the IMU is."""
    samples = truth.imu(loop(), imu)
    assert len(samples) == 2001
    assert int(samples.times_ns[-1]) == loop().times_ns[-1]
    R, p = dead_reckoned(samples, np.array(imu.gravity))
    assert np.linalg.norm(p - samples.positions_w[-1]) < 1e-3
    assert np.degrees(Rotation.from_matrix(R.T @ samples.rotations[-1]).magnitude()) < 1e-4
    of_path = (loop()[-1] @ imu.pose).position
    np.testing.assert_allclose(samples.positions_w[-1], of_path, rtol=0, atol=1e-12)


def test_samples_enclose_the_last_pose():
    path = loop()
    rate = 187.33
    samples = truth.imu(path, Imu(rate=rate))
    assert 0 < int(samples.times_ns[-1]) - path.times_ns[-1] < 1e9 / rate
    _R, p = dead_reckoned(samples, np.array(Imu().gravity))
    assert np.linalg.norm(p - samples.positions_w[-1]) < 1e-3
    assert np.linalg.norm(samples.positions_w[-1] - path[-1].position) < 2 / rate  # at less than 2 m/s


def test_the_spline_passes_through_poses_of_any_rate():
    """Uneven times, 3 to 200 a second: it passes within 1e-6 m and rad; its derivatives are its own."""
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(0, SECONDS, 200))
    fine = loop()
    path = Trajectory.timed(tuple(fine.at(nanoseconds(time)) for time in times), times.tolist(), "spline")
    metres, radians = path.misses()
    assert max(metres, radians) < 1e-12
    at = rng.integers(*(1e9 * times[[1, -2]]).astype(int), 50)
    step = 1e-5
    before, here, after = (path.motions(at + shift) for shift in (-10_000, 0, 10_000))
    slope = (after.positions_w - before.positions_w) / (2 * step)
    np.testing.assert_allclose(here.velocities_w, slope, atol=1e-6)  # third derivatives at uneven times
    turn = Rotation.from_matrix(np.swapaxes(before.rotations, 1, 2) @ after.rotations).as_rotvec()
    np.testing.assert_allclose(here.rates, turn / (2 * step), atol=1e-5)
    assert path.at(int(at[0])).position.tolist() == here.positions_w[0].tolist()


def allan_deviation(values, steps):
    """Non-overlapping Allan deviation of means over ``steps`` samples."""
    means = values[: len(values) // steps * steps].reshape(-1, steps).mean(axis=1)
    return math.sqrt(np.mean(np.diff(means) ** 2) / 2)


def test_noise():
    """Its Allan deviation is what was set, for each axis; a sample's noise does not depend on the others."""
    noise = ImuNoise(noise_density=(0.1, 0.2, 0.3), random_walk=(0.0, 0.01, 0.02))
    rate = 200.0
    count = 500_000
    walk, white = noise.errors(7, "gyroscope", rate, count)
    for axis, density in enumerate((0.1, 0.2, 0.3)):  # 1 s: density; 5,000 clusters are good to 1.5 %
        assert allan_deviation(white[:, axis], 200) == pytest.approx(density, rel=0.05)
    assert not walk[:, 0].any()
    for axis, density in ((1, 0.01), (2, 0.02)):  # of an integrated walk: density sqrt(tau / 3)
        assert allan_deviation(walk[:, axis], 100) == pytest.approx(density * math.sqrt(0.5 / 3), rel=0.05)
    some = noise.errors(7, "gyroscope", rate, 1000)
    np.testing.assert_array_equal(some[0], walk[:1000])
    np.testing.assert_array_equal(some[1], white[:1000])
    assert np.abs(np.corrcoef(white.T)[0, 1]) < 0.01  # axes are independent
    assert not np.array_equal(noise.errors(7, "accelerometer", rate, 9)[1], white[:9])


def test_bias_and_a_track_that_is_read_back():
    imu = Imu(gyroscope=ImuNoise(bias=(0.1, 0.2, 0.3)), accelerometer=ImuNoise(bias=-1))
    track = ImuTrack(imu, loop())
    biased = track.samples()
    ideal = truth.imu(loop())
    np.testing.assert_allclose(biased.angular_velocity - ideal.angular_velocity, [[0.1, 0.2, 0.3]] * 2001)
    np.testing.assert_allclose(biased.specific_force - ideal.specific_force, -1, rtol=1e-12)
    again = ImuTrack.from_dict(track.to_dict())
    assert again.imu == imu
    # quaternions are rounded once more
    np.testing.assert_allclose(again.samples().specific_force, biased.specific_force, rtol=0, atol=1e-9)
