"""Which cameras of a dataset move together: rigs, found from the poses of the frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from omniscv.dataset.frames import Frame
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_SAME = 1e-6
"""Metres, and parts of unit vectors, that a camera may move in its rig."""

_HERE = Pose(np.zeros(3), np.eye(3))

Moment = dict[str, Frame]
"""The frames of one moment, by camera name."""


@dataclass(frozen=True)
class Rig:
    """Cameras that move together.

    Attributes:
        sensors: by camera name, the pose in the rig's frame, which is the first camera's.
        moments: its frames, and the pose of the rig in the world.
    """

    sensors: Mapping[str, Pose]
    moments: tuple[tuple[Moment, Pose], ...]


def rigs(frames: Sequence[Frame]) -> list[Rig]:
    """Return the rigs of frames: each camera is in one, which may be its own.

    Frames are of one moment if their keys differ only in the camera's name, as those of a job; if they have
    another form, if their times are the same, or, without times, their poses.

    Raises:
        ArgumentError: two frames of a camera in one moment.
    """
    moments: dict[object, Moment] = {}
    for camera_name, mine in by_camera(frames).items():
        for frame in mine:
            same = moments.setdefault(_moment(frame), {})
            if camera_name in same:
                wanted = "expected one frame of a camera in a moment"
                raise ArgumentError(f"{camera_name}: {wanted}, got {same[camera_name].key} and {frame.key}")
            same[camera_name] = frame
    found: list[dict[str, Pose]] = []
    for camera_name in by_camera(frames):
        for sensors in found:
            if pose := _in_rig(sensors, camera_name, moments.values()):
                sensors[camera_name] = pose
                break
        else:
            found.append({camera_name: _HERE})
    return [Rig(sensors, tuple(_posed(sensors, moments.values()))) for sensors in found]


def relative(T_w_a: Pose, T_w_b: Pose) -> Pose:
    """Return T_a_b: a pose in the frame of another one."""
    return Pose(T_w_a.to_camera(T_w_b.position), T_w_a.rotation.T @ T_w_b.rotation)


def _moment(frame: Frame) -> object:
    if frame.key == frame.camera_name or frame.key.startswith(f"{frame.camera_name}-"):
        return frame.key.removeprefix(frame.camera_name)
    if frame.time is not None:
        return frame.time
    return (*frame.pose.position.tolist(), *frame.pose.rotation.ravel().tolist())


def _in_rig(sensors: Mapping[str, Pose], camera_name: str, moments: Iterable[Moment]) -> Pose | None:
    """Where a camera is in a rig, the same in all moments that show both; None where it moves, or none do."""
    reference, *_ = sensors
    shared = [each for each in moments if reference in each and camera_name in each]
    places = [relative(each[reference].pose, each[camera_name].pose) for each in shared]
    for place in places[1:]:
        moved = np.abs(place.position - places[0].position).max()
        if max(moved, np.abs(place.rotation - places[0].rotation).max()) > _SAME:
            return None
    return places[0] if places else None


def _posed(sensors: Mapping[str, Pose], moments: Iterable[Moment]) -> Iterable[tuple[Moment, Pose]]:
    for moment in moments:
        mine = {name: moment[name] for name in sensors if name in moment}
        if mine:
            name, frame = next(iter(mine.items()))
            yield mine, frame.pose @ relative(sensors[name], _HERE)
