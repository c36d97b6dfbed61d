"""Trajectories: sequences of poses, timed or not. Files: :mod:`omniscv.geometry.trajectory_files`."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, overload

import numpy as np

from omniscv.errors import ArgumentError
from omniscv.geometry.pose import Array, Pose

Curve = Literal["linear", "spline"]


@dataclass(frozen=True, eq=False)
class Poses(Sequence[Pose]):
    """Poses of which only the arrays are in memory, as of a file with a million rows.

    Args:
        positions: (N, 3) metres.
        rotations: (N, 3, 3).
    """

    positions: Array
    rotations: Array

    def __len__(self) -> int:
        return len(self.positions)

    @overload
    def __getitem__(self, index: int) -> Pose: ...
    @overload
    def __getitem__(self, index: slice) -> Poses: ...
    def __getitem__(self, index: int | slice) -> Pose | Poses:
        pose = Poses if isinstance(index, slice) else Pose
        return pose(self.positions[index], self.rotations[index])

    @classmethod
    def of(cls, poses: Sequence[Pose]) -> Poses:
        """Return the arrays of poses."""
        if isinstance(poses, cls):
            return poses
        return cls(np.stack([pose.position for pose in poses]), np.stack([pose.rotation for pose in poses]))


class Motions(NamedTuple):
    """A body's motion at N times, by the derivatives of splines.

    Attributes:
        positions_w, velocities_w, accelerations_w: (N, 3) metres and seconds, world frame.
        rotations: (N, 3, 3) from the body to the world.
        rates, rate_changes: (N, 3) angular velocity, rad/s, and acceleration, in the body's frame.
    """

    positions_w: Array
    velocities_w: Array
    accelerations_w: Array
    rotations: Array
    rates: Array
    rate_changes: Array


@dataclass(frozen=True, eq=False)
class Trajectory(Sequence[Pose]):
    """Poses in order, and their times.

    Args:
        poses: at least one.
        times: seconds, increasing, one per pose; None if they are unknown.
        curve: between poses: ``linear`` interpolates as :meth:`Pose.interpolate`; ``spline`` uses cubic
            splines of positions and rotations, whose velocities and accelerations are continuous.
        says: what was assumed of the file that it is from, in lines for people.

    Raises:
        ArgumentError: no pose, not one time per pose, or times that do not increase.
    """

    poses: Sequence[Pose]
    times: tuple[float, ...] | None = None
    curve: Curve = "linear"
    says: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.poses:
            raise ArgumentError("trajectory: expected at least one pose, got none")
        if self.times is None:
            return
        if len(self.times) != len(self.poses):
            got = f"{len(self.times)} for {len(self.poses)} poses"
            raise ArgumentError(f"times: expected one per pose, got {got}")
        wrong = np.flatnonzero(~(np.diff(self.times) > 0))
        if wrong.size:
            before, after = self.times[wrong[0] : wrong[0] + 2]
            raise ArgumentError(f"times: expected increasing seconds, got {after!r} after {before!r}")

    def __len__(self) -> int:
        return len(self.poses)

    @overload
    def __getitem__(self, index: int) -> Pose: ...
    @overload
    def __getitem__(self, index: slice) -> Trajectory: ...
    def __getitem__(self, index: int | slice) -> Pose | Trajectory:
        if isinstance(index, slice):
            return Trajectory(self.poses[index], self.times and self.times[index], self.curve, self.says)
        return self.poses[index]

    def __iter__(self) -> Iterator[Pose]:
        return iter(self.poses)

    def at(self, time: float, steps_beyond: float = 0.0, after: float = 0.0) -> Pose:
        """Return the pose at a time, as ``curve`` says.

        Args:
            time: seconds.
            after: seconds to add to the time; of a time since 1970 a sum would lose digits.
            steps_beyond: how far outside the trajectory the time may lie, as a multiple of the first or the
                last step, whose motion is then continued.

        Raises:
            ArgumentError: the trajectory has no times, or the time lies outside them.
        """
        if self.times is None:
            raise ArgumentError("trajectory: expected poses with times, got poses without times")
        first, last = self.times[0], self.times[-1]
        if first == last == time + after:
            return self.poses[0]
        i = min(max(bisect_right(self.times, time + after), 1), len(self.times) - 1)
        start, end = self.times[i - 1], self.times[i]
        fraction = (time - start + after) / (end - start) if end > start else math.nan
        if not -steps_beyond <= fraction <= 1 + steps_beyond:
            beyond = ", or a step beyond" if steps_beyond else ""
            got = f"got {time + after:.15g}"
            raise ArgumentError(f"time: expected {first:.15g} to {last:.15g} s{beyond}, {got}")
        if self.curve == "spline":
            positions, rotations = self._splines
            return Pose(positions(time - first + after), rotations(time - first + after).as_matrix())
        return self.poses[i - 1].interpolate(self.poses[i], fraction)

    def motions(self, times: Array) -> Motions:
        """Return what the splines and their derivatives are at times (N,), seconds."""
        positions, rotations = self._splines
        times = times - (self.times or (0.0,))[0]
        at, velocities, accelerations = (positions(times, order) for order in range(3))
        rates, changes = (rotations(times, order) for order in (1, 2))
        return Motions(at, velocities, accelerations, rotations(times).as_matrix(), rates, changes)

    def misses(self) -> tuple[float, float]:
        """Return how far the splines pass from the poses at most: metres, and radians."""
        at, poses = self.motions(np.array(self.times)), Poses.of(self.poses)
        away = np.linalg.norm(at.positions_w - poses.positions, axis=1)
        turned = np.abs(at.rotations - poses.rotations)
        return float(away.max()), float(turned.max())

    @cached_property
    def _splines(self) -> tuple[Any, Any]:
        """Splines of positions, and of rotations with rates in the body's frame; from the first time on."""
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        if self.times is None or len(self.times) < 2:
            raise ArgumentError("trajectory: expected two or more poses with times, for splines")
        poses, times = Poses.of(self.poses), np.array(self.times) - self.times[0]
        rotations = Rotation.from_matrix(poses.rotations)
        return CubicSpline(times, poses.positions), RotationSpline(times, rotations)
