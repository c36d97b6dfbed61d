"""The rig of a job: the key ``rig`` of its file, and where the rig's cameras are at each pose.

::

    rig: camchain.yaml                  # of Kalibr, a rig's JSON, or a folder of COLMAP's text files

    rig:
      cameras:
        left:  {camera: {model: fisheye-equidistant, width: 640, height: 640, fov_deg: 190}}
        right: {camera: {model: fisheye-equidistant, width: 640, height: 640, fov_deg: 190},
                position: [0.1, 0, 0], yaw_deg: -90, time_offset: 0.002}

Positions are metres in the rig's frame (x right, y down, z forward), angles degrees from where the rig looks.
"""

from collections.abc import Mapping
from pathlib import Path

from omniscv.arguments import shown, within
from omniscv.calibration import load_rig
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory


def read_rig(name: str, value: object) -> Rig | str:
    """Return an inline rig, or the path of a rig's file as it stands there; ArgumentError for all else."""
    if isinstance(value, str) and value and "\0" not in value:
        return value
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: expected a file's name or cameras by name, got {shown(value)}")
    with within(name):
        return Rig.from_dict(value)


def rig_of(rig: Rig | str | None, folder: Path) -> Rig | None:
    """Return a rig that was given inline or as a path relative to a folder."""
    if not isinstance(rig, str):
        return rig
    with within("rig"):
        return load_rig(folder / rig)


def cameras_of(rig: Rig | None, cameras: Mapping[str, Camera]) -> dict[str, Camera]:
    """Return a job's cameras by name: those of its rig, then those that are at the poses themselves.

    Raises:
        ArgumentError: a name twice, or no camera.
    """
    mounted = {} if rig is None else {name: each.camera for name, each in rig.cameras.items()}
    if twice := sorted(mounted.keys() & cameras.keys()):
        raise ArgumentError(f"cameras: expected names that the rig has not, got {', '.join(twice)}")
    if not mounted and not cameras:
        raise ArgumentError("cameras: expected cameras or a rig, got none")
    return {**mounted, **cameras}


def trajectory_of(
    rig: Rig | None, poses: tuple[Pose, ...], times: tuple[float, ...] | None, moves: bool
) -> Trajectory | None:
    """Return the timed poses along which cameras move: those of a rig by their time offsets, and all cameras
    where they ``move`` while they are exposed; None elsewhere.

    Raises:
        ArgumentError: time offsets, but poses without times, or times that do not increase.
    """
    late = {} if rig is None else {name: each.time_offset for name, each in rig.cameras.items()}
    for name, offset in late.items():
        if offset:
            if times is None:
                got = f"{name}: time_offset {offset:.15g} s, and poses without times"
                raise ArgumentError(f"rig: expected poses with times, such as a trajectory's, got {got}")
            moves = True
    return Trajectory(poses, times) if moves else None
