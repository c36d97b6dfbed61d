"""Rigs: named cameras in one frame, each with a pose and a time offset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import PurePath
from typing import Any

import numpy as np

from omniscv.arguments import Reader, fields, number, numbers, one_of, shown, text, within
from omniscv.cameras.base import Camera
from omniscv.cameras.registry import from_dict
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Pose
from omniscv.geometry.trajectory import Trajectory

_HERE = Pose((0.0, 0.0, 0.0), np.eye(3))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class RigCamera:
    """A camera of a rig.

    Args:
        camera: the model.
        pose: ``T_rig_cam``, the camera in the rig's frame, which is a camera frame: x right, y down,
            z forward, metres. At the rig's origin, looking as the rig does, if not given.
        time_offset: seconds by which the camera takes its image later than the rig's time.

    Raises:
        ArgumentError: no camera, no pose, or no finite offset.
    """

    camera: Camera
    pose: Pose = _HERE
    time_offset: float = 0.0

    def __post_init__(self) -> None:
        for name, kind in (("camera", Camera), ("pose", Pose)):
            if not isinstance(getattr(self, name), kind):
                got = shown(getattr(self, name))
                raise ArgumentError(f"{name}: expected a {kind.__name__}, got {got}")
        object.__setattr__(self, "time_offset", number("time_offset", self.time_offset))

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
        """Return a camera turned from where the rig looks: to the left +, nose up +, right side down +.

        Args:
            position: (3,) in the rig's frame, metres.
        """
        R_rig_cam = R_LEVEL.T @ Pose.from_angles((0, 0, 0), yaw_deg, pitch_deg, roll_deg).rotation
        return cls(camera, Pose(position, R_rig_cam), time_offset)


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras that move together.

    Args:
        cameras: by name; names can be file names.

    Raises:
        ArgumentError: no camera, or a name that cannot be a file name.
    """

    cameras: Mapping[str, RigCamera]

    def __post_init__(self) -> None:
        if not isinstance(self.cameras, Mapping) or not self.cameras:
            raise ArgumentError(f"rig: expected cameras by name, got {shown(self.cameras)}")
        for name, mounted in self.cameras.items():
            if name != PurePath(text("rig: name", name)).name or name.startswith("."):
                raise ArgumentError(f"rig: expected names that can be file names, got {shown(name)}")
            if not isinstance(mounted, RigCamera):
                raise ArgumentError(f"rig.{name}: expected a RigCamera, got {shown(mounted)}")
        object.__setattr__(self, "cameras", dict(self.cameras))

    def poses(self, pose: Pose | Trajectory, time: float | None = None) -> dict[str, Pose]:
        """Return the poses of the cameras, world frame.

        Args:
            pose: of the rig: where it stands still; or its timed poses, along which each camera is moved by
                its time offset: positions linearly, rotations along the shortest turn.
            time: the rig's, seconds; for timed poses only.

        Raises:
            ArgumentError: poses without times, no time, or one more than a pose's step beyond the poses.
        """
        if isinstance(pose, Pose):
            return {name: pose @ mounted.pose for name, mounted in self.cameras.items()}
        found = {}
        for name, mounted in self.cameras.items():
            with within(name):
                at = number("time", time) + mounted.time_offset
                found[name] = pose.at(at, steps_beyond=1) @ mounted.pose
        return found

    def seen_from(self, name: str) -> Rig:
        """Return the same rig in the frame of one of its cameras.

        Raises:
            ArgumentError: the rig has no camera of that name.
        """
        T_cam_rig = self.cameras[one_of("camera", name, self.cameras)].pose.inverse()
        return Rig(
            {
                each: replace(mounted, pose=_HERE if each == name else T_cam_rig @ mounted.pose)
                for each, mounted in self.cameras.items()
            }
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: what :meth:`from_dict` takes."""
        return {
            "cameras": {
                name: {
                    "camera": mounted.camera.to_dict(),
                    **mounted.pose.to_dict(),
                    "time_offset": mounted.time_offset,
                }
                for name, mounted in self.cameras.items()
            }
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Rig:
        """Return the rig that :meth:`to_dict` described.

        In place of ``rotation``, (3, 3) camera to rig, a camera may have ``yaw_deg``, ``pitch_deg`` and
        ``roll_deg`` as :meth:`RigCamera.turned` takes them. All but ``camera`` may be missing.

        Raises:
            ArgumentError: a field is missing, unknown or wrong.
        """
        cameras = fields("", data, {"cameras": _by_name}, needed=("cameras",))["cameras"]
        return cls({name: _mounted(f"cameras.{name}", each) for name, each in cameras.items()})


def _by_name(name: str, value: object) -> Mapping[str, object]:
    if not isinstance(value, Mapping) or not value:
        raise ArgumentError(f"{name}: expected cameras by name, got {shown(value)}")
    return value


def _camera(name: str, value: Any) -> Camera:
    with within(name):
        return from_dict(value)


_ANGLES: dict[str, Reader] = dict.fromkeys(("yaw_deg", "pitch_deg", "roll_deg"), number)
_FIELDS: dict[str, Reader] = {
    "camera": _camera,
    "position": partial(numbers, shape=(3,)),
    "rotation": partial(numbers, shape=(3, 3)),
    "time_offset": number,
    **_ANGLES,
}


def _mounted(where: str, value: object) -> RigCamera:
    given = fields(where, value, _FIELDS, needed=("camera",))
    with within(where):
        if "rotation" not in given:
            return RigCamera.turned(**given)
        if angles := sorted(_ANGLES.keys() & given.keys()):
            raise ArgumentError(f"rotation: expected it or angles, got both ({', '.join(angles)})")
        pose = Pose(given.get("position", np.zeros(3)), given["rotation"])
        return RigCamera(given["camera"], pose, given.get("time_offset", 0.0))
