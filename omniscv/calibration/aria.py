"""Project Aria's device calibration, JSON: the cameras with their poses in the device's frame.

Half pixel: Aria puts pixel centres at whole numbers, so its principal point is ours minus 0.5. Carried:
``fisheye624`` with one focal length as ``FisheyeRadTanThinPrism``, ``kannala-brandt`` as
``KannalaBrandtK3``; ``Fisheye62``, which has no thin prism, is read. Cameras are named by their labels; these
give the image size, which the file has not. Not carried: skew, a limit ``fov_deg``; the circle and the angle
beyond which Aria's own programs refuse a pixel, because they are constants of those programs.

What is written holds the cameras only. Aria's programs need the rest of the device too (its class, the IMUs):
replace ``CameraCalibrations`` in the file of a device.

Source: projectaria_tools 2.3, ``calibration/loader/SensorCalibrationJson.cpp`` and
``camera_projections/FisheyeRadTanThinPrism.h``.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.calibration.common import field, mapping
from omniscv.calibration.intrinsics import HALF_PIXEL, FormatModel, camera_of, fit_format, read_numbers
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_TABLE = """
FisheyeRadTanThinPrism fisheye624     f cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3
KannalaBrandtK3        kannala-brandt fx fy cx cy k1 k2 k3 k4
Fisheye62              fisheye624     f cx cy k0 k1 k2 k3 k4 k5 p0 p1
"""
_ROWS = [line.split() for line in _TABLE.strip().splitlines()]
_MODELS = {name: FormatModel(name, model, tuple(names)) for name, model, *names in _ROWS}
_SIZES = {
    "camera-slam-left": (640, 480),
    "camera-slam-right": (640, 480),
    "camera-rgb": (2880, 2880),
    "camera-et-left": (640, 480),
    "camera-et-right": (640, 480),
}
"""Full resolution by label: the images that the calibration is of."""


def read_aria(text: str) -> dict[str, Camera]:
    """Return the cameras of a device's calibration by their labels.

    Raises:
        ArgumentError: no JSON, a key missing or wrong, an unknown label or model, or no camera.
    """
    return {label: each.camera for label, each in rig_from_aria(text).cameras.items()}


def write_aria(cameras: Mapping[str, Camera]) -> str:
    """Return the JSON of cameras named by labels, all at the device's origin.

    Raises:
        ArgumentError: an unknown label, an image of another size than its label's, or a model that Aria has
            not.
    """
    return rig_to_aria(Rig({label: RigCamera(camera) for label, camera in cameras.items()}))


def rig_from_aria(text: str) -> Rig:
    """Return the cameras of a device's calibration with their poses in the device's frame.

    Raises:
        ArgumentError: as :func:`read_aria`.
    """
    entries = field(mapping(text), "CameraCalibrations")
    if not isinstance(entries, list) or not entries:
        raise ArgumentError(f"CameraCalibrations: expected a list of cameras, got {shown(entries)}")
    found: dict[str, RigCamera] = {}
    for i, entry in enumerate(entries):
        with within(f"CameraCalibrations[{i}]"):
            label = one_of("Label", field(entry, "Label"), _SIZES)
            if label in found:
                raise ArgumentError(f"Label: expected each label once, got {label} again")
            late = number("TimeOffsetSec_Device_Camera", entry.get("TimeOffsetSec_Device_Camera", 0.0))
            found[label] = RigCamera(_camera(label, field(entry, "Projection")), _pose(entry), late)
    return Rig(found)


def rig_to_aria(rig: Rig) -> str:
    """Return the JSON of a rig whose cameras are named by labels; the rig's frame is the device's.

    Raises:
        ArgumentError: as :func:`write_aria`.
    """
    entries = []
    for label, mounted in rig.cameras.items():
        with within(label):
            row, values = _projection(label, mounted.camera)
        x, y, z, w = (Rotation.from_matrix(mounted.pose.rotation).as_quat(canonical=True) + 0.0).tolist()
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


def _camera(label: str, projection: object) -> Camera:
    row = _MODELS[one_of("Projection: Name", field(projection, "Name"), _MODELS)]
    values = numbers("Projection: Params", field(projection, "Params"), (len(row.numbers),)).tolist()
    return camera_of(row.model, *_SIZES[label], read_numbers(row, values, HALF_PIXEL))


def _pose(entry: Mapping[str, Any]) -> Pose:
    given = field(entry, "T_Device_Camera")
    with within("T_Device_Camera"):
        translation = numbers("Translation", field(given, "Translation"), (3,))
        quaternion = field(given, "UnitQuaternion")
        if not isinstance(quaternion, list) or len(quaternion) != 2:
            raise ArgumentError(f"UnitQuaternion: expected [w, [x, y, z]], got {shown(quaternion)}")
        w = number("UnitQuaternion: w", quaternion[0])
        xyz = numbers("UnitQuaternion: [x, y, z]", quaternion[1], (3,))
        if not np.hypot(w, np.linalg.norm(xyz)) > 1e-12:
            raise ArgumentError(f"UnitQuaternion: expected one of length 1, got {shown(quaternion)}")
        return Pose(translation, Rotation.from_quat([*xyz, w]).as_matrix())


def _projection(label: str, camera: Camera) -> tuple[FormatModel, list[float]]:
    size = _SIZES[one_of("label", label, _SIZES)]
    found = fit_format(camera, _MODELS.values(), HALF_PIXEL)
    if found is None:
        raise ArgumentError(
            f"Aria: expected fisheye624 with one focal length or kannala-brandt, unskewed, got {camera.name}"
        )
    if (camera.width, camera.height) != size:
        wanted = "x".join(map(str, size))
        raise ArgumentError(f"size: expected {wanted} px of {label}, got {camera.width}x{camera.height}")
    return found
