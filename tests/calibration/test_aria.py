"""Aria's JSON, judged by pixels that projectaria_tools 2.3.0 gave for these parameters."""

import json
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.same_rays import assert_same_rig

from omniscv import Rig, RigCamera, calibration, cameras
from omniscv.calibration.files import loads_rig
from omniscv.calibration.table import ARIA
from omniscv.errors import ArgumentError

F624 = [240.0, 320.5, 239.25, 0.01, -0.002, 3e-4, 0, -1e-5, 0, 1e-4, 2e-4, 1e-5, -2e-6, 2e-5, 1e-6]
POINTS = [[0, 0, 1], [0.3, -0.2, 1], [-1, 0.5, 1], [0.2, 1.1, 1]]
KB3 = [240.0, 241.0, 320.5, 239.25, 0.01, -0.002, 3e-4, -1e-5]
GIVEN: dict[str, tuple[list[float], list[float]]] = {
    "FisheyeRadTanThinPrism": (F624, [
        320.5, 239.25, 389.685463800788, 193.13480633342004, 138.85740011792743, 330.11856673125436,
        356.8641129364112, 439.18792476756437,
    ]),
    "Fisheye62": (F624[:11], [
        320.5, 239.25, 389.68518264723576, 193.13422673805158, 138.8559275128239, 330.1150060528772,
        356.86264033130766, 439.1843640891872,
    ]),
    "KannalaBrandtK3": (KB3, [
        320.5, 239.25, 389.6836313821535, 192.93540232472498, 138.83887187661858, 330.4590247452811,
        356.8322256246763, 439.90985443961836,
    ]),
}  # fmt: skip


def document(name: str, params: list[float], **changes: Any) -> dict[str, Any]:
    entry = {"Label": "camera-slam-left", "Projection": {"Name": name, "Description": "", "Params": params}}
    pose = {"Translation": [0.1, 0.2, 0.3], "UnitQuaternion": [1.0, [0.0, 0.0, 0.0]]}
    entry |= {"SerialNumber": "1", "Calibrated": True, "T_Device_Camera": pose}
    return {"CameraCalibrations": [entry | changes], "ImuCalibrations": []}


@pytest.mark.parametrize("name", GIVEN)
def test_pixels_are_arias_plus_half_a_pixel(name: str) -> None:
    params, pixels = GIVEN[name]
    camera = calibration.loads(json.dumps(document(name, params)), "aria")["camera-slam-left"]
    assert (camera.width, camera.height) == (640, 480)
    projected, valid = camera.project(POINTS)
    assert valid.all()
    np.testing.assert_allclose((projected - 0.5).ravel(), pixels, rtol=0, atol=1e-9)


def test_a_device_is_a_rig_and_comes_back() -> None:
    focal = {"width": 640, "height": 480, "fx": 240.0, "fy": 240.0}
    lens = cameras.create("fisheye624", **focal, k=(0.01, 0, 0, 0, 0, 0), s=(1e-4, 0, 0, 0))
    wide = cameras.create("kannala-brandt", width=640, height=480, fx=300.0, fy=310.0)
    slam = RigCamera.turned(lens, (0.01, 0.02, 0.03), 20, -10, 30)
    eye = RigCamera.turned(wide, (0, 0.1, 0), 5, time_offset=0.002)
    rig = Rig({"camera-slam-left": slam, "camera-et-left": eye})
    text = ARIA.write(rig.cameras, rig=True)
    for entry in json.loads(text)["CameraCalibrations"]:  # by the definition of T_Device_Camera
        w, (x, y, z) = entry["T_Device_Camera"]["UnitQuaternion"]
        own = rig.cameras[entry["Label"]].pose
        p_device = Rotation.from_quat([x, y, z, w]).apply([1, 2, 3]) + entry["T_Device_Camera"]["Translation"]
        np.testing.assert_allclose(p_device, own.to_world([1, 2, 3]), atol=1e-12)
    assert_same_rig(loads_rig(text), rig)


def test_sizes_that_are_not_those_of_the_labels_are_written_and_read() -> None:
    """An online calibration has ``ImageSizes``: its RGB camera is 1408 px wide, not the sensor's 2880."""
    lens = cameras.create("kannala-brandt", width=640, height=480, fx=240.0, fy=240.0)
    assert "ImageSizes" not in calibration.dumps({"camera-slam-left": lens}, "aria")
    online = document("FisheyeRadTanThinPrism", F624, Label="camera-rgb") | {"ImageSizes": [[1408, 1400]]}
    camera = calibration.loads(json.dumps(online))["camera-rgb"]
    assert (camera.width, camera.height) == (1408, 1400)
    assert calibration.loads(calibration.dumps({"camera-rgb": camera}, "aria")) == {"camera-rgb": camera}
    with pytest.raises(ArgumentError, match="ImageSizes: expected one of each camera"):
        calibration.loads(json.dumps(online | {"ImageSizes": []}))
    with pytest.raises(ArgumentError, match="front: missing key 'ImageSize'"):
        calibration.loads(json.dumps(document("Fisheye62", F624[:11], Label="front")))
    stretched = cameras.create("fisheye624", width=640, height=480, fx=240.0, fy=241.0)
    with pytest.raises(ArgumentError, match=r"aria: expected fisheye624, .*got fisheye624"):
        calibration.dumps({"camera-slam-left": stretched}, "aria")
