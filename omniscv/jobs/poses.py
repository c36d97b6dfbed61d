"""The poses of a job's file: a list, with places and times where it gives them, a trajectory's file, or a
description of poses to sample."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

from omniscv.arguments import Reader, fields, number, numbers, shown, text
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory, read_trajectory
from omniscv.jobs import sampled_poses
from omniscv.jobs.sampled_poses import SampledPoses


class Posed(NamedTuple):
    """Poses, with the fields that :class:`omniscv.jobs.Job` has of them.

    Attributes:
        poses: of the cameras.
        times: of the poses, seconds; None where not all have one.
        places: of the poses, empty for a pose without one; None where no pose has one.
        sampling: how poses are chosen when the source is open; there are none before.
    """

    poses: tuple[Pose, ...]
    times: tuple[float, ...] | None = None
    places: tuple[str, ...] | None = None
    sampling: SampledPoses | None = None


def read(name: str, value: object) -> str | Posed:
    """Return the poses that a list or a mapping describes, or the name of a trajectory's file.

    Raises:
        ArgumentError: anything else, or a pose with an unknown, missing or wrong field.
    """
    if isinstance(value, str):
        return text(name, value)
    if isinstance(value, dict):
        found = sampled_poses.read(name, value)
        return Posed((), sampling=found) if found.captures else of(found.poses())
    if not isinstance(value, list) or not value:
        wanted = "expected a list of poses, poses to sample, or the name of a trajectory file"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    given = [fields(f"{name}[{i}]", each, _POSE, needed=("position",)) for i, each in enumerate(value)]
    times = [each.pop("time", None) for each in given]
    places = [each.pop("place", "") for each in given]
    if None in times and any(time is not None for time in times):
        raise ArgumentError(
            f"{name}: expected a time for every pose or for none, got {times.count(None)} without"
        )
    return Posed(
        tuple(Pose.from_angles(**each) for each in given),
        None if None in times else tuple(times),
        tuple(places) if any(places) else None,
    )


def opened(found: str | Posed, folder: Path) -> Posed:
    """Return poses, those of a trajectory's file read from it.

    Raises:
        ArgumentError: the file cannot be read.
    """
    if isinstance(found, Posed):
        return found
    return of(read_trajectory(folder / found))


def of(trajectory: Trajectory) -> Posed:
    """Return the poses of a trajectory, with its times."""
    return Posed(trajectory.poses, trajectory.times)


_POSE: dict[str, Reader] = {
    "position": partial(numbers, shape=(3,)),
    "yaw_deg": number,
    "pitch_deg": number,
    "roll_deg": number,
    "time": number,
    "place": text,
}
