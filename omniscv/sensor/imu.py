"""An inertial measurement unit that a rig carries: angular rate and specific force along its trajectory.

The trajectory is the spline that moves the cameras; its derivatives are exact. Noise is white noise and a
random walk of the bias, as Kalibr's and EuRoC's files describe it (continuous-time densities). A sample's
noise depends on the seed, the axis and the sample's number alone.
Source: Woodman 2007, An introduction to inertial navigation; Furgale et al. 2013 for the noise model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, numbers, whole_number
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Array, Pose
from omniscv.geometry.trajectory import NS, Trajectory, parsed
from omniscv.geometry.trajectory_files import write_tum
from omniscv.records import checked, nested, read, record
from omniscv.sensor import noise

PASSES = 1e-6
"""Metres and radians within which the spline passes through the poses that were given."""
_WHITE = 0
_WALK = 1
"""Purposes of random numbers: white noise, and the random walk of the bias."""
_MOST = 100_000_000  # samples


def _axes(name: str, value: Any) -> tuple[float, ...]:
    """Read one number or three as three."""
    return tuple(numbers(name, [value] * 3 if np.ndim(value) == 0 else value, (3,)).tolist())


def _densities(name: str, value: Any) -> tuple[float, ...]:
    """Read one number or three, none of them negative, as three."""
    return tuple(number(name, density, least=0) for density in _axes(name, value))


def _axes_of(reader: Any, help: str) -> Any:
    """Return a field of three numbers, 0 by default."""
    return checked(reader, default=(0.0,) * 3, help=help)


@record
class ImuNoise:
    """The errors of three axes, each one number or three: rad/s of a gyroscope, m/s^2 of an accelerometer."""

    bias: tuple[float, ...] = _axes_of(_axes, "constant error, rad/s or m/s^2")
    noise_density: tuple[float, ...] = _axes_of(_densities, "of white noise, unit / sqrt(Hz)")
    random_walk: tuple[float, ...] = _axes_of(_densities, "of the bias, unit / s / sqrt(Hz)")

    def errors(self, seed: int, name: str, rate: float, count: int) -> tuple[Array, Array]:
        """Return biases and white noise, (count, 3) each, of samples.

        Args:
            seed: of the noise.
            name: of the instrument, ``gyroscope`` or ``accelerometer``: each has its own noise.
            rate: samples a second.
            count: of samples from the first one on.
        """
        biases = np.tile(self.bias, (count, 1))
        white = np.zeros((count, 3))
        key = noise.key(seed, f"imu.{name}")
        for axis, (density, walk) in enumerate(zip(self.noise_density, self.random_walk, strict=True)):
            if density:
                white[:, axis] = density * rate**0.5 * noise.normals(key, _WHITE, axis, 0, count)
            if walk:
                steps = np.cumsum(noise.normals(key, _WALK, axis, 0, count - 1))
                biases[1:, axis] += steps * walk / rate**0.5
        return biases, white


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """Measurements, and the truth at their times.

    Attributes:
        times_ns: (N,) whole nanoseconds.
        angular_velocity: (N, 3) as measured, rad/s, in the body's frame.
        specific_force: (N, 3) as measured, m/s^2, in the body's frame.
        positions_w: (N, 3) of the body, metres, world frame.
        velocities_w: (N, 3) of the body, m/s, world frame.
        rotations: (N, 3, 3) from the body to the world.
        gyro_bias: (N, 3) the bias in the angular velocity, rad/s.
        accel_bias: (N, 3) the bias in the specific force, m/s^2.
    """

    times_ns: NDArray[np.int64]
    angular_velocity: Array
    specific_force: Array
    positions_w: Array
    velocities_w: Array
    rotations: Array
    gyro_bias: Array
    accel_bias: Array

    def __len__(self) -> int:
        return len(self.times_ns)


@record
class Imu:
    """An IMU on a rig. Its body frame is X forward, Y left, Z up where the rig looks, unless it is turned."""

    rate: float = checked(number, above=0, default=200.0, help="samples a second")
    position: tuple[float, ...] = _axes_of(_axes, "in the rig's frame (x right, y down, z forward), metres")
    yaw_deg: float = checked(number, default=0.0, help="turn of the body on the rig: to the left +")
    pitch_deg: float = checked(number, default=0.0, help="the same, nose up +")
    roll_deg: float = checked(number, default=0.0, help="the same, right side down +")
    gravity: tuple[float, ...] = checked(
        _axes, default=(0.0, 0.0, -9.81), help="acceleration of free fall, m/s^2, world frame"
    )
    gyroscope: ImuNoise = checked(nested(ImuNoise), default=ImuNoise(), help="errors of angular rates")
    accelerometer: ImuNoise = checked(nested(ImuNoise), default=ImuNoise(), help="errors of specific force")
    seed: int = checked(whole_number, least=0, default=0, help="of the noise")

    @property
    def pose(self) -> Pose:
        """``T_rig_body``."""
        turn = Pose.from_angles((0, 0, 0), self.yaw_deg, self.pitch_deg, self.roll_deg).rotation
        return Pose(np.array(self.position), R_LEVEL.T @ turn @ R_LEVEL.T)


def measure(path: Trajectory, imu: Imu | None = None) -> ImuSamples:
    """Return what an IMU measures on a rig that moves along the spline through timed poses.

    The last sample is at the last pose or up to a period later, so that samples enclose all images.

    Args:
        path: of the rig, a camera frame: x right, y down, z forward.
        imu: the sensor; an ideal one at 200 Hz if not given.

    Raises:
        ArgumentError: fewer than two poses, poses without times, or too many samples.
    """
    if imu is None:
        imu = Imu()
    path = replace(path, curve="spline")
    times = _sample_times(path.times_ns or (0,), imu.rate)
    at = path.motions(times)
    mounted = imu.pose
    rotations = at.rotations @ mounted.rotation
    lever = mounted.position
    # The point that it is mounted at moves and accelerates by the rig's turning, too.
    turning = np.cross(at.rates, lever)
    across = np.cross(at.rate_changes, lever) + np.cross(at.rates, turning)
    falling_w = at.accelerations_w + np.einsum("nij,nj->ni", at.rotations, across) - imu.gravity
    gyro_bias, gyro_white = imu.gyroscope.errors(imu.seed, "gyroscope", imu.rate, len(times))
    accel_bias, accel_white = imu.accelerometer.errors(imu.seed, "accelerometer", imu.rate, len(times))
    return ImuSamples(
        times_ns=times,
        angular_velocity=at.rates @ mounted.rotation + gyro_bias + gyro_white,
        specific_force=np.einsum("nji,nj->ni", rotations, falling_w) + accel_bias + accel_white,
        positions_w=at.positions_w + at.rotations @ lever,
        velocities_w=at.velocities_w + np.einsum("nij,nj->ni", at.rotations, turning),
        rotations=rotations,
        gyro_bias=gyro_bias,
        accel_bias=accel_bias,
    )


def _sample_times(times_ns: Sequence[int], rate: float) -> NDArray[np.int64]:
    """Return times at ``rate`` a second, whole nanoseconds, from the first pose to the last one or beyond."""
    samples = (times_ns[-1] - times_ns[0]) / NS * rate
    if samples >= _MOST:
        raise ArgumentError(f"imu: expected at most {_MOST} samples, got {samples:g}; give a lower rate")
    steps = np.arange(math.ceil(samples - 1e-6) + 1)
    return np.asarray(times_ns[0] + np.rint(steps * (NS / rate)).astype(np.int64))


@dataclass(frozen=True, eq=False)
class ImuTrack:
    """An IMU and the trajectory of its rig, as a dataset holds them.

    Attributes:
        imu: the sensor.
        path: the rig's timed poses; splines are between them.
    """

    imu: Imu
    path: Trajectory

    def samples(self) -> ImuSamples:
        """Return the measurements."""
        return measure(self.path, self.imu)

    def on_body(self, frame: Any) -> Pose:
        """Return ``T_body_cam`` of the camera of a frame with a time."""
        pose: Pose = frame.pose
        return (self.path.at(frame.time_ns, steps_beyond=1) @ self.imu.pose).inverse() @ pose

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: the sensor's, and lines ``time x y z qx qy qz qw``."""
        return {"sensor": asdict(self.imu), "path": write_tum(self.path).splitlines()[1:]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ImuTrack:
        """The inverse of :meth:`to_dict`; ArgumentError for anything else."""
        lines = [line.split() for line in data["path"]]
        poses = []
        for row in numbers("imu.path", lines, (None, 8)).tolist():
            poses.append(Pose.from_quaternion(row[1:4], row[4:]))
        times = tuple(parsed(line[0]) for line in lines)
        return cls(read(Imu, data["sensor"], "imu"), Trajectory(tuple(poses), times, "spline"))
