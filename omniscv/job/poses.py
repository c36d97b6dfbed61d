"""The keys ``poses``, ``motions`` and ``times`` of a job: where its cameras and objects are, and when
(docs/job.md)."""

from collections.abc import Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from omniscv.arguments import number, numbers, shown, text, whole_number, within, wrong
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Motion, object_pose
from omniscv.geometry.trajectory import NS, Curve, Poses, Trajectory, exact_seconds, nanoseconds
from omniscv.geometry.trajectory_columns import FRAMES, Frame, length_unit
from omniscv.geometry.trajectory_files import read_trajectory
from omniscv.job.sampling import SampledPoses, read_sampling
from omniscv.records import checked, mapping, optional, read, record

_STEEP = 0.7071  # of a direction's Z: 45 degrees up or down
_MOST_TIMES = 1_000_000


class Posed(NamedTuple):
    """Poses, with the fields that :class:`omniscv.job.Job` has for them.

    Attributes:
        poses: of the cameras; empty while they are to be sampled in an open source.
        times_ns: of the poses, whole nanoseconds; None unless all have one.
        places: of the poses, empty for a pose without one; None if no pose has one.
        sampling: how poses are sampled; None if they are known.
        assumed: of the file that they are from, in one line; empty for nothing.
    """

    poses: Sequence[Pose]
    times_ns: tuple[int, ...] | None = None
    places: tuple[str, ...] | None = None
    sampling: SampledPoses | None = None
    assumed: str = ""

    def later(self, by_ns: int) -> Self:
        """Return the same at other times."""
        if not self.times_ns:
            return self
        return self._replace(times_ns=tuple(time + by_ns for time in self.times_ns))


@record
class PoseFile:
    """The keys of ``poses`` that name a trajectory file."""

    file: str = checked(text, default="", help="trajectory file: TUM, KITTI, EuRoC, or CSV with column names")
    frame: str | None = checked(
        optional(text),
        default=None,
        help="camera (z forward), body (x forward), unreal, opengl, ned, or a file with T_BS",
    )
    unit: str | float | None = checked(
        length_unit, default=None, help="unit of positions: m, cm, mm, or metres; of unreal cm, else m"
    )

    def load(self) -> Posed:
        """Return the poses; say what was assumed, as of a body if nothing says that rotations are of one."""
        path = Path(self.file)
        frame = self.frame
        says = list[str]()
        on_body: Frame | None = frame if frame in FRAMES else None  # type: ignore[assignment]
        if frame is not None and on_body is None:
            from omniscv.calibration.files import load_on_body  # slow to load

            with within("poses.frame"):
                cameras = load_on_body(frame)
            name, on_body = next(iter(cameras.items()))
            if len(cameras) > 1:
                says.append(f"frame: the poses are of {name}, the first of {len(cameras)} cameras")
        trajectory = read_trajectory(path, frame=on_body, unit=self.unit)
        for line in trajectory.says:
            says.append(f"poses: {path.name}: {line}")
        poses = Poses.of(trajectory.poses)
        upward = np.mean(np.abs(poses.rotations[:, 2, 2]) > _STEEP)
        if frame is None and upward >= 0.5 and "T_BS" not in "".join(trajectory.says):
            taken = "taken as poses of a camera, z forward, which mostly looks up or down"
            advice = f"if x is forward, write {{file: {path.name}, frame: body}}"
            says.append(f"poses: {path.name}: {taken}; {advice}")
        return Posed(poses, trajectory.times_ns, assumed="\n".join(says))


def _seconds(name: str, value: Any) -> Decimal:
    """Return seconds with all digits that they are written with."""
    if isinstance(value, Decimal):
        return value
    number(name, value)
    return exact_seconds(Decimal(value.strip()) if isinstance(value, str) else value)


@record
class _Waypoint:
    """The keys of a pose: metres and degrees, world frame; seconds."""

    position: Any = checked(numbers, shape=(3,))
    yaw_deg: float = checked(number, default=0.0)
    pitch_deg: float = checked(number, default=0.0)
    roll_deg: float = checked(number, default=0.0)
    time: Decimal | None = checked(optional(_seconds), default=None)

    @property
    def angles(self) -> tuple[float, float, float]:
        return self.yaw_deg, self.pitch_deg, self.roll_deg


@record
class _ListedPose(_Waypoint):
    place: str = checked(text, default="")


def read_poses(name: str, value: object) -> Posed:
    """Return the poses that ``value`` describes: a list, the name of a trajectory file, or a mapping.

    Poses that an open source is needed for are left to be sampled. Errors begin with ``name``.
    """
    if isinstance(value, str):
        return PoseFile(text(name, value)).load()
    if isinstance(value, dict) and "file" in value:
        return read(PoseFile, value, name).load()
    if isinstance(value, dict):
        sampling = read_sampling(name, value)
        if sampling.clearance is not None:  # of surfaces, which an open source shows
            return Posed((), sampling=sampling)
        trajectory = sampling.poses()
        return Posed(trajectory.poses, trajectory.times_ns)
    if not isinstance(value, list) or not value:
        raise wrong(name, "a list of poses, poses to sample, or the name of a trajectory file", value)
    return _read_listed(name, value)


def _read_listed(name: str, descriptions: Sequence[object]) -> Posed:
    """Return the poses of a list that is not empty."""
    listed = []
    for index, description in enumerate(descriptions):
        listed.append(read(_ListedPose, description, f"{name}[{index}]"))
    times = []
    poses = []
    places = []
    for pose in listed:
        if pose.time is not None:
            times.append(nanoseconds(pose.time))
        poses.append(Pose.from_angles(pose.position, *pose.angles))
        places.append(pose.place)
    if times and len(times) < len(listed):
        wanted = "expected a time for every pose or for none"
        raise ArgumentError(f"{name}: {wanted}, got {len(listed) - len(times)} without")
    return Posed(tuple(poses), tuple(times) or None, tuple(places) if any(places) else None)


def read_motions(name: str, value: object) -> dict[str, Motion]:
    """Return the motions that ``value``, a mapping from objects, describes.

    ArgumentError, which begins with ``name``, for anything else.
    """
    if not isinstance(value, Mapping) or not value:
        raise ArgumentError(f"{name}: expected a mapping from objects to motions, got {shown(value)}")
    motions = {}
    for key, motion in value.items():
        motions[text(name, key)] = _read_motion(f"{name}.{key}", motion)
    return motions


def _read_motion(name: str, value: object) -> Motion:
    curve: Curve = "spline" if isinstance(value, Mapping) else "linear"
    if isinstance(value, Mapping):
        if "spline" not in mapping(name, value, ("spline",)):
            raise ArgumentError(f"{name}: missing key 'spline'")
        value = value["spline"]
    path = _read_waypoints(name, value)
    with within(name):
        return Motion(path, curve)


def _read_waypoints(name: str, value: object) -> Trajectory:
    """Return a trajectory of waypoints, or that of a file."""
    if isinstance(value, str):
        return read_trajectory(Path(text(name, value)), frame="object")
    if not isinstance(value, list) or not value:
        raise wrong(name, "waypoints, {spline: waypoints}, or the name of a trajectory file", value)
    waypoints = []
    for index, keys in enumerate(value):
        waypoints.append(read(_Waypoint, keys, f"{name}[{index}]"))
    poses = []
    seconds: list[Decimal | float] = []
    for index, waypoint in enumerate(waypoints):
        if waypoint.time is None and len(waypoints) > 1:
            raise ArgumentError(f"{name}[{index}]: missing key 'time'; give every waypoint a time")
        poses.append(object_pose(waypoint.position, *waypoint.angles))
        seconds.append(waypoint.time or 0.0)
    with within(name):
        return Trajectory.timed(tuple(poses), seconds)


@record
class TimeRange:
    """The key ``times`` as a rate."""

    rate: float = checked(number, above=0)
    count: int | None = checked(optional(partial(whole_number, most=_MOST_TIMES)), default=None)
    start: Decimal | None = checked(optional(_seconds), default=None)

    def times_ns(self, own: tuple[int, ...] | None) -> tuple[int, ...]:
        """Return the times; a start or count that is not given is that of ``own``, the poses' own times."""
        first = own[0] if own else 0
        if self.start is not None:
            first = nanoseconds(self.start)
        count = self.count
        if count is None:
            if not own:
                raise ArgumentError("times: missing key 'count', as the poses have no times")
            span = (own[-1] - first) / NS
            count = whole_number("times: count", int(max(span, 0) * self.rate + 1e-6) + 1, most=_MOST_TIMES)
        per_s = Fraction(exact_seconds(self.rate))
        return tuple(first + round(index * NS / per_s) for index in range(count))


Times = tuple[int, ...] | TimeRange | Literal["poses"]


def read_times(name: str, value: object) -> Times:
    """Return ``value`` as nanoseconds of a list of seconds, as a range, or the word ``poses`` as it is.

    Errors begin with ``name``.
    """
    if value == "poses":
        return "poses"
    if isinstance(value, list) and value:
        times = []
        for index, time in enumerate(value):
            times.append(nanoseconds(_seconds(f"{name}[{index}]", time)))
        return tuple(times)
    if not isinstance(value, dict):
        raise wrong(name, "a list of seconds, {start, rate, count}, or 'poses'", value)
    return read(TimeRange, value, name)


def read_epoch(name: str, value: object) -> int:
    """Return ``value`` in whole nanoseconds; below 1e11 it is in seconds. Errors begin with ``name``."""
    epoch = number(name, value, least=0)
    return nanoseconds(_seconds(name, value)) if epoch < 1e11 else whole_number(name, value, least=0)


def at_times(posed: Posed, times: Times | None, curve: Curve = "linear") -> Posed:
    """Return poses at the times of a job.

    One pose is taken at every time; poses with their own times are interpolated; otherwise there is one time
    per pose. The number of poses that are yet to be sampled is compared later, by the job.

    Args:
        posed: the poses, with their own times if they have some.
        times: of the job; None: those of the poses.
        curve: on which poses are interpolated.

    Raises:
        ArgumentError: ``times`` is ``poses``, and these have none; or poses have times and places, too.
    """
    if times is None:
        return posed
    if times == "poses":
        if posed.sampling or posed.times_ns:
            return posed
        raise ArgumentError("times: expected poses with times, got some without; list the times")
    if isinstance(times, TimeRange):
        times = times.times_ns(posed.times_ns)
    if posed.times_ns is not None and posed.sampling is None:
        return _interpolated(posed, posed.times_ns, times, curve)
    if len(posed.poses) == 1:
        places = None if posed.places is None else posed.places * len(times)
        return Posed((posed.poses[0],) * len(times), times, places, assumed=posed.assumed)
    return posed._replace(times_ns=times)


def _interpolated(posed: Posed, own_ns: tuple[int, ...], times_ns: tuple[int, ...], curve: Curve) -> Posed:
    """Return poses with their own times at others."""
    if posed.places is not None:
        raise ArgumentError("times: expected poses without times of their own, as they have places")
    path = Trajectory(posed.poses, own_ns, curve)
    with within("times"):
        return Posed(tuple(map(path.at, times_ns)), times_ns, assumed=posed.assumed)
