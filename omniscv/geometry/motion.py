"""Motions of objects: the pose of an object at any time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import get_args

from numpy.typing import ArrayLike

from omniscv.arguments import one_of
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import R_LEVEL, Pose
from omniscv.geometry.trajectory import Curve, Trajectory


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a rigid object. It rests before its first waypoint and after its last one.

    Args:
        waypoints: poses from the object's frame to the world (``R_w_o`` and position) at times in seconds;
            a single waypoint without a time is the object's pose at all times.
        curve: between waypoints: ``linear`` interpolates as :meth:`Pose.interpolate`; ``spline`` uses cubic
            splines of positions and rotations, whose velocities are continuous.

    Raises:
        ArgumentError: several waypoints without times, or another curve.
    """

    waypoints: Trajectory
    curve: Curve = "linear"

    def __post_init__(self) -> None:
        one_of("curve", self.curve, get_args(Curve))
        if self.waypoints.times_ns is None and len(self.waypoints) > 1:
            raise ArgumentError(f"waypoints: expected times, got {len(self.waypoints)} poses without times")
        object.__setattr__(self, "waypoints", replace(self.waypoints, curve=self.curve))

    @classmethod
    def through(cls, poses: Mapping[float, Pose], curve: Curve = "linear") -> Motion:
        """Return the motion through poses by their times, seconds.

        Raises:
            ArgumentError: no pose, or another curve.
        """
        times = sorted(poses)
        return cls(Trajectory.timed(tuple(poses[time] for time in times), times), curve)

    def later(self, by_ns: int) -> Motion:
        """Return the same at other times."""
        return replace(self, waypoints=self.waypoints.later(by_ns))

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """The times of the first and the last waypoint; None for an object that never moves."""
        times = self.waypoints.times_ns
        return (times[0], times[-1]) if times is not None and len(times) > 1 else None

    def at(self, time_ns: int | None) -> Pose:
        """Return the pose at a time, whole nanoseconds.

        Raises:
            ArgumentError: the object moves, and the time is None.
        """
        if self.span_ns is None:
            return self.waypoints[0]
        if time_ns is None:
            raise ArgumentError("time: expected one for an object that moves, got None")
        first, last = self.span_ns
        return self.waypoints.at(min(max(time_ns, first), last))


def object_pose(
    position: ArrayLike, yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0
) -> Pose:
    """Return the pose of an object; with angles 0 its axes are the world's: X forward, Y left, Z up.

    Args:
        position: (3,) metres, world frame.
        yaw_deg, pitch_deg, roll_deg: left +, nose up +, right side down +.
    """
    camera_pose = Pose.from_angles(position, yaw_deg, pitch_deg, roll_deg)
    return Pose(camera_pose.position, camera_pose.rotation @ R_LEVEL.T)
