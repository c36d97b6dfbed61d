"""The frames of a dataset over time: those of each camera in order, and rigs of cameras that move
together."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from omniscv.arguments import within
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory import Trajectory

FAR_M = 1000.0
"""Metres. Larger coordinates are those of the real world, as of UTM. float32 has steps of 0.06 mm here."""
_SAME = 1e-6
"""How far a camera may move in its rig: metres of its position, and of the unit vectors of its axes."""


def by_camera(frames: Sequence[Frame]) -> dict[str, list[Frame]]:
    """Return the frames of each camera, by its name: ordered by time if all of them have one, else by key."""
    cameras: dict[str, list[Frame]] = {}
    for frame in sorted(frames, key=lambda frame: frame.key):
        cameras.setdefault(frame.camera_name, []).append(frame)
    for sequence in cameras.values():
        if timed(sequence):
            sequence.sort(key=_time)
    return cameras


def timed(frames: Sequence[Frame]) -> bool:
    """Return whether all frames have a time."""
    return all(frame.time_ns is not None for frame in frames)


def near_origin(frames: Sequence[Frame]) -> tuple[Array, list[Frame]]:
    """Return an origin, and frames with poses relative to it, for formats that programs read as float32.

    It is 0 unless a camera is beyond ``FAR_M``: then it is the first position, in whole hundreds of metres.
    """
    positions = [frame.pose.position for frame in frames]
    if not frames or np.abs(positions).max() <= FAR_M:
        return np.zeros(3), list(frames)
    origin = np.round(positions[0], -2) + 0.0
    moved = []
    for frame in frames:
        pose = Pose(frame.pose.position - origin, frame.pose.rotation)
        moved.append(replace(frame, pose=pose))
    return origin, moved


def trajectory(frames: Sequence[Frame]) -> Trajectory:
    """Return the poses of one camera's frames, with their times if all have one."""
    times = tuple(map(_time, frames)) if timed(frames) else None
    with within(frames[0].camera_name if frames else "frames"):
        return Trajectory(tuple(frame.pose for frame in frames), times)


def _time(frame: Frame) -> int:
    return frame.time_ns or 0


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
    """Return the rigs of frames: each camera is in exactly one, alone if it moves relative to all others.

    Frames are of one moment if their keys differ only in the camera's name, as those of a job do. With other
    keys they are of one moment if their times are the same, or, without times, their poses.
    """
    moments: dict[object, Moment] = {}
    sequences = by_camera(frames)
    for name, sequence in sequences.items():
        for frame in sequence:
            moment = moments.setdefault(_moment(frame), {})
            if name in moment:
                wanted = "expected one frame of a camera in a moment"
                raise ArgumentError(f"{name}: {wanted}, got {moment[name].key} and {frame.key}")
            moment[name] = frame
    mounted: list[dict[str, RigCamera]] = []
    for name, (first, *_) in sequences.items():
        for cameras in mounted:
            if pose := _relative_pose(next(iter(cameras)), name, moments.values()):
                cameras[name] = RigCamera(first.camera, pose)
                break
        else:
            mounted.append({name: RigCamera(first.camera)})
    found = []
    for cameras in mounted:
        found.append(RigFrames(Rig(cameras), tuple(_posed(cameras, moments.values()))))
    return found


def _moment(frame: Frame) -> object:
    if frame.key == frame.camera_name or frame.key.startswith(f"{frame.camera_name}-"):
        return frame.key.removeprefix(frame.camera_name)
    if frame.time_ns is not None:
        return frame.time_ns
    return (*frame.pose.position.tolist(), *frame.pose.rotation.ravel().tolist())


def _relative_pose(reference: str, name: str, moments: Iterable[Moment]) -> Pose | None:
    """Return the pose of a camera in the frame of another one, the same in all moments with both; None if it
    moves, or no moment has both."""
    first: Pose | None = None
    for moment in moments:
        if reference not in moment or name not in moment:
            continue
        pose = moment[reference].pose.inverse() @ moment[name].pose
        if first is None:
            first = pose
        moved = np.abs(pose.position - first.position).max()
        turned = np.abs(pose.rotation - first.rotation).max()
        if max(moved, turned) > _SAME:
            return None
    return first


def _posed(rig: Mapping[str, RigCamera], moments: Iterable[Moment]) -> Iterable[tuple[Moment, Pose]]:
    """Yield the rig's frames of each moment, and the rig's pose."""
    for moment in moments:
        frames = {name: moment[name] for name in rig if name in moment}
        if frames:
            name, frame = next(iter(frames.items()))
            yield frames, frame.pose @ rig[name].pose.inverse()
