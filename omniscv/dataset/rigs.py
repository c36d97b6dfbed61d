"""Which cameras of a dataset move together: rigs, found from the poses of the frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from omniscv.cameras.rig import Rig, RigCamera
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose

_SAME = 1e-6
"""Metres, and parts of unit vectors, that a camera may move in its rig."""

Moment = dict[str, Frame]
"""The frames of one moment, by camera name."""


@dataclass(frozen=True, eq=False)
class RigFrames:
    """The frames of cameras that move together.

    Attributes:
        rig: the cameras, in the frame of the first one.
        moments: its frames, and the pose of the rig in the world.
    """

    rig: Rig
    moments: tuple[tuple[Moment, Pose], ...]


def rigs(frames: Sequence[Frame]) -> list[RigFrames]:
    """Return the rigs of frames: each camera is in one, which may be its own.

    Frames are of one moment if their keys differ only in the camera's name, as those of a job; if they have
    another form, if their times are the same, or, without times, their poses.

    Raises:
        ArgumentError: two frames of a camera in one moment.
    """
    moments: dict[object, Moment] = {}
    sequences = by_camera(frames)
    for camera_name, mine in sequences.items():
        for frame in mine:
            same = moments.setdefault(_moment(frame), {})
            if camera_name in same:
                wanted = "expected one frame of a camera in a moment"
                raise ArgumentError(f"{camera_name}: {wanted}, got {same[camera_name].key} and {frame.key}")
            same[camera_name] = frame
    found: list[dict[str, RigCamera]] = []
    for camera_name, (first, *_) in sequences.items():
        for mounted in found:
            if pose := _in_rig(next(iter(mounted)), camera_name, moments.values()):
                mounted[camera_name] = RigCamera(first.camera, pose)
                break
        else:
            found.append({camera_name: RigCamera(first.camera)})
    return [RigFrames(Rig(mounted), tuple(_posed(mounted, moments.values()))) for mounted in found]


def _moment(frame: Frame) -> object:
    if frame.key == frame.camera_name or frame.key.startswith(f"{frame.camera_name}-"):
        return frame.key.removeprefix(frame.camera_name)
    if frame.time is not None:
        return frame.time
    return (*frame.pose.position.tolist(), *frame.pose.rotation.ravel().tolist())


def _in_rig(reference: str, camera_name: str, moments: Iterable[Moment]) -> Pose | None:
    """Where a camera is in the frame of another one, the same in all moments that show both; None where it
    moves, or no moment does."""
    shared = [each for each in moments if reference in each and camera_name in each]
    places = [each[reference].pose.inverse() @ each[camera_name].pose for each in shared]
    for place in places[1:]:
        moved = np.abs(place.position - places[0].position).max()
        if max(moved, np.abs(place.rotation - places[0].rotation).max()) > _SAME:
            return None
    return places[0] if places else None


def _posed(mounted: Mapping[str, RigCamera], moments: Iterable[Moment]) -> Iterable[tuple[Moment, Pose]]:
    for moment in moments:
        mine = {name: moment[name] for name in mounted if name in moment}
        if mine:
            name, frame = next(iter(mine.items()))
            yield mine, frame.pose @ mounted[name].pose.inverse()
