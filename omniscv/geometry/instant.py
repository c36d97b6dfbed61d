"""The state of the world at one instant: poses of moving objects, and objects that are hidden."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, get_args

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import one_of, optional_number, text, texts
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import R_LEVEL, Array, Pose
from omniscv.geometry.trajectory import Curve, Trajectory
from omniscv.records import checked, named, nested, read, record


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
        """Return the motion through poses.

        Args:
            poses: at least one, by their times, seconds.
            curve: as of :class:`Motion`.
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
        """Return the pose at a time, whole nanoseconds; ArgumentError for None where the object moves."""
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
        yaw_deg: to the left +.
        pitch_deg: nose up +.
        roll_deg: right side down +.
    """
    camera_pose = Pose.from_angles(position, yaw_deg, pitch_deg, roll_deg)
    return Pose(camera_pose.position, camera_pose.rotation @ R_LEVEL.T)


_DECIMALS = 7  # of metres and entries in ``state``: servers are sent three decimals of a centimetre


def _hidden(name: str, value: Any) -> frozenset[str]:
    """Return the names of hidden objects; none of what is empty."""
    if not value:
        return frozenset()
    return frozenset(texts(name, list(value) if isinstance(value, frozenset) else value))


def _name(name: str, value: Any) -> str:
    """Return a text; the empty one for what is empty."""
    return text(name, value) if value else ""


@record(eq=False)
class Instant:
    """What was set in a moving world, or was read back from it.

    Attributes:
        poses: by object, from the object's frame to the world: its position, and ``R_w_o``, the identity for
            an object that is turned as the engine's axes are (X forward, Y left, Z up in our frame).
        hidden: names of objects that are not shown.
        time: seconds on the scene's own clock; None if it is unknown or nothing depends on it.
        name: of a state that neither poses nor time describe, such as a light's; of a world that is varied,
            what was drawn, as JSON.
    """

    poses: Mapping[str, Pose] = checked(named(nested(Pose)), default_factory=dict)
    hidden: frozenset[str] = checked(_hidden, default=frozenset())
    time: float | None = checked(optional_number, default=None)
    name: str = checked(_name, default="")

    @cached_property
    def state(self) -> str:
        """The key by which requests, plans and recordings tell states of the world apart.

        Empty for an unchanged world, so that a still world has one state; else 16 hexadecimal digits of a
        hash of all fields. Equal instants have equal states in every process, so a replayed job computes the
        states of its recording.
        """
        if not (self.poses or self.hidden or self.name) and self.time is None:
            return ""
        poses = {name: _rounded(pose) for name, pose in self.poses.items()}
        time = None if self.time is None else round(self.time, 9)
        fields = [poses, sorted(self.hidden), time, self.name]
        return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()[:16]

    @classmethod
    def drawn(
        cls, varied: Mapping[str, Any], poses: Mapping[str, Pose] | None = None, time: float | None = None
    ) -> Self:
        """Return the instant of a world that is varied.

        Args:
            varied: what was drawn: settings by kind (``objects``, ``lights``, ``materials``) and name.
            poses: of objects, as of :class:`Instant`; None: none.
            time: seconds on the scene's own clock; None if it is unknown.
        """
        name = json.dumps(varied, separators=(",", ":"), sort_keys=True) if varied else ""
        return cls(poses or {}, time=time, name=name)

    @cached_property
    def varied(self) -> Mapping[str, Mapping[str, Mapping[str, Any]]]:
        """The draws that :meth:`drawn` was given; empty if there are none."""
        with suppress(ValueError):
            content = json.loads(self.name or "{}")
            if isinstance(content, dict):
                return content
        return {}

    def placed(
        self, at_rest: Callable[[Collection[str]], Mapping[str, Pose]]
    ) -> tuple[dict[str, Pose], frozenset[str]]:
        """Return the poses of objects that draws move, and the names of those that they hide.

        Args:
            at_rest: returns the poses of objects (``R_w_o`` and position) in the world as it is. An object is
                turned about its position and world Z by ``turn_deg``, left +, then moved by ``shift``, (3,)
                metres.
        """
        objects = self.varied.get("objects", {})
        moved = [name for name, draw in objects.items() if "shift" in draw or "turn_deg" in draw]
        hidden = [name for name, draw in objects.items() if not draw.get("shown", True)]
        resting = at_rest(moved) if moved else {}
        poses = {}
        for name in moved:
            draw = objects[name]
            position = resting[name].position + np.asarray(draw.get("shift", (0, 0, 0)))
            turn = turn_about_z(draw.get("turn_deg", 0.0))
            poses[name] = Pose(position, turn @ resting[name].rotation)
        return poses, frozenset(hidden)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        poses = {name: self.poses[name].to_dict() for name in sorted(self.poses)}
        return {"poses": poses, "hidden": sorted(self.hidden), "time": self.time, "name": self.name}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the instant that :meth:`to_dict` described; ArgumentError for anything else."""
        return read(cls, data)


def _rounded(pose: Pose) -> list[float]:
    """Return position and rotation of a pose, row by row, rounded as for :attr:`Instant.state`."""
    return [round(float(number), _DECIMALS) + 0.0 for number in (*pose.position, *pose.rotation.ravel())]


def turn_about_z(degrees: float) -> Array:
    """Return the rotation (3, 3) about world Z, to the left +."""
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
