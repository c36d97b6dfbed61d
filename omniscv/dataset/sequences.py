"""The frames of a dataset as sequences: those of each camera, in their order."""

from collections.abc import Sequence

from omniscv.arguments import within
from omniscv.frame import Frame
from omniscv.geometry.trajectory import Trajectory


def by_camera(frames: Sequence[Frame]) -> dict[str, list[Frame]]:
    """Return the frames of each camera, by its name: by time where all of them have one, else by key."""
    found: dict[str, list[Frame]] = {}
    for frame in sorted(frames, key=lambda frame: frame.key):
        found.setdefault(frame.camera_name, []).append(frame)
    return {each: sorted(mine, key=_time) if timed(mine) else mine for each, mine in found.items()}


def timed(frames: Sequence[Frame]) -> bool:
    """Return whether all frames have a time."""
    return all(frame.time is not None for frame in frames)


def trajectory(frames: Sequence[Frame]) -> Trajectory:
    """Return the poses of one camera's frames, with their times where all have one.

    Raises:
        ArgumentError: no frame, or two at one time.
    """
    times = tuple(map(_time, frames)) if timed(frames) else None
    with within(frames[0].camera_name if frames else "frames"):
        return Trajectory(tuple(frame.pose for frame in frames), times)


def _time(frame: Frame) -> float:
    return 0.0 if frame.time is None else frame.time
