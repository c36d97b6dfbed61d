"""Each form and model against the program's own formula, in files made from the programs' documentation."""

# ruff: noqa: E501
import io
import json
import re
from typing import Any

import cv2
import numpy as np
import pytest
from test_opencv import omnidir

from omniscv import calibration, cameras
from omniscv.calibration.files import doubts, loads_rig, read
from omniscv.errors import ArgumentError

F = {"fx": 310.5, "fy": 309.25, "cx": 322.25, "cy": 238.75}
K = [[F["fx"], 0.0, F["cx"]], [0.0, F["fy"], F["cy"]], [0.0, 0.0, 1.0]]
D5 = [-0.12, 0.03, 1e-3, -2e-3, 4e-3]
D8 = [0.1, 0.02, 1e-3, -2e-3, 4e-3, 0.3, 0.05, 2e-3]
KB = [0.03, -0.012, 0.005, -1e-3]
SIZE = (640, 480)
EYE = np.eye(4).tolist()
POINTS = np.random.default_rng(7).uniform((-0.9, -0.65, 1), (0.9, 0.65, 1), (400, 3))


def pinhole(points: np.ndarray, D: Any = D5, matrix: Any = K) -> np.ndarray:
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.array(matrix), np.array(D))[0][:, 0]


def four(points: np.ndarray) -> np.ndarray:
    return pinhole(points, D5[:4])


def ideal(points: np.ndarray, matrix: Any = K) -> np.ndarray:
    return pinhole(points, [0.0] * 4, matrix)


def fisheye(points: np.ndarray, k: Any = KB, matrix: Any = K) -> np.ndarray:
    r3 = np.zeros(3)
    return cv2.fisheye.projectPoints(points[:, None], r3, r3, np.array(matrix), np.array(k))[0][:, 0]


def mei(points: np.ndarray) -> np.ndarray:
    """Mei and Rives 2007; the same as cv::omnidir's manual."""
    return omnidir(K, 1.2, D5[:4], points)


def fov(points: np.ndarray, omega: float) -> np.ndarray:
    """Devernay and Faugeras 2001, as DSO's Undistort.cpp has it."""
    plane = points[:, :2] / points[:, 2:]
    r = np.linalg.norm(plane, axis=1, keepdims=True)
    factor = np.arctan(r * 2 * np.tan(omega / 2)) / (omega * r)
    return ideal(np.hstack([plane * factor, np.ones_like(r)]))


def of_angle(points: np.ndarray, radius: Any, center: Any) -> np.ndarray:
    """A lens of revolution by its radius, px, of the angle."""
    rho = np.hypot(points[:, 0], points[:, 1])
    return radius(np.arctan2(rho, points[:, 2]))[:, None] * points[:, :2] / rho[:, None] + center


def double_sphere(points: np.ndarray, xi: float, alpha: float) -> np.ndarray:
    """Usenko et al. 2018, eq. 40."""
    x, y, z = points.T
    d1 = np.sqrt(x * x + y * y + z * z)
    d2 = np.sqrt(x * x + y * y + (xi * d1 + z) ** 2)
    n = alpha * d2 + (1 - alpha) * (xi * d1 + z)
    return np.stack([F["fx"] * x / n + F["cx"], F["fy"] * y / n + F["cy"]], axis=1)


def eucm(points: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """Khomutenko et al. 2016."""
    x, y, z = points.T
    n = alpha * np.sqrt(beta * (x * x + y * y) + z * z) + (1 - alpha) * z
    return np.stack([F["fx"] * x / n + F["cx"], F["fy"] * y / n + F["cy"]], axis=1)


def flat(matrix: Any) -> str:
    return ", ".join(map(str, np.ravel(matrix)))


def opencv_matrix(name: str, matrix: Any, rows: int) -> str:
    cols = np.size(matrix) // rows
    head = f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n"
    return f"{head}   data:[ {flat(matrix)} ]\n"


def keys(prefix: str, values: dict[str, Any], join: str = ": ") -> str:
    return "".join(f"{prefix}{key}{join}{value}\n" for key, value in values.items())


def camodocal(model: str, **groups: dict[str, Any]) -> str:
    head = f"%YAML:1.0\n---\nmodel_type: {model}  # of camodocal\ncamera_name: cam\nimage_width:\t640\nimage_height: 480\n"
    return head + "".join(f"{name}:\n{keys('   ', values)}" for name, values in groups.items())


def basalt(camera_type: str, **more: float) -> str:
    pose = {"px": 0.1, "py": 0.2, "pz": 0.3, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
    lens = {"camera_type": camera_type, "intrinsics": {**F, **more}}
    rig = {"T_imu_cam": [pose], "intrinsics": [lens], "resolution": [SIZE], "cam_time_offset_ns": 1000000}
    return json.dumps({"value0": rig})


def kalibr(model: str, own: list[float], distortion: str = "none", k: Any = ()) -> str:
    chain = {"camera_model": model, "intrinsics": [*own, *F.values()], "distortion_model": distortion}
    return json.dumps({"cam0": {**chain, "distortion_coeffs": [*k], "resolution": SIZE}})


def nerf(**values: Any) -> str:
    frames = [{"file_path": "a.png", "transform_matrix": EYE}]
    return json.dumps({"w": 640.0, "h": 480, "aabb_scale": 4, **values, "frames": frames})


def npz() -> bytes:
    file = io.BytesIO()
    np.savez(file, mtx=np.array(K), dist=np.array([D5]), rvecs=np.array([np.zeros(3), None], dtype=object))
    return file.getvalue()


def depthai(coefficients: list[float], camera_type: int = 0) -> str:
    """Two sockets, each a pair of its number and its camera: the names of both are made up."""
    camera = {"cameraType": camera_type, "distortionCoeff": coefficients, "height": 480, "width": 640}
    both = [[socket, {**camera, "intrinsicMatrix": K}] for socket in (0, 2)]
    turned = {"rectifiedRotationLeft": [[0.9, 0.1, 0]] * 3}
    return json.dumps({"cameraData": both, "stereoRectificationData": turned, "version": 6})


def metashape(projection: str, **values: float) -> str:
    body = "".join(f"<{key}>{value}</{key}>" for key, value in values.items())
    head = f"<projection>{projection}</projection><width>640</width><height>480</height>"
    return f'<?xml version="1.0"?>\n<calibration>{head}{body}<date>2026</date></calibration>'


def openmvg(name: str, **values: Any) -> str:
    data = {"width": 640, "height": 480, "focal_length": 310.5, "principal_point": [322.25, 238.75], **values}
    wrapped = {"polymorphic_id": 2147483649, "polymorphic_name": name, "ptr_wrapper": {"id": 1, "data": data}}
    return json.dumps({"views": [], "intrinsics": [{"key": 0, "value": wrapped}]})


def opensfm(kind: str, **values: float) -> str:
    return json.dumps({"v2 a b": {"projection_type": kind, "width": 640, "height": 480, **values}})


NEW = {"distortion_parameters": {"k1": -0.12, "k2": 0.03, "p1": 1e-3, "p2": "-2e-3"}}
GAMMA = {"gamma1": F["fx"], "gamma2": F["fy"], "u0": F["cx"], "v0": F["cy"]}
MU = {"mu": F["fx"], "mv": F["fy"], "u0": F["cx"], "v0": F["cy"]}
FIVE = dict(zip(("k1", "k2", "p1", "p2", "k3"), D5, strict=True))
EIGHT = dict(zip((*FIVE, "k4", "k5", "k6"), D8, strict=True))
K14 = dict(zip(("k1", "k2", "k3", "k4"), KB, strict=True))
K2 = dict(zip(("k2", "k3", "k4", "k5"), KB, strict=True))
POLY = (330.0, -20.0, 15.0, -3.0)
NORMED = {"focal_x": 310.5 / 640, "focal_y": 309.25 / 640, "c_x": 0.01, "c_y": -0.02}
SFM = [[310.5, 0, 326.4], [0, 309.25, 227.2], [0, 0, 1.0]]
SQUARE = [[310.5, 0, F["cx"]], [0, 310.5, F["cy"]], [0, 0, 1.0]]
META = [[310.5, -2.5, 322.0], [0, 310.0, 237.0], [0, 0, 1.0]]
ORB = "%YAML:1.0\n\n" + keys("Camera.", F) + "ORBextractor.scaleFactor: 1.2\n"
ROS = f"width: 640\nheight: 480\ndistortion_model: '{{}}'\nD: {{}}\nK: [{flat(K)}]\nR: [{flat(np.eye(3))}]\nP: []\n"
RECT = f"P_rect_00: {flat(np.column_stack([K, [0, 0, 0]])).replace(',', '')}\nS_rect_00: 640.0 480.0\n"
INI = "# oST\n[image]\nwidth\n640\n\nheight\n480\n\n[cam]\n\ncamera matrix\n310.5 0 322.25\n0 309.25 238.75\n0 0 1\n\n"
ZED = f"[LEFT_CAM_VGA]\n{keys('', F, '=')}k1=-0.12\nk2=0.03\np1=0.001\np2=-0.002\nk3=0.004\n[STEREO]\nBaseline=63\n"
PTO = 'p f2 w9 h9 v360 n"TIFF"\ni w640 h480 f{} v{} a{} b{} c{} d2.25 e-1.5 g0 t0 r0 p0 y0 n"a.jpg"\n'
THREE = [-0.12, 0.03, 0, 0, 4e-3]

CASES: dict[str, tuple[str | bytes, Any]] = {
    "camodocal-mei": (camodocal("MEI", mirror_parameters={"xi": 1.2}, **NEW, projection_parameters=GAMMA), mei),
    "camodocal-kb": (camodocal("KANNALA_BRANDT", projection_parameters={**K2, **MU}), fisheye),
    "camodocal-kb-other-heading": (camodocal("KANNALA_BRANDT", distortion_parameters=K2, projection_parameters=MU), fisheye),
    "camodocal-pinhole": (camodocal("PINHOLE", **NEW, projection_parameters=F), four),
    "camodocal-full": (
        camodocal("PINHOLE_FULL", distortion_parameters=EIGHT, projection_parameters=F), lambda p: pinhole(p, D8)
    ),
    "orb-slam2": (ORB + keys("Camera.", FIVE) + "Viewer.PointSize:2\n", pinhole),
    "orb-slam3-kb": ('Camera.type: "KannalaBrandt8"\n' + keys("Camera1.", F) + keys("Camera1.", K14), fisheye),
    "stella": (f"Camera:\n  model: fisheye\n  cols: 640\n  rows: 480\n{keys('  ', F)}{keys('  ', K14)}", fisheye),
    "K-and-D": (json.dumps({"cameraMatrix": K, "dist_coefs": [D5], "image_size": SIZE, "rms": 0.3}), pinhole),
    "opencv-2": (
        f"<opencv_storage><image_Width>640</image_Width><image_Height>480</image_Height>"
        f'<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>{flat(K)}</data>'
        f"</Camera_Matrix><Distortion_Coefficients><data>{flat(D5)}</data></Distortion_Coefficients>"
        "<FixAspectRatio>1.</FixAspectRatio></opencv_storage>",
        pinhole,
    ),
    "fisheye-tutorial": (f"DIM: [640, 480]\nmodel: fisheye\nK: {K}\nD: {[[k] for k in KB]}\n", fisheye),
    "npz": (npz(), pinhole),
    "instant-ngp": (nerf(fl_x=310.5, fl_y=309.25, cx=322.25, cy=238.75, k1=-0.12, k2=0.03, p1=1e-3, p2=-2e-3), four),
    "nerf-angle": (
        nerf(camera_angle_x=1.2),
        lambda p: ideal(p, [[320 / np.tan(0.6), 0, 320], [0, 320 / np.tan(0.6), 240], [0, 0, 1]]),
    ),
    "nerfstudio-fisheye": (nerf(camera_model="OPENCV_FISHEYE", fl_x=310.5, fl_y=309.25, cx=322.25, cy=238.75, **K14), fisheye),
    "kitti": (RECT, ideal),
    "kitti-raw": (
        f"calib_time: 09-Jan-2012 13:57:47\nS_00: 6.4e+02 4.8e+02\nK_00: {flat(K).replace(',', '')}\nD_00: {flat(D5).replace(',', '')}\n",
        pinhole,
    ),
    "middlebury": (
        "cam0=[310.5 0 322.25; 0 310.5 238.75; 0 0 1]\ndoffs=0\nbaseline=193.0\nwidth=640\nheight=480\n",
        lambda p: ideal(p, SQUARE),
    ),
    "ros-print": (ROS.format("plumb_bob", D5) + "binning_x: 0\n---\n", pinhole),
    "ros-fisheye": (ROS.format("Equidistant", KB), fisheye),
    "ros-rational": (ROS.format("rational_polynomial", D8), lambda p: pinhole(p, D8)),
    "ros-empty": (ROS.format("plumb_bob", []), ideal),
    "ros-ini": (INI + f"distortion\n{flat(D5).replace(',', '')}\n", pinhole),
    "realsense": (
        json.dumps({"color": {"width": 640, "height": 480, "fx": 310.5, "fy": 309.25, "ppx": 322.25, "ppy": 238.75, "model": "Brown Conrady", "coeffs": D5}}),
        pinhole,
    ),
    "nested-yaml": (
        "camera:\n  size: {width: 640, height: 480}\n  intrinsics: {fx: 310.5, fy: 309.25, cx: '322.25', cy: 238.75}\n"
        "  distortion: {k1: -0.12, k2: 0.03, p1: 1e-3, p2: -2e-3, k3: 0.004}\n",
        pinhole,
    ),
    "open3d": (json.dumps({"width": 640, "height": 480, "intrinsic_matrix": np.transpose(K).ravel().tolist()}), ideal),
    "openvins": (
        "%YAML:1.0\n\ncam0:\n  T_imu_cam: #rotation\n    - [1.0, 0.0, 0.0, 0.0]\n    - [0.0, 1.0, 0.0, 0.0]\n    - [0.0, 0.0, 1.0, 0.0]\n"
        "    - [0.0, 0.0, 0.0, 1.0]\n  camera_model: pinhole\n  distortion_coeffs: [-0.12,0.03,0.001,-0.002]\n"
        "  distortion_model: radtan\n  intrinsics: [310.5,309.25,322.25,238.75] #fu, fv\n  resolution: [640, 480]\n",
        four,
    ),
    "sensor.yaml": (
        f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{flat(EYE)}]\nresolution: [640, 480]\ncamera_model: pinhole\n"
        "intrinsics: [310.5, 309.25, 322.25, 238.75]\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [-0.12, 0.03, 0.001, -0.002]\n",
        four,
    ),
    "basalt-ds": (basalt("ds", xi=-0.2, alpha=0.6), lambda p: double_sphere(p, -0.2, 0.6)),
    "basalt-eucm": (basalt("eucm", alpha=0.6, beta=1.1), lambda p: eucm(p, 0.6, 1.1)),
    "basalt-ucm": (basalt("ucm", alpha=0.6), lambda p: eucm(p, 0.6, 1.0)),
    "basalt-kb4": (basalt("kb4", **K14), fisheye),
    "woodscape": (
        json.dumps({"extrinsic": {"quaternion": [0, 0, 0, 1], "translation": [1, 0, 0]}, "intrinsic": {"aspect_ratio": 1.0, "cx_offset": 3.9, "cy_offset": -3.1, "height": 480.0, "width": 640.0, "k1": 330.0, "k2": -20.0, "k3": 15.0, "k4": -3.0, "model": "radial_poly", "poly_order": 4}, "name": "FV"}),
        lambda p: of_angle(p, lambda a: sum(k * a**i for i, k in enumerate(POLY, 1)), (320 + 3.9 - 0.5, 240 - 3.1 - 0.5)),
    ),
    "metashape": (
        metashape("frame", f=310.0, cx=2.0, cy=-3.0, b1=0.5, b2=-2.5, k1=-0.12, k2=0.03, k3=4e-3, p1=-2e-3, p2=1e-3),
        lambda p: (np.array(META) @ np.column_stack([pinhole(p, D5, np.eye(3)), np.ones(400)]).T)[:2].T,
    ),
    "metashape-fisheye": (
        metashape("fisheye", f=310.5, cx=2.25, cy=-1.25, k1=KB[0], k2=KB[1], k3=KB[2], k4=KB[3]),
        lambda p: fisheye(p, KB, [[310.5, 0, 322.25], [0, 310.5, 238.75], [0, 0, 1]]),
    ),
    "opensfm-brown": (opensfm("brown", **NORMED, **FIVE), lambda p: pinhole(p, D5, SFM)),
    "opensfm-perspective": (
        opensfm("perspective", focal=0.5, k1=-0.12, k2=0.03),
        lambda p: pinhole(p, [-0.12, 0.03, 0, 0], [[320.0, 0, 320], [0, 320, 240], [0, 0, 1]]),
    ),
    "opensfm-fisheye": (opensfm("fisheye_opencv", **NORMED, **K14), lambda p: fisheye(p, KB, SFM)),
    "openmvg": (openmvg("pinhole_radial_k3", disto_k3=[-0.12, 0.03, 4e-3]), lambda p: pinhole(p, THREE, SQUARE)),
    "openmvg-brown": (openmvg("pinhole_brown_t2", disto_t2=[-0.12, 0.03, 4e-3, 1e-3, -2e-3]), lambda p: pinhole(p, D5, SQUARE)),
    "meshroom": (
        json.dumps({"version": ["1", "2", "6"], "intrinsics": [{"intrinsicId": "7", "width": "640", "height": "480", "sensorWidth": "32", "sensorHeight": "24", "type": "radial3", "initialFocalLength": "15", "focalLength": "15.525", "pixelRatio": "1", "principalPoint": ["2.25", "-1.25"], "distortionInitializationMode": "none", "distortionParams": THREE[:2] + THREE[4:], "undistortionOffset": ["0", "0"], "undistortionParams": ""}]}),
        lambda p: pinhole(p, THREE, SQUARE),
    ),
    "meshroom-old": (
        json.dumps({"intrinsics": [{"intrinsicId": 7, "width": 640, "height": 480, "sensorWidth": -1.0, "type": "fisheye4", "pxInitialFocalLength": -1, "pxFocalLength": 310.5, "principalPoint": {"x": 322.25, "y": 238.75}, "distortionParams": KB}]}),
        lambda p: fisheye(p, KB, SQUARE),
    ),
    "nuscenes": (
        json.dumps([{"token": "t", "translation": [1, 0, 0], "rotation": [1, 0, 0, 0], "camera_intrinsic": K}, {"token": "u", "translation": [0, 0, 0], "rotation": [1, 0, 0, 0], "camera_intrinsic": []}]),
        ideal,
    ),
    "dso": ("RadTan 310.5 309.25 322.25 238.75 -0.12 0.03 0.001 -0.002\n640 480\ncrop\n640 480\n", four),
    "dso-relative": (
        "Pinhole 0.5 0.6 0.51 0.49 0\n640\t480\nnone\n640 480\n",
        lambda p: ideal(p, [[320, 0, 0.51 * 640 - 0.5], [0, 288.0, 0.49 * 480 - 0.5], [0, 0, 1]]),
    ),
    "dso-fov": ("310.5 309.25 322.25 238.75 0.9\n640 480\ncrop\n640 480\n", lambda p: fov(p, 0.9)),
    "kalibr-fov": (kalibr("pinhole", [], "fov", [0.9]), lambda p: fov(p, 0.9)),
    "kalibr-omni": (kalibr("omni", [1.2], "radtan", D5[:4]), mei),
    "kalibr-eucm": (kalibr("eucm", [0.6, 1.1]), lambda p: eucm(p, 0.6, 1.1)),
    "kalibr-ds": (kalibr("ds", [-0.2, 0.6]), lambda p: double_sphere(p, -0.2, 0.6)),
    "zed": (ZED, pinhole),
    "hugin-fisheye": (
        PTO.format(3, 110, -0.01, 0.02, -0.03),
        lambda p: of_angle(
            p,
            lambda a: (lambda r: 240 * r * (-0.01 * r**3 + 0.02 * r**2 - 0.03 * r + 1.02))(a * 640 / np.radians(110) / 240),
            (322.25, 238.5),
        ),
    ),
    "hugin-flat": (
        PTO.format(0, 60, 0, 0.02, 0),
        lambda p: of_angle(
            p, lambda a: (lambda r: 240 * r * (0.02 * r**2 + 0.98))(np.tan(a) * 320 / np.tan(np.pi / 6) / 240), (322.25, 238.5)
        ),
    ),
    "gyroflow": (
        json.dumps({"name": "a", "calib_dimension": {"w": 640, "h": 480}, "frame_readout_time": None, "input_horizontal_stretch": 1.0, "fisheye_params": {"RMS_error": 0.4, "camera_matrix": K, "distortion_coeffs": KB}}),
        fisheye,
    ),
    "kalibr-rational": (
        f"cam0:\n  intrinsics: {[*F.values()]}\n  distortion_coeffs: {D8}\n  resolution: [640, 480]\n  distortion_model: rational_polynomial\n",
        lambda p: pinhole(p, D8),
    ),
    "four-numbers": (f"cam_left:\n  intrinsics: {[*F.values()]}\n  distortion: {D5}\n  image_size: {{w: 640, h: 480}}\n", pinhole),
    "four-numbers-ros": (f"intrinsic: {[*F.values()]}\nD: {KB}\ndistortion_model: equidistant\nwidth: 640\nheight: 480\n", fisheye),
    "cam-K": (json.dumps({"cam_K": {"rows": 3, "cols": 3, "data": K}, "cam_dist": {"cols": 5, "data": D5}, "size": SIZE}), pinhole),
    "K-ir-projected": (
        json.dumps({"K_ir": K, "dist_ir": D5, "P1": np.column_stack([K, [0, 0, 0]]).tolist(), "image_size": SIZE, "shutter_us": 8000}),
        pinhole,
    ),
    "flat-pair": (
        f"distortion_model: equidistant\ncamera_resolution: [640, 480]\nleft_camera_intrinsics: {[*F.values()]}\n"
        f"left_camera_distortion_coefficients: {KB} # k1, k2, k3, k4\n",
        fisheye,
    ),
    "depthai": (depthai(D8 + [0.0] * 6), lambda p: pinhole(p, D8)),
    "calibration-model": (json.dumps({"calibration_model": "fisheye", "K": K, "D": KB, "image_size": SIZE}), fisheye),
    "spaced-colons": (keys("", F, " :") + keys("", FIVE, " :") + "width :640\nheight :480\n", pinhole),
    "ini-sections": (
        "# [calibration] of a rig\n[calibration]\n# K = [[fx,0,cx],[0,fy,cy],[0,0,1]]\n"
        f"{keys('', F, ' = ')}width = 640\nheight = 480\n\n[distortion]\n{keys('', FIVE, ' = ')}",
        pinhole,
    ),
    "ros-ini-namespace": (INI.replace("[cam]", "[/usb_cam]") + f"distortion\n{flat(D5).replace(',', '')}\n", pinhole),
    "calibdb": (json.dumps({"camera_matrix": K, "distortion_coefficients": D5, "distortion_model": "rectilinear", "img_size": SIZE}), pinhole),
    "json-with-comments": (f'{{\n  // from "calibrate.py"\n  "K": {K}, "D": {D5},\n  "image_size": [640, 480]\n}}\n', pinhole),
    "openicc": (
        json.dumps({"intrinsic_type": "FISHEYE", "image_width": 640, "image_height": 480, "intrinsics": {"focal_length": 310.5, "aspect_ratio": 309.25 / 310.5, "principal_pt_x": 322.25, "principal_pt_y": 238.75, "skew": 0.0, **{f"radial_distortion_{i}": k for i, k in enumerate(KB, 1)}}}),
        fisheye,
    ),
}  # fmt: skip
"""By name: the file, and its program's projection of points."""
CORNERS = ("instant-ngp", "nerf", "metashape", "opensfm", "hugin")
"""Names of programs that put pixel centres at .5 start so; others put them at whole numbers."""


def theirs(name: str, points: np.ndarray) -> np.ndarray:
    return CASES[name][1](points) + (0.0 if name.startswith(CORNERS) else 0.5)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("dialect", ["\n", "\ufeff\r\n"])
def test_pixels_are_the_programs(name: str, dialect: str) -> None:
    text, _ = CASES[name]
    if isinstance(text, str):
        text = dialect.removesuffix("\n").removesuffix("\r") + text.replace("\n", dialect.lstrip("\ufeff"))
    sized = name in ("npz", "orb-slam2", "orb-slam3-kb")
    loaded = read(text, None, SIZE if sized else None).entries
    camera = next(iter(loaded.values())).camera
    points = POINTS * (0.8, 0.8, 1) if name.startswith("hugin") else POINTS
    pixels, valid = camera.project(points)
    assert valid.mean() > 0.6
    np.testing.assert_allclose(pixels[valid], theirs(name, points)[valid], rtol=0, atol=1e-9)


def test_poses_of_rigs() -> None:
    """Where the second camera of each is, 0.1 m to the right of the first or of the body."""
    T = np.eye(4)
    T[0, 3] = 0.1
    kb = keys("Camera{}.k", dict(enumerate(KB, 1)))
    orb = 'Camera.type: "KannalaBrandt8"\nCamera.width: 640\nCamera.height: 480\n'
    both = "".join((keys(f"Camera{i}.", F) + kb.replace("{}", str(i))) for i in (1, 2))
    stereo = {"K1": K, "D1": D5, "K2": K, "D2": D5, "R": np.eye(3).tolist(), "T": [[-0.1], [0], [0]]}
    vins = "cam{}: {{T_imu_cam: {}, camera_model: pinhole, distortion_coeffs: [0, 0, 0, 0], distortion_model: radtan, "
    vins += "intrinsics: [300, 300, 320, 240], resolution: [640, 480], timeshift_cam_imu: 0.01}}\n"
    kitti = "".join(f"K_0{i}: {flat(K)}\nD_0{i}: {flat(D5)}\nS_0{i}: 640 480\nR_0{i}: {flat(np.eye(3))}\nT_0{i}: {-0.1 * i} 0 0\n" for i in (0, 1)).replace(",", "")  # fmt: skip
    texts = {
        "orb": orb + both + opencv_matrix("Stereo.T_c1_c2", T, 4),
        "bf": ORB + "Camera.width: 640\nCamera.height: 480\nCamera.bf: 31.05\n",
        "K1": json.dumps({**stereo, "image_size": SIZE}),
        "openvins": vins.format(0, EYE) + vins.format(1, T.tolist()),
        "kitti": kitti,
        "middlebury": "cam0=[300 0 320; 0 300 240; 0 0 1]\ncam1=[300 0 320; 0 300 240; 0 0 1]\nbaseline=100\nwidth=640\nheight=480\n",
    }  # fmt: skip
    for name, text in texts.items():
        first, second = (mounted.pose.position for mounted in loads_rig(text).cameras.values())
        np.testing.assert_allclose(second - first, (0.1, 0, 0), atol=1e-12, err_msg=name)
    rounded = [[0.999983, 0.00445005, 0.00385861, 0.1], [-0.00443664, 0.999984, -0.00347621, 0], [-0.00387402, 0.00345903, 0.999986, 0], [0, 0, 0, 1]]  # fmt: skip
    _, second = loads_rig(orb + both + opencv_matrix("Stereo.T_c1_c2", rounded, 4)).cameras.values()
    np.testing.assert_allclose(second.pose.rotation, np.array(rounded)[:3, :3], atol=2e-6)  # as printed
    (mounted,) = loads_rig(basalt("ds", xi=-0.2, alpha=0.6)).cameras.values()
    assert (mounted.pose.position.tolist(), mounted.time_offset) == ([0.1, 0.2, 0.3], 1e-3)


REFUSED = {
    "fov": (ROS.format("fov", D5), "distortion_model: expected one of"),
    "thin prism": (json.dumps({"K": K, "D": D5, "distortion_model": "thin_prism_fisheye", "image_size": SIZE}), "got 'thin_prism"),
    "omni without xi": (json.dumps({"K": K, "D": D5, "model": "omnidirectional", "image_size": SIZE}), "got 'omni"),
    "skew": (json.dumps({"K": K, "D": D5, "skew": 0.1, "image_size": SIZE}), "skew: expected no such key"),
    "tilt": (json.dumps({"K": K, "D": [*D8, 0, 0, 0, 0, 0.01, 0], "image_size": SIZE}), "expected 0"),
    "K twice": (json.dumps({"K": K, "camera_matrix": np.eye(3).tolist(), "D": D5, "image_size": SIZE}), "camera_matrix and K"),
    "a key twice": ('{"K": 1, "K": 2}', "K: expected this key once"),
    "a key twice, YAML": ("image_width: 640\nimage_width: 641\n", "every key once"),
    "focal": (json.dumps({"fx": 1e308, "fy": 300, "cx": 320, "cy": 240, "width": 640, "height": 480}), "fx: expected"),
    "centre": (json.dumps({"fx": 300, "fy": 300, "cx": 1e300, "cy": 240, "width": 640, "height": 480}), "cx: expected"),
    "four": (json.dumps({"K": K, "D": KB, "image_size": SIZE}), "may be of two"),
    "four of one, none of another": (json.dumps({n: {"K": K, "D": D, "image_size": SIZE} for n, D in (("a", []), ("b", KB))}), "--from"),
    "a fisheye of DepthAI": (depthai(KB + [0.0] * 10, 1), "cameraType: expected 0"),
    "nine of DSO": ("310.5 309.25 322.25 238.75 -0.12 0.03 0.001 -0.002 0.004\n640 480\ncrop\n640 480\n", "expected 4 or 5 .* got 9"),
    "two models": (json.dumps(F | {"model": "fisheye", "distortion_model": "plumb_bob", "coeffs": D5, "width": 640, "height": 480}), "model and distortion_model"),
    "nothing": ("train: images\n", "none of their keys"),
    "modified": (CASES["realsense"][0].replace("Brown Conrady", "Modified Brown Conrady"), "coeff|expected 0"),
    "gyroflow": (CASES["gyroflow"][0].replace("stretch\": 1.0", "stretch\": 1.3"), "stretch: expected 1"),
    "hugin": (PTO.format(0, 60, 0.1, 0, 0), "odd powers"),
    "hugin's link": (PTO.format(0, 60, 0, 0, 0).replace("v60", "v="), "v: expected"),
    "hugin's panorama": (PTO.format(4, 360, 0, 0, 0).replace("d2.25 e-1.5", "d0 e0"), "f4: expected a full panorama, 2:1"),
    "hugin's strip": (PTO.format(4, 359, 0, 0, 0).replace("d2.25 e-1.5", "d0 e0").replace("h480", "h320"), "f4: expected a full"),
    "K1, a rotation vector": (json.dumps({"K1": K, "D1": D5, "K2": K, "D2": D5, "R": [0, 0, 0], "T": [0.1, 0, 0], "image_size": SIZE}), "R: expected a 3 x 3 matrix"),
    "kitti, two of T": (RECT + f"K_00: {flat(K)}\nR_00: {flat(np.eye(3))}\nT_00: 0 0\nD_00: 0 0 0 0 0\n".replace(",", ""), "R_00: expected a 3 x 3 matrix and T"),
    "metashape": (metashape("frame", f=310, k4=0.1), "k4: expected 0"),
    "distortion beside": ("cam:\n  intrinsics: {fx: 3, fy: 3, cx: 3, cy: 2}\n  distorsion_x: [0.1]\n  size: [6, 4]\n", "distorsion_x: expected"),
    "ncore": ('{"pixeldist_to_angle_poly": [0, 0.01], "resolution": [64, 48], "reference_poly": "PIXELDIST_TO_ANGLE", "principal_point": [31, 23], "max_angle": 1.0, "external_distortion_parameters": {"a": 1}}', "external_distortion"),
    "ncore rolling": ('{"angle_to_pixeldist_poly": [0, 100], "resolution": [64, 48], "reference_poly": "ANGLE_TO_PIXELDIST", "principal_point": [31, 23], "max_angle": 1.0, "shutter_type": "ROLLING_TOP_TO_BOTTOM"}', "write GLOBAL"),
    "zed, moved": (ZED.replace("k3=0.004\n", "") + "k3=0.004\n", "STEREO.k3: expected this key in sections of cameras"),
    "zed, lost": (ZED + ZED.replace("LEFT", "RIGHT").replace("k3=0.004\n", "").partition("[STEREO]")[0], "keys of the other cameras"),
    "another focal length": (nerf(fl_x=310.5, fl_y="a309", cx=322.25, cy=238.75), "fl_y: expected"),
    "a stray quote": (CASES["opensfm-brown"][0].replace('"k3"', 'lk3"'), "stray quote"),
    "tangential": ('{"pixeldist_to_angle_poly": [0, 0.01], "resolution": [64, 48], "reference_poly": "PIXELDIST_TO_ANGLE", "principal_point": [31, 23], "max_angle": 1.0, "tangential_coeffs": [0.1, 0]}', "tangential_coeffs"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_changes_the_geometry_is_refused_by_name(name: str) -> None:
    text, message = REFUSED[name]
    with pytest.raises(ArgumentError, match=message) as error:
        calibration.loads(text)
    assert "\n" not in str(error.value)


def test_keys_that_act() -> None:
    """A region, binning, a turned rectification, a line delay, the switch of VINS."""
    cut = "binning_x: 2\nbinning_y: 2\nroi: {x_offset: 40, y_offset: 20, width: 400, height: 300}\n"
    camera = calibration.loads(ROS.format("plumb_bob", D5) + cut)["cam0"]
    assert (camera.width, camera.height) == (200, 150)
    # The middle of the image's pixel (i, j) lies at 2 i + 1 + offset of the sensor, whose pixels have centres at .5.
    whole = pinhole(POINTS)
    pixels, valid = camera.project(POINTS)
    np.testing.assert_allclose(2 * pixels[valid] + (40, 20), whole[valid] + 0.5, atol=1e-9)
    turned = cv2.Rodrigues(np.array([0.0, 0.1, 0.0]))[0]
    P = np.column_stack([[[300.0, 0, 310], [0, 300, 250], [0, 0, 1]], [0.0] * 3])
    text = ROS.format("plumb_bob", D5).replace("P: []", f"P: [{flat(P)}]")
    lenses = read(text.replace(flat(np.eye(3)), flat(turned))).entries
    raw, _ = lenses["cam0"].camera.project(POINTS)
    np.testing.assert_allclose(raw, whole + 0.5, atol=1e-9)
    rectified, seen = lenses["cam0-rectified"].camera.project(POINTS @ turned.T)
    theirs = pinhole(POINTS @ turned.T, [0.0] * 4, P[:, :3]) + 0.5
    np.testing.assert_allclose(rectified[seen], theirs[seen], atol=1e-9)
    np.testing.assert_allclose(lenses["cam0-rectified"].pose.rotation, turned.T, atol=1e-12)
    delayed = CASES["openvins"][0].replace("  resolution", "  line_delay_nanoseconds: 30000\n  resolution")
    in_seconds = delayed.replace("line_delay_nanoseconds: 30000", "line_delay: 3.0e-05")
    shutter = calibration.loads(delayed)["cam0"]
    assert (shutter.name, shutter.readout) == ("rolling-shutter", pytest.approx(480 * 30e-6))
    again = calibration.loads(calibration.dumps({"cam0": shutter}, "kalibr"), "kalibr")["cam0"]
    assert again == shutter == calibration.loads(in_seconds)["cam0"]
    vins = CASES["camodocal-pinhole"][0] + "rolling_shutter: {}\nrolling_shutter_tr: 0.03\n"
    names = [calibration.loads(vins.format(on))["cam0"].name for on in (0, 1)]
    assert names == ["pinhole", "rolling-shutter"]


def test_a_lens_of_ours_has_our_mark_and_others_are_read_as_theirs(caplog: pytest.LogCaptureFixture) -> None:
    lens = cameras.create("pinhole", 640, 480, fx=300.0, fy=301.0, cx=319.5, cy=239.5)
    text = calibration.dumps({"cam0": lens}, "json")
    assert json.loads(text)["omniscv"] == 1
    assert calibration.loads(text)["cam0"] == lens
    assert not caplog.records
    unmarked = {key: value for key, value in json.loads(text).items() if key != "omniscv"}
    assert calibration.loads(json.dumps(unmarked))["cam0"] == lens
    assert "pixel centres are at .5" in caplog.text
    foreign = {key: unmarked[key] for key in ("model", "width", "height", "fx", "fy", "cx", "cy")}
    both = calibration.loads(json.dumps({"left": foreign, "right": foreign}))
    assert both["left"].center.tolist() == [320.0, 240.0]
    assert caplog.text.count("another program's, whose pixel centres are at whole numbers") == 1
    stereo = {"K1": K, "D1": D5, "K2": K, "D2": D5, "R": np.eye(3).tolist(), "image_size": SIZE}
    far = read(json.dumps(stereo | {"T": [-120, 0, 0]})).entries
    assert [entry.pose for entry in far.values()] == [None, None]
    assert caplog.text.count("divide T by 1000") == 1
    with pytest.raises(ArgumentError, match=r"expected the pose of every camera \(R, T\), got none"):
        loads_rig(json.dumps(stereo))
    read(json.dumps(stereo | {"T": [-0.12, 0, 0]}))
    assert caplog.text.count("taken as metres") == 1


def test_files_as_people_have_them() -> None:
    """A pair of ROS in one file, whose place is not known; Metashape's size of the sensor; extra lines of DSO."""
    turned = "rectification\n0 0 1\n0 1 0\n-1 0 0\nprojection\n300 0 310 0\n0 300 250 0\n0 0 1 0\n"
    ini = CASES["ros-ini"][0].replace("# oST", "# oST version 5.0")
    pair = "".join(ini.replace("[cam]", f"[{side}]") + turned for side in ("left", "right"))
    assert list(read(pair).entries) == ["left", "right", "left-rectified", "right-rectified"]
    with pytest.raises(ArgumentError, match="expected the pose of every camera"):
        loads_rig(pair)
    sensor = '<document><sensor label="RGB"><resolution width="1000" height="800"/><calibration type="frame">'
    lens = calibration.loads(f"{sensor}<f>500</f><cx>10</cx></calibration></sensor></document>")["RGB"]
    assert (lens.width, lens.height, lens.center.tolist()) == (1000, 800, [510.0, 400.0])
    assert list(calibration.loads(CASES["dso"][0] + "0.5 0 0\n")) == ["cam0"]
    for bare in ("\n".join(map(flat, K)), flat(K).replace(",", "") + "\n0.05\n"):  # K.txt
        pixels, _ = calibration.loads(bare, size=SIZE)["cam0"].project(POINTS)
        np.testing.assert_allclose(pixels, ideal(POINTS) + 0.5, atol=1e-9)
    pair = {"K1": K, "D1": D5, "K2": K, "D2": D5, "R": np.eye(3).tolist(), "T": [-0.12, 0, 0], "image_size": SIZE}  # fmt: skip
    # KITTI's have no K1.
    projected = {f"P{i}": np.column_stack([K, [-40.0 * i, 0, 0]]).tolist() for i in (1, 2)}
    right = loads_rig(json.dumps(pair | projected)).cameras["cam2"]
    np.testing.assert_allclose(right.pose.position, [0.12, 0, 0])
    device = F | {"model": "D435", "distortion_model": "plumb_bob", "coeffs": D5}
    spelled = {"K": K, "mtx": np.ravel(K).tolist(), "D": D5, "dist": [D5]}
    for twice in (device, spelled, {"K": K, "D": D5, "xi": 0}):
        pixels, _ = calibration.loads(json.dumps(twice | {"image_size": SIZE}))["cam0"].project(POINTS)
        np.testing.assert_allclose(pixels, pinhole(POINTS) + 0.5, atol=1e-9)
    nested = json.dumps({side: {"intrinsics": F, "width": 640, "height": 480} for side in "ab"})
    assert list(calibration.loads(nested)) == ["a", "b"]


def test_unknown_files_get_the_nearest_forms(tmp_path: Any) -> None:
    with pytest.raises(ArgumentError, match=r"nearest are .*camodocal \(no projection_parameters\)"):
        calibration.loads("model_type: PINHOLE\nimage_width: 3\nimage_height: 3\n")
    (tmp_path / "odd").write_text(ROS.format("plumb_bob", []).replace("322.25", "2322.25"), encoding="utf-8")
    assert any("lies outside" in line for line in doubts(calibration.load(tmp_path / "odd")["cam0"]))


UNSEEN = ("orb-slam2", "orb-slam3-kb", "cam-K", "K-ir-projected", "flat-pair")
"""Where a key of coefficients that is turned round is any other key: the camera's name is part of it."""
PLAIN_TEXTS = {name: case for name, case in CASES.items() if isinstance(case[0], str) and name not in UNSEEN}
WORDS = ("0", "-1", "null", "1e308", "nan", "foo", "[1, 2]", "7.25", "{}", '"x"')


def changed(text: str, random: np.random.Generator) -> str:
    """One thing changed at random: a byte, a key's name, a value, a line twice, lines exchanged."""
    lines = text.split("\n")
    at, other = random.integers(len(lines), size=2)
    match random.integers(6):
        case 0:
            i = int(random.integers(len(text)))
            return text[:i] + chr(random.integers(32, 127)) + text[i + 1 :]
        case 1:
            found = list(re.finditer(r"[A-Za-z_]\w+", text))
            word = found[random.integers(len(found))]
            return text[: word.start()] + word[0][::-1] + text[word.end() :]
        case 2:
            found = list(re.finditer(r"-?\d[\d.e+-]*", text))
            word = found[random.integers(len(found))]
            return text[: word.start()] + WORDS[random.integers(len(WORDS))] + text[word.end() :]
        case 3:
            return "\n".join([*lines[:at], lines[at], *lines[at:]])
        case 4:
            return text[: random.integers(len(text))]
        case _:
            lines[at], lines[other] = lines[other], lines[at]
            return "\n".join(lines)


def judged(name: str, text: str) -> str:
    """What came of a changed file: one line, the right camera, or one whose every number is in the text."""
    try:
        entries = read(text).entries
    except ArgumentError as error:
        return "refused" if "\n" not in str(error) else "wrong"
    camera = next(iter(entries.values())).camera
    pixels, valid = camera.project(POINTS[:40])
    if valid.any() and np.abs(pixels - theirs(name, POINTS)[:40])[valid].max() < 1e-6:
        return "right"
    before, after = (sorted(re.findall(r"-?\d[\d.e+-]*", each)) for each in (str(CASES[name][0]), text))
    return "another" if before != after else "wrong"


@pytest.mark.parametrize("cases", [300, pytest.param(20_000, marks=pytest.mark.soak)])
def test_what_comes_through_the_gate_is_right_or_refused(cases: int) -> None:
    """A change of a number makes another camera, and cannot be seen; any other is refused, or changes nothing.

    The plain readers of other libraries agree: OpenCV's formulas judge each camera that comes through.
    """
    random = np.random.default_rng(cases)
    names = list(PLAIN_TEXTS)
    outcomes = []
    for i in range(cases):
        name = names[i % len(names)]
        text = changed(str(CASES[name][0]), random)
        outcomes.append(judged(name, text))
        assert outcomes[-1] != "wrong", f"{name}:\n{text}"
    assert outcomes.count("refused") > cases / 5
    assert outcomes.count("right") > cases / 20
