"""What moves in a job: the keys ``motions`` and ``times`` of its file.

::

    motions:                              # metres and degrees, world frame; yaw to the left +
      Chair_1:                            # waypoints: linear between them
        - {time: 0, position: [1.2, 0.4, 0.5]}
        - {time: 2, position: [1.2, -0.8, 0.5], yaw_deg: 90}
      Ball: {spline: [...]}               # waypoints, or a file's, on a smooth curve
      Door: door.tum                      # a trajectory's file; relative to the job's
    times: {start: 0, rate: 10, count: 20}  # or a list of seconds, or 'poses', those of the poses
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

from omniscv.arguments import Reader, fields, number, numbers, shown, text, whole_number, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.motion import Curve, Motion, object_pose
from omniscv.geometry.trajectory import Trajectory, read_trajectory
from omniscv.jobs.poses import Posed

Times = tuple[float, ...] | Literal["poses"]

_MOST = 1_000_000


class Described(NamedTuple):
    """A motion before its file is read: waypoints, or the file's name."""

    waypoints: Trajectory | str
    curve: Curve


def read(name: str, value: object) -> dict[str, Described]:
    """Return the motions that a mapping from objects describes; ArgumentError for all else."""
    if not isinstance(value, Mapping) or not value:
        raise ArgumentError(f"{name}: expected a mapping from objects to motions, got {shown(value)}")
    return {text(name, each): _motion(f"{name}.{each}", given) for each, given in value.items()}


def opened(found: Mapping[str, Described], folder: Path) -> dict[str, Motion]:
    """Return motions, those of files read from them.

    Raises:
        ArgumentError: a file cannot be read, or has several poses without times.
    """
    motions = {}
    for name, (waypoints, curve) in found.items():
        known = read_trajectory(folder / waypoints) if isinstance(waypoints, str) else waypoints
        with within(f"motions.{name}"):
            motions[name] = Motion(known, curve)
    return motions


def read_times(name: str, value: object) -> Times:
    """Return the seconds of a list or of ``{start, rate, count}``, or the word ``poses``."""
    if value == "poses":
        return "poses"
    if isinstance(value, list) and value:
        return tuple(number(f"{name}[{i}]", each) for i, each in enumerate(value))
    if not isinstance(value, Mapping):
        wanted = "expected a list of seconds, {start, rate, count}, or 'poses'"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    found = {"start": 0.0, **fields(name, value, _TIMES, needed=("rate", "count"))}
    return tuple(found["start"] + i / found["rate"] for i in range(found["count"]))


def timed(posed: Posed, times: Times | None) -> Posed:
    """Return poses at the times that a job has for them.

    One pose is taken at every time; poses with times of their own are interpolated; else there is a time for
    each. Of poses that are yet to be sampled the job compares the numbers.

    Raises:
        ArgumentError: another number of times, or poses without the times that are wanted of them.
    """
    if times is None or (times == "poses" and (posed.sampling or posed.times)):
        return posed
    if times == "poses":
        raise ArgumentError("times: expected poses with times, got some without; list the times")
    if posed.sampling is not None:
        return posed._replace(times=times)
    if posed.times is not None:
        if posed.places is not None:
            raise ArgumentError("times: expected poses without times of their own, as they have places")
        path = Trajectory(posed.poses, posed.times)
        with within("times"):
            return Posed(tuple(path.at(time) for time in times), times)
    if len(posed.poses) == 1:
        places = None if posed.places is None else posed.places * len(times)
        return Posed(posed.poses * len(times), times, places)
    return posed._replace(times=times)


def _motion(name: str, value: object) -> Described:
    if isinstance(value, Mapping):
        spline = fields(name, value, {"spline": _waypoints}, needed=("spline",))["spline"]
        return Described(spline, "spline")
    return Described(_waypoints(name, value), "linear")


def _waypoints(name: str, value: object) -> Trajectory | str:
    """A trajectory of waypoints, or the name of its file."""
    if isinstance(value, str):
        return text(name, value)
    if not isinstance(value, list) or not value:
        wanted = "expected waypoints, {spline: waypoints}, or the name of a trajectory file"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    needed = ("position",) if len(value) == 1 else ("time", "position")
    given = [fields(f"{name}[{i}]", each, _WAYPOINT, needed=needed) for i, each in enumerate(value)]
    times = tuple(each.pop("time", 0.0) for each in given)
    with within(name):
        return Trajectory(tuple(object_pose(**each) for each in given), times)


def check_times(
    times: tuple[float, ...] | None,
    motions: Mapping[str, Motion],
    needed: bool,
    poses: Sequence[Pose],
) -> None:
    """Refuse times that do not fit poses or motions; where there are no poses yet, nothing is compared.

    Args:
        times: of the poses, seconds; None without.
        motions: by object.
        needed: whether times are needed in any case.
        poses: of the cameras.

    Raises:
        ArgumentError: no times where something moves, fewer or more than poses, or none of them while an
            object moves.
    """
    if not poses:
        return
    spans = {name: span for name, motion in motions.items() if (span := motion.span)}
    if times is None:
        if needed or spans:
            raise ArgumentError("times: expected them where something moves, got poses without; give 'times'")
        return
    if len(times) != len(poses):
        raise ArgumentError(f"times: expected one for each of {len(poses)} poses, got {len(times)}")
    for name, (start, end) in spans.items():
        if max(times) < start or min(times) > end:
            wanted = f"expected waypoints around the job's times, {min(times):.15g} to {max(times):.15g} s"
            raise ArgumentError(f"motions.{name}: {wanted}, got {start:.15g} to {end:.15g} s")


_WAYPOINT: dict[str, Reader] = {
    "time": number,
    "position": partial(numbers, shape=(3,)),
    **dict.fromkeys(("yaw_deg", "pitch_deg", "roll_deg"), number),
}
_TIMES: dict[str, Reader] = {
    "start": number,
    "rate": partial(number, above=0),
    "count": partial(whole_number, most=_MOST),
}
