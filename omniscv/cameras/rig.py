"""Rigs: named cameras in one frame, each with a pose and a time offset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from omniscv.arguments import number, numbers, one_of, shown, stems, whole_number, within
from omniscv.cameras.base import Camera
from omniscv.cameras.registry import from_dict
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Array, Pose
from omniscv.geometry.pose import rotation_reader
from omniscv.geometry.trajectory import Trajectory, nanoseconds
from omniscv.records import checked, mapping, named, nested, optional, read, record

ORIGIN = Pose(np.zeros(3), np.eye(3))
"""Of the frame itself."""


def _camera(name: str, value: Any) -> Camera:
    """Return a camera, or that of its description."""
    with within(name):
        return value if isinstance(value, Camera) else from_dict(value)


@record(eq=False)
class RigCamera:
    """A camera of a rig.

    Args:
        camera: the model, or its description.
        pose: ``T_rig_cam``, the camera in the rig's frame, which is a camera frame: x right, y down,
            z forward, metres. The rig's origin and direction if not given.
        time_offset: seconds by which the camera takes its image later than the rig's time.

    Raises:
        ArgumentError: no camera, no pose, or an offset that is not finite.
    """

    camera: Camera = checked(_camera)
    pose: Pose = checked(nested(Pose), default=ORIGIN)
    time_offset: float = checked(number, default=0.0)

    @classmethod
    def turned(
        cls,
        camera: Camera,
        position: Any = (0.0, 0.0, 0.0),
        yaw_deg: float = 0.0,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
        time_offset: float = 0.0,
    ) -> RigCamera:
        """Return a camera turned from where the rig looks.

        Args:
            camera: the model, or its description.
            position: (3,) in the rig's frame, metres.
            yaw_deg: to the left +.
            pitch_deg: nose up +.
            roll_deg: right side down +.
            time_offset: seconds by which the camera takes its image later than the rig's time.
        """
        R_rig_cam = R_LEVEL.T @ Pose.from_angles((0, 0, 0), yaw_deg, pitch_deg, roll_deg).rotation
        return cls(camera, Pose(position, R_rig_cam), time_offset)


def _cameras(name: str, value: object) -> dict[str, RigCamera]:
    """Return cameras by name, each a :class:`RigCamera` or its description."""
    if not isinstance(value, Mapping) or not value:
        raise ArgumentError(f"{name}: expected cameras by name, got {shown(value)}")
    stems(name, value, dots=True)
    cameras: dict[str, RigCamera] = named(_mounted)(name, value)
    return cameras


@record(eq=False)
class Rig:
    """Cameras that move together.

    Args:
        cameras: by name; names can be file names.

    Raises:
        ArgumentError: no camera, or a name that cannot be a file name.
    """

    cameras: Mapping[str, RigCamera] = checked(_cameras)

    def poses(self, pose: Pose | Trajectory, time_ns: int | None = None) -> dict[str, Pose]:
        """Return the poses of the cameras, world frame.

        Args:
            pose: of the rig at rest; or its timed poses, interpolated at the time of each camera: see
                :meth:`Trajectory.at`.
            time_ns: the rig's, whole nanoseconds; for timed poses only.

        Raises:
            ArgumentError: poses without times, no time, or a time more than one step outside the poses.
        """
        if isinstance(pose, Pose):
            return {name: pose @ mounted.pose for name, mounted in self.cameras.items()}
        poses = {}
        for name, mounted in self.cameras.items():
            with within(name):
                rig_ns = whole_number("time_ns", time_ns, least=-1 << 62)
                camera_ns = rig_ns + nanoseconds(mounted.time_offset)
                poses[name] = pose.at(camera_ns, steps_beyond=1) @ mounted.pose
        return poses

    def seen_from(self, name: str) -> Rig:
        """Return the same rig in the frame of one of its cameras.

        Raises:
            ArgumentError: the rig has no camera of that name.
        """
        T_cam_rig = self.cameras[one_of("camera", name, self.cameras)].pose.inverse()
        mounts = {}
        for other, mounted in self.cameras.items():
            pose = ORIGIN if other == name else T_cam_rig @ mounted.pose
            mounts[other] = replace(mounted, pose=pose)
        return Rig(mounts)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: what :meth:`from_dict` takes."""
        mounts = {}
        for name, mounted in self.cameras.items():
            mounts[name] = {"camera": mounted.camera.to_dict(), **mounted.pose.to_dict()}
            mounts[name]["time_offset"] = mounted.time_offset
        return {"cameras": mounts}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Rig:
        """Return the rig that :meth:`to_dict` described.

        Instead of ``rotation``, (3, 3) camera to rig, a camera may have ``yaw_deg``, ``pitch_deg`` and
        ``roll_deg`` as :meth:`RigCamera.turned` takes them. All but ``camera`` are optional.

        Raises:
            ArgumentError: a field is missing, unknown or wrong.
        """
        return read(cls, data)


@record(eq=False)
class _Mount:
    """A camera of a rig in a file: by its rotation, or by angles."""

    camera: Camera = checked(_camera)
    position: Array = checked(numbers, shape=(3,), default_factory=lambda: np.zeros(3))
    rotation: Array | None = checked(optional(rotation_reader), default=None)
    time_offset: float = checked(number, default=0.0)
    yaw_deg: float = checked(number, default=0.0)
    pitch_deg: float = checked(number, default=0.0)
    roll_deg: float = checked(number, default=0.0)


def _mounted(name: str, value: object) -> RigCamera:
    """Return a camera of a rig, or that of its description."""
    if isinstance(value, RigCamera):
        return value
    data = mapping(name, value)
    mount = read(_Mount, data, name)
    with within(name):
        if mount.rotation is None:
            angles_deg = mount.yaw_deg, mount.pitch_deg, mount.roll_deg
            return RigCamera.turned(mount.camera, mount.position, *angles_deg, mount.time_offset)
        angles = sorted({"yaw_deg", "pitch_deg", "roll_deg"} & data.keys())
        if angles:
            raise ArgumentError(f"rotation: expected it or angles, got both ({', '.join(angles)})")
        return RigCamera(mount.camera, Pose(mount.position, mount.rotation), mount.time_offset)
