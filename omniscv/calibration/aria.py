"""Project Aria's device calibration, JSON: the cameras with their poses in the device's frame.

Half pixel: Aria puts pixel centres at whole numbers, so its principal point is ours minus 0.5. Carried:
``fisheye624`` with one focal length as ``FisheyeRadTanThinPrism``, ``kannala-brandt`` as
``KannalaBrandtK3``; ``Fisheye62``, which has no thin prism, is read. Cameras are named by their labels, which
imply the image size: the file does not hold it. Not carried: skew, a limit ``fov_deg``; the circle and the
angle beyond which Aria's own programs refuse a pixel, which are constants of those programs.

Only the cameras are written. Aria's programs need the rest of the device too (its class, the IMUs): replace
``CameraCalibrations`` in the file of a device.

Source: projectaria_tools 2.3, ``calibration/loader/SensorCalibrationJson.cpp`` and
``camera_projections/FisheyeRadTanThinPrism.h``.
"""

import json
from collections.abc import Mapping
from typing import Any

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.calibration import intrinsics
from omniscv.calibration.intrinsics import HALF_PIXEL
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.records import checked, record

_MODELS = intrinsics.format_models("""
FisheyeRadTanThinPrism fisheye624     f cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3
KannalaBrandtK3        kannala-brandt fx fy cx cy k1 k2 k3 k4
Fisheye62              fisheye624     f cx cy k0 k1 k2 k3 k4 k5 p0 p1
""")
_SIZES = {
    "camera-slam-left": (640, 480),
    "camera-slam-right": (640, 480),
    "camera-rgb": (2880, 2880),
    "camera-et-left": (640, 480),
    "camera-et-right": (640, 480),
}
"""Full resolution by label: the calibration is of these images."""


@record
class _Projection:
    name: str = checked(one_of, words=tuple(_MODELS), key="Name")
    parameters: Any = checked(lambda name, value: value, key="Params")  # as many as the model has


def _quaternion(name: str, value: object) -> tuple[float, ...]:
    """Return (x, y, z, w) of ``[w, [x, y, z]]``."""
    if not isinstance(value, list) or len(value) != 2:
        raise ArgumentError(f"{name}: expected [w, [x, y, z]], got {shown(value)}")
    return (*numbers(f"{name}: [x, y, z]", value[1], (3,)).tolist(), number(f"{name}: w", value[0]))


@record(eq=False)
class _Transform:
    translation: Array = checked(numbers, shape=(3,), key="Translation")
    quaternion: tuple[float, ...] = checked(_quaternion, key="UnitQuaternion")


@record(eq=False)
class _Entry:
    """A camera of a device."""

    label: str = checked(one_of, words=tuple(_SIZES), key="Label")
    projection: _Projection = checked(intrinsics.known(_Projection), key="Projection")
    T_device_camera: _Transform = checked(intrinsics.known(_Transform), key="T_Device_Camera")
    time_offset: float = checked(number, default=0.0, key="TimeOffsetSec_Device_Camera")

    def mounted(self) -> RigCamera:
        """Return the camera with its pose in the device's frame."""
        row = _MODELS[self.projection.name]
        values = numbers("Projection.Params", self.projection.parameters, (len(row.numbers),)).tolist()
        lens = intrinsics.read_numbers(row, values, HALF_PIXEL)
        camera = intrinsics.camera_of(row.model, *_SIZES[self.label], lens)
        with within("T_Device_Camera"):
            pose = Pose.from_quaternion(self.T_device_camera.translation, self.T_device_camera.quaternion)
        return RigCamera(camera, pose, self.time_offset)


def read_aria(text: str) -> dict[str, Camera]:
    """Return the cameras of a device's calibration by their labels."""
    return {label: mounted.camera for label, mounted in rig_from_aria(text).cameras.items()}


def write_aria(cameras: Mapping[str, Camera]) -> str:
    """Return the JSON of cameras named by labels, all at the device's origin."""
    return rig_to_aria(Rig({label: RigCamera(camera) for label, camera in cameras.items()}))


def rig_from_aria(text: str) -> Rig:
    """Return the cameras of a device's calibration with their poses in the device's frame."""
    entries = intrinsics.parse_mapping(text).get("CameraCalibrations")
    if not isinstance(entries, list) or not entries:
        raise ArgumentError(f"CameraCalibrations: expected a list of cameras, got {shown(entries)}")
    mounted: dict[str, RigCamera] = {}
    for i, data in enumerate(entries):
        entry = intrinsics.read_known(_Entry, data, f"CameraCalibrations[{i}]")
        with within(f"CameraCalibrations[{i}]"):
            if entry.label in mounted:
                raise ArgumentError(f"Label: expected each label once, got {entry.label} again")
            mounted[entry.label] = entry.mounted()
    return Rig(mounted)


def rig_to_aria(rig: Rig) -> str:
    """Return the JSON of a rig whose cameras are named by labels; the rig's frame is the device's."""
    entries = []
    for label, mounted in rig.cameras.items():
        with within(label):
            row, values = _projection(label, mounted.camera)
        x, y, z, w = mounted.pose.quaternion()
        entries.append(
            {
                "Label": label,
                "SerialNumber": "",
                "Calibrated": True,
                "Projection": {"Name": row.name, "Params": values},
                "T_Device_Camera": {
                    "Translation": mounted.pose.position.tolist(),
                    "UnitQuaternion": [w, [x, y, z]],
                },
                "TimeOffsetSec_Device_Camera": mounted.time_offset,
            }
        )
    return json.dumps({"CameraCalibrations": entries}, indent=1)


def _projection(label: str, camera: Camera) -> tuple[intrinsics.FormatModel, list[float]]:
    size = _SIZES[one_of("label", label, _SIZES)]
    expected = "Aria: expected fisheye624 with one focal length or kannala-brandt, unskewed"
    row_and_values = intrinsics.write_numbers(camera, _MODELS.values(), HALF_PIXEL, expected)
    if (camera.width, camera.height) != size:
        got = f"{camera.width}x{camera.height}"
        raise ArgumentError(f"size: expected {size[0]}x{size[1]} px of {label}, got {got}")
    return row_and_values
