"""Steps of forms: find the cameras of a file, change their numbers after reading, join them for writing."""

import logging
import re
from collections.abc import Mapping
from typing import Any, TypeGuard

import numpy as np

from omniscv.arguments import number, numbers, shown, wrong
from omniscv.calibration.documents import Content
from omniscv.calibration.forms import (
    SAME_QUANTITY,
    Entry,
    Form,
    LensNumbers,
    matrix_3x4,
    matrix_of_pose,
)
from omniscv.calibration.nodes import Node, Values, canonical, families, floats, leaves, mappings, marked
from omniscv.cameras.rig import ORIGIN
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose

_log = logging.getLogger("omniscv")


def shutter(node: Node, lens: LensNumbers) -> LensNumbers:
    """Check VINS's switch of the rolling shutter, and drop a time that it switches off.

    Args:
        node: the camera's mapping, which loses the time.
        lens: its numbers, which are returned as they are.
    """
    is_on = number("rolling_shutter", node.take("rolling_shutter", 1) or 0)
    if not is_on:
        values = dict(node.values)
        values.pop("rolling_shutter_tr", None)
        node.values = values
    return lens


def orb_cameras(content: Content) -> dict[str, Any]:
    """Return the cameras of ``Camera.fx``, or of ``Camera1.fx`` and ``Camera2.fx``."""
    cameras: dict[str, Any] = {}
    for node in mappings(content, ("Camera1.fx", "Camera.fx")):
        if not any(key.startswith("Camera") and ".fx" in key for key in node.values):
            continue  # another program's "camera" with "fx" in it
        first: Values = {}
        second: Values = {}
        pose: Values = {}
        shared: Values = {}
        for key, value in leaves(node.values):
            if key.startswith("Camera2."):
                second[key.replace("Camera2.", "Camera1.")] = value
                continue
            first[key] = value
            if key in ("Stereo.T_c1_c2", "Tlr"):
                pose[key] = value
            elif key.startswith("Camera."):
                shared[key] = value
        cameras[f"cam{len(cameras)}"] = first
        if second:
            for key in pose:
                del first[key]
            first["Stereo.T_c1_c2"] = np.eye(4).tolist()
            cameras[f"cam{len(cameras)}"] = second | pose | shared
    return cameras


def by_baseline(node: Node, entries: dict[str, Entry]) -> dict[str, Entry]:
    """Return a rectified stereo rig: the same camera twice, the second one a baseline to the right.

    Args:
        node: the document, which may hold a baseline, m, or its product with fx, px.
        entries: the cameras that were read; returned as they are where they are no such rig.
    """
    if len(entries) != 1 or node.has(("RGBD.DepthMapFactor", "DepthMapFactor", "depthmap_factor")):
        return entries
    ((name, entry),) = entries.items()
    fx = getattr(entry.camera, "fx", None)
    bf = ("Camera.bf", "Camera.focal_x_baseline")
    if node.has("Stereo.b"):
        baseline = number("Stereo.b", node.take("Stereo.b"))
    elif node.has(bf) and fx:
        baseline = number("Camera.bf", node.take(bf)) / fx
    else:
        return entries
    right = entry._replace(pose=Pose(np.array([baseline, 0, 0]), np.eye(3)))
    return {name: entry._replace(pose=ORIGIN), "cam1": right}


def join_orb(cameras: dict[str, Values]) -> Values:
    """Return the keys of one camera or two, which share type and size."""
    first, *others = cameras.values()
    document = {"File.version": "1.0", **first}
    document.pop("Stereo.T_c1_c2", None)
    shared = [key for key in first if key.startswith("Camera.")]
    for other in others:
        if len(others) > 1 or any(other[key] != first[key] for key in shared):
            wanted = "expected two at most, of one model and size (ORB-SLAM writes these once)"
            raise ArgumentError(f"cameras: {wanted}, got {len(cameras)}: {shown([*cameras.values()])}")
        for key, value in other.items():
            document[key.replace("Camera1.", "Camera2.")] = value
    return document


_FOCAL = ("fl_x", "camera_angle_x", "x_fov")
_STATEMENTS_OF_FOCAL = ("fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "x_fov", "y_fov")
_OF_A_FRAME = re.compile(
    r"^(?!.*mask).*path$|^mask_path$|^transform_matrix$|^depth$|index|id$|name|sharp|motion|"
    r"^time(stamp)?s?$|^rotation$"
)
"""Keys of a frame of ``transforms.json`` that are not of its lens."""
_SIDES = {9: 3, 12: 3, 16: 4}  # rows of a matrix of so many numbers
_MATRICES = ("K", "intrinsic_matrix", "camera_matrix", "intrinsics")
_OPENGL = ("opengl", "nerf", "nerfstudio", "blender")
"""What ``camera_convention`` calls the axes that poses of ``transforms.json`` have."""


def frames(content: Content) -> dict[str, Any]:
    """Return the camera of ``transforms.json``, or those of its frames where each has its own numbers."""
    lenses: list[Values] = []
    for node in mappings(content, "frames"):
        for lens in _lenses(node):
            if lens not in lenses:
                lenses.append(lens)
    return _numbered(lenses)


def _lenses(node: Node) -> list[Values]:
    """Return the lens of each frame of ``transforms.json``, or the only one; none without a focal length."""
    frames = node.take("frames")
    if not isinstance(frames, list):
        frames = []
    lenses = []
    for frame in frames:
        if isinstance(frame, Mapping) and Node(frame).has(_FOCAL):
            lenses.append(lens_of_frame(node.values, frame))
    if lenses and len(lenses) < len(frames):
        raise ArgumentError("frames: expected a focal length in each or in none, got it in some")
    if not lenses and node.has(_FOCAL):
        lenses.append(lens_of_frame(node.values, {}))
    return lenses


def _numbered(lenses: list[Values]) -> dict[str, Any]:
    """Return cameras by the names ``cam0``, ``cam1``, ..."""
    return {f"cam{i}": lens for i, lens in enumerate(lenses)}


def lens_of_frame(shared: Mapping[str, Any], frame: Mapping[str, Any]) -> Values:
    """Return the values of a frame's lens in ``transforms.json``: its own, else those of the file.

    Args:
        shared: the file's mapping.
        frame: an item of its list ``frames``.
    """
    own: Values = {}
    for key, value in frame.items():
        if not _OF_A_FRAME.search(key):
            own[key] = value
    lens = dict(shared)
    lens.pop("frames", None)
    if Node(own).has(_FOCAL):
        for key in _STATEMENTS_OF_FOCAL:
            lens.pop(key, None)
    lens |= own
    _take_fisheye(lens)
    _take_convention(lens)
    _take_degrees(lens)
    return lens


def _take_fisheye(lens: Values) -> None:
    """Take instant-ngp's word for a fisheye as its model; ArgumentError where both differ."""
    if "is_fisheye" not in lens:
        return
    is_fisheye = bool(lens.pop("is_fisheye"))
    model = lens.setdefault("camera_model", "OPENCV_FISHEYE" if is_fisheye else None)
    if model is not None and (model == "OPENCV_FISHEYE") != is_fisheye:
        word = str(is_fisheye).lower()
        raise ArgumentError(f"is_fisheye: expected what camera_model says, {model}, got {word}; remove one")


def _take_convention(lens: Values) -> None:
    """Drop a word for OpenGL's axes; ArgumentError for that of others."""
    convention = lens.pop("camera_convention", None)
    if convention is not None and str(convention).lower() not in _OPENGL:
        raise wrong("camera_convention", "opengl; convert poses to x right, y up, z back", convention)


def _take_degrees(lens: Values) -> None:
    """Replace instant-ngp's fields of view, degrees, by those in radians; ArgumentError where both differ."""
    for axis in "xy":
        if f"{axis}_fov" not in lens:
            continue
        angle = float(np.radians(number(f"{axis}_fov", lens.pop(f"{axis}_fov"), above=0, below=180)))
        other = lens.setdefault(f"camera_angle_{axis}", angle)
        _check_same(f"{axis}_fov", angle, f"camera_angle_{axis}", number(f"camera_angle_{axis}", other))


def _check_same(name: str, value: float, other_name: str, other: float) -> None:
    """Raise ArgumentError for two statements of a quantity that differ by more than a thousandth of it."""
    if not abs(value - other) <= SAME_QUANTITY * abs(other):
        expected = f"expected {other:.6g}, as {other_name} says"
        raise ArgumentError(f"{name}: {expected}, got {value:.6g}; remove one of both")


def agreeing(node: Node, lens: LensNumbers) -> LensNumbers:
    """Turn fields of view into focal lengths: ``fx = width / 2 / tan(angle / 2)``.

    Args:
        node: the camera's mapping, whose other statements of size, focal lengths and centre must agree.
        lens: its numbers, whose ``angle`` and ``angle_y``, radians, become ``fx`` and ``fy``.

    Raises:
        ArgumentError: two statements of a quantity differ by more than a thousandth of it.
    """
    values = dict(lens.values)
    sides = {"x": lens.width, "y": lens.height}
    angles = {"x": values.pop("angle", None), "y": values.pop("angle_y", None)}
    for axis, side in sides.items():
        name = f"camera_angle_{axis}"
        angle = node.take(name, None) if angles[axis] is None else angles[axis]
        if angle is None or lens.word == "EQUIRECTANGULAR":
            continue
        focal = float(side / 2 / np.tan(number(name, angle, above=0, below=np.pi) / 2))
        stated = values.setdefault(f"f{axis}", values.get("f", focal))
        _check_same(f"focal length by {name}", focal, f"fl_{axis}", stated)
    for key, side in (("width", lens.width), ("height", lens.height)):
        if node.has(key):
            _check_same(key, number(key, node.take(key)), key[0], side)
    if "f" in values:
        values.setdefault("fx", values["f"])
    if "fx" in values:
        values = {"fy": values["fx"], **values}
        _check_matrices(node, lens._replace(values=values))
    values.pop("f", None)
    return lens._replace(values=values)


def _check_matrices(node: Node, lens: LensNumbers) -> None:
    """Raise ArgumentError where matrices of a lens say other numbers than its keys."""
    for key in _MATRICES:
        entries = floats(key, node.values[key]) if key in node.values else []
        if len(entries) not in _SIDES:
            continue  # no matrix: the check of keys refuses it by name
        node.take(key)
        matrix = np.reshape(entries, (_SIDES[len(entries)], -1))
        entry_of = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
        known = {"cx": lens.width / 2, "cy": lens.height / 2, **lens.values}
        for name, entry in entry_of.items():
            _check_same(f"{name} of {key}", float(entry), name, known[name])


KITTI_MATRICES = ("K_00", "K_01", "K_02", "P_rect_00", "P_rect_02", "P0", "P2")
"""Keys of which a file of KITTI has one at least."""


def kitti(content: Content) -> dict[str, Any]:
    """Return the cameras of a KITTI file, by name: raw and rectified ones.

    A raw camera has the keys ``K_00``, ``D_00``, ``S_00``, ``R_00`` and ``T_00``. A rectified one has
    ``P_rect_00`` or ``P0``, where ``P = K [I | offset]``. ``R_rect_00`` turns camera 0 to the rectified ones.
    """
    cameras: dict[str, Any] = {}
    for node in mappings(content, KITTI_MATRICES):
        if node.has(("K1", "M1")):
            continue  # a stereo pair of OpenCV
        lenses, _ = families(node.values, r"(?P<key>[kdsrtp])(?P<name>(?:rect)?\d\d?)(?P<after>)")
        upright = np.eye(4)
        if "r" in lenses.get("rect00", {}):
            upright[:3] = matrix_3x4("R_rect_00", lenses["rect00"]["r"], [0.0] * 3)
        for name, lens in lenses.items():
            if "k" in lens:
                cameras[name] = _kitti_raw(name, lens)
            elif "p" in lens:
                label = name.replace("rect", "rect_") if "rect" in name else f"P{name}"
                cameras[label] = _kitti_rectified(name, lens, upright)
    return cameras


def _kitti_raw(name: str, lens: Values) -> Values:
    """Return the mapping of a camera of K, D, S, R and T, whose keys are in lower case."""
    camera = {"K": lens["k"], "D": Node(lens).take("D"), "S": lens.get("s")}
    if "r" in lens:
        camera["T"] = matrix_3x4(f"R_{name}", lens["r"], Node(lens).take("T")).tolist()
    return camera


def _kitti_rectified(name: str, lens: Values, upright: Array) -> Values:
    """Return the mapping of a camera of P; ``upright`` (4, 4) turns camera 0 to the rectified ones."""
    numbers_of_p = floats(f"P_{name}", lens["p"])
    if len(numbers_of_p) != 12 or not numbers_of_p[0]:
        raise wrong(f"P_{name}", "3 x 4 numbers of a camera", lens["p"])
    P = np.array(numbers_of_p).reshape(3, 4)
    offset = np.eye(4)
    offset[:3, 3] = np.linalg.solve(P[:, :3], P[:, 3])
    T_c_0 = (offset @ upright)[:3].ravel().tolist()
    return {"K": P[:, :3].ravel().tolist(), "D": [], "S": lens.get("s"), "T": T_c_0}


def join_kitti(cameras: dict[str, Values]) -> Values:
    """Return the lines of cameras 00, 01, ..."""
    document: Values = {}
    for name, lens in cameras.items():
        if not re.fullmatch(r"\d\d", name):
            raise ArgumentError(f"{name}: expected names 00, 01, ..., got {shown(name)}")
        T = np.array(lens.get("T", np.eye(4).tolist()))
        D = [*lens["D"], 0.0, 0.0, 0.0, 0.0, 0.0]
        document[f"S_{name}"] = lens["S"]
        document[f"K_{name}"] = lens["K"]
        document[f"D_{name}"] = D[:5]
        document[f"R_{name}"] = T[:3, :3].ravel().tolist()
        document[f"T_{name}"] = T[:3, 3].tolist()
    return document


def middlebury(content: Content) -> dict[str, Any]:
    """Return cam0 and cam1, which is straight to the right by the baseline, mm."""
    cameras: dict[str, Any] = {}
    for node in mappings(content, "cam0", "width", "height"):
        if not re.fullmatch(r"\[([-+\d.e]+[\s;\]]+){9}", str(node.take("cam0")).strip()):
            continue  # another program's "cam0"
        baseline = number("baseline", node.take("baseline", 0)) / 1000
        for name, x in (("cam0", 0.0), ("cam1", baseline)):
            if node.has(name):
                T = matrix_of_pose(Pose(np.array([x, 0, 0]), np.eye(3)))
                cameras[name] = Node({"K": node.take(name), "T": T}, (node.values,))
    return cameras


def basalt(content: Content) -> dict[str, Any]:
    """Return the cameras of three lists."""
    cameras: dict[str, Any] = {}
    for node in mappings(content, "value0.intrinsics"):
        rig = node.take("value0")
        lenses = rig.get("intrinsics")
        sizes = rig.get("resolution")
        poses = rig.get("T_imu_cam")
        for listed in (lenses, sizes, poses):
            if not isinstance(listed, list) or len(listed) != len(lenses):
                wanted = "expected intrinsics, resolution and T_imu_cam of every camera"
                raise ArgumentError(f"value0: {wanted}, got other lists")
        for lens, size, pose in zip(lenses, sizes, poses, strict=True):
            values = dict(lens) if isinstance(lens, Mapping) else {}
            values["resolution"] = size
            values["T_imu_cam"] = pose
            values["cam_time_offset_ns"] = rig.get("cam_time_offset_ns", 0)
            cameras[f"cam{len(cameras)}"] = values
    return cameras


def basalt_unified(node: Node, lens: LensNumbers) -> LensNumbers:
    """Set beta of basalt's unified model, which is the extended one with beta 1.

    Args:
        node: the camera's mapping, which is not used.
        lens: its numbers.
    """
    return lens._replace(values=lens.values | {"beta": 1.0}) if lens.word == "ucm" else lens


_ARIA_SIZES = {
    "camera-slam-left": [640, 480], "camera-slam-right": [640, 480], "camera-rgb": [2880, 2880],
    "camera-et-left": [640, 480], "camera-et-right": [640, 480],
}  # fmt: skip
"""Full resolution by label: a factory calibration, which has no sizes, is of these images."""


def aria(content: Content) -> dict[str, Any]:
    """Return the cameras of a factory calibration of Project Aria's glasses, as the file has them, by label.

    Each gets the size that the file says beside the cameras, or else that of its label's sensor, px; and the
    quaternion of ``T_Device_Camera``, the camera in the glasses' frame, as four numbers, w first.

    ArgumentError: no list of cameras, a label twice, or sizes that are not one of each camera.
    """
    cameras: dict[str, Any] = {}
    for node in mappings(content, "CameraCalibrations"):
        entries = node.take("CameraCalibrations")
        sizes = node.take("ImageSizes", None)
        if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
            raise wrong("CameraCalibrations", "a list of cameras", entries)
        if sizes is not None and (not isinstance(sizes, list) or len(sizes) != len(entries)):
            raise ArgumentError(f"ImageSizes: expected one of each camera, got {shown(sizes)}")
        for i, entry in enumerate(entries):
            label = str(entry.get("Label"))
            if label in cameras:
                raise ArgumentError(f"Label: expected each label once, got {label} again")
            cameras[label] = dict(entry)
            if sizes is None:
                cameras[label]["ImageSize"] = entry.get("ImageSize", _ARIA_SIZES.get(label))
            else:
                cameras[label]["ImageSize"] = sizes[i]
            pose = entry.get("T_Device_Camera")
            if isinstance(pose, Mapping) and "UnitQuaternion" in pose:
                quaternion = _flat_quaternion(pose["UnitQuaternion"])
                cameras[label]["T_Device_Camera"] = {**pose, "UnitQuaternion": quaternion}
    return cameras


def _flat_quaternion(value: Any) -> list[Any]:
    """Return [w, x, y, z] of Aria's [w, [x, y, z]]."""
    if not isinstance(value, list) or len(value) != 2:
        raise ArgumentError(f"UnitQuaternion: expected [w, [x, y, z]], got {shown(value)}")
    return [value[0], *numbers("UnitQuaternion: [x, y, z]", value[1], (3,)).tolist()]


def join_aria(cameras: dict[str, Values]) -> Values:
    """Return the document; sizes are written where they are not those of the labels."""
    entries = []
    sizes = []
    are_of_labels = True
    for label, values in cameras.items():
        size = values.pop("ImageSize")
        sizes.append(size)
        if size != _ARIA_SIZES.get(label):
            are_of_labels = False
        pose = values.pop("T_Device_Camera", _AT_DEVICE)
        w, *xyz = pose["UnitQuaternion"]
        entry = {
            "Label": label,
            "SerialNumber": "",
            "Calibrated": True,
            "T_Device_Camera": {**pose, "UnitQuaternion": [w, xyz]},
            "TimeOffsetSec_Device_Camera": 0.0,
        }
        entries.append(entry | values)
    document: Values = {"CameraCalibrations": entries}
    if not are_of_labels:
        document["ImageSizes"] = sizes
    return document


_AT_DEVICE = {"Translation": [0.0, 0.0, 0.0], "UnitQuaternion": [1.0, 0.0, 0.0, 0.0]}
"""The pose of a camera without one."""


def nuscenes(content: Content) -> dict[str, Any]:
    """Return the sensors that have intrinsics; all pictures of nuScenes are of one size."""
    cameras: dict[str, Any] = {}
    for document in content.documents:
        for _, node in marked(document, ["camera_intrinsic", "translation", "rotation"]):
            if node.take("camera_intrinsic"):
                name = str(node.values.get("channel", node.values.get("token", f"cam{len(cameras)}")))
                cameras[name] = {"width": 1600, "height": 900, **node.values}
    return cameras


def metashape(content: Content) -> dict[str, Any]:
    """Return the calibrations of a lens file or of a project; the adjusted one of a sensor."""
    cameras: dict[str, Any] = {}
    if content.text.lstrip().startswith("<"):
        for document in content.documents:
            _add_calibrations(cameras, document, "cam0")
    return cameras


def _add_calibrations(cameras: dict[str, Any], value: Any, name: str) -> None:
    """Add the calibrations below an element of XML, by the label of the element that is nearest, or
    ``name``."""
    if isinstance(value, Mapping):
        name = str(value.get("label", name))
        lens = _calibration_of(value)
        if lens is not None:
            if name in cameras:
                name = f"{name}-{len(cameras)}"
            cameras[name] = Node(lens, (value,))  # the sensor may hold the size
        for item in value.values():
            _add_calibrations(cameras, item, name)
    elif isinstance(value, list):
        for item in value:
            _add_calibrations(cameras, item, name)


def _calibration_of(sensor: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the calibration of a sensor: the adjusted one, else the first; None if it has none."""
    listed = sensor.get("calibration")
    lenses = [lens for lens in (listed if isinstance(listed, list) else [listed]) if _is_metashape(lens)]
    for lens in lenses:
        if lens.get("class") == "adjusted":
            return lens
    return lenses[0] if lenses else None


def _is_metashape(lens: Any) -> TypeGuard[Mapping[str, Any]]:
    """Return whether a value is a mapping with keys of Metashape's lens."""
    return isinstance(lens, Mapping) and Node(lens).has(("f", "width", "resolution"))


def openmvg(content: Content) -> dict[str, Any]:
    """Return the intrinsics, whose name stands in the first of a kind, and whose values are nested."""
    cameras: dict[str, Any] = {}
    names: dict[int, str] = {}
    for document in content.documents:
        for path, node in marked(document, ["value.ptr_wrapper.data", "value.polymorphic_id"]):
            if "intrinsics" not in path:  # but views
                continue
            key = int(number("polymorphic_id", node.take("value.polymorphic_id"))) & 0x3FFFFFFF
            names.setdefault(key, str(node.take("value.polymorphic_name", None)))
            lens: Values = {"model": names[key]}
            data = node.take("value.ptr_wrapper.data")
            for place, value in leaves(data) if isinstance(data, Mapping) else ():
                lens[place.rpartition(".")[2]] = value
            cameras[str(node.take("key", len(cameras)))] = lens
    return cameras


_DSO = re.compile(
    r"\s*(?:(Pinhole|RadTan|EquiDistant|KannalaBrandt|FOV|ATAN):?\s+)?"
    r"((?:[-+.\deE]+ +){3,}[-+.\deE]+) *\n\s*(\d+)\s+(\d+)\s*\n"
    r"\s*(crop|full|none|(?:[-+.\deE]+ +){4}[-+.\deE]+) *\n\s*\d+\s+\d+\s*(?:\n[-+.\deE \n]*)?"
)


def dso(content: Content) -> dict[str, Any]:
    """Return the camera of four lines."""
    match = _DSO.fullmatch(content.text.replace("\t", " "))
    if match is None:
        return {}
    values = floats("numbers", match[2])
    width = int(match[3])
    height = int(match[4])
    if len(values) > 4 and values[2] < 1 and values[3] < 1:  # in parts of the size
        values[0] *= width
        values[1] *= height
        values[2] = values[2] * width - 0.5
        values[3] = values[3] * height - 0.5
    return {"cam0": {"model": match[1], "numbers": values, "size": [width, height]}}


def write_dso(values: Mapping[str, Any]) -> str:
    """Return the four lines of a camera; pictures are cropped where the lens bends them."""
    width, height = values["size"]
    model = values["model"]
    numbers_of_model = " ".join(f"{value:.17g}" for value in values["numbers"])
    crop = "none" if model == "Pinhole" else "crop"
    return f"{model} {numbers_of_model}\n{width} {height}\n{crop}\n{width} {height}\n"


_ZED_SIZES = {
    "2K": [2208, 1242], "FHD": [1920, 1080], "FHD1200": [1920, 1200], "HD": [1280, 720],
    "HD1200": [1920, 1200], "SVGA": [960, 600], "VGA": [672, 376], "4K": [3840, 2160],
    "QHDPLUS": [3200, 1800],
}  # fmt: skip


def zed(content: Content) -> dict[str, Any]:
    """Return the cameras of sections such as LEFT_CAM_HD, which have the same keys."""
    cameras: dict[str, Any] = {}
    others: dict[str, Mapping[str, Any]] = {}
    for node in mappings(content):
        for name, section in node.values.items():
            if not isinstance(section, Mapping):
                continue
            if re.fullmatch(r"(LEFT|RIGHT)_CAM_[A-Z0-9]+", name):
                cameras[name] = {**section, "size": _ZED_SIZES.get(name.rpartition("_")[2])}
            else:
                others[name] = section
    if cameras:
        _check_sections(cameras, others)
    return cameras


def _check_sections(cameras: Mapping[str, Values], others: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise ArgumentError for keys of a lens in other sections, or cameras whose keys differ."""
    for name, section in others.items():
        for key in section:
            if _ZED_LENS.fullmatch(key):
                raise ArgumentError(f"{name}.{key}: expected this key in sections of cameras, got it here")
    first = {key.lower() for key in next(iter(cameras.values()))}
    for name, lens in cameras.items():
        odd = sorted(first ^ {key.lower() for key in lens})
        if odd:
            raise ArgumentError(f"{name}: expected the keys of the other cameras, got more or fewer: {odd}")


_ZED_LENS = re.compile(r"f[xy]|c[xy]|[kp]\d", re.IGNORECASE)


def gyroflow(node: Node, lens: LensNumbers) -> LensNumbers:
    """Refuse stretches and digital lenses.

    Args:
        node: the camera's mapping.
        lens: its numbers, which are returned as they are.
    """
    for key in ("input_horizontal_stretch", "input_vertical_stretch"):
        stretch = number(key, node.take(key, 1) or 1)
        if stretch != 1:
            raise ArgumentError(f"{key}: expected 1 (stretches are not modelled), got {stretch:.15g}")
    digital_lens = node.take("digital_lens", None)
    if canonical(digital_lens) not in ("none", ""):
        raise ArgumentError(f"digital_lens: expected none (it is not modelled), got {shown(digital_lens)}")
    return lens


_DISTORTION = ("distortion_model", "distortion_type", "distortion.model", "distortion.type")


class OfOthers(Form):
    """A form whose keys are ours as well, but for our mark."""

    def entry(self, node: Node, size: tuple[int, int] | None) -> Entry:
        """Return a camera; beside the model of its distortion, ``model`` may be the name of a device.

        Args:
            node: its mapping.
            size: width and height of the image, px, where the file does not hold them.
        """
        known: set[str] = set()
        for model in self.layout.models:
            known.update(map(canonical, model.words))
        known -= {"pinhole", "perspective"}
        distortion = canonical(node.take(_DISTORTION, None))
        is_known = distortion in known and distortion != "none"
        if is_known and canonical(node.values.get("model")) not in known - {distortion}:
            values = dict(node.values)
            values.pop("model", None)
            node.values = values
        return super().entry(node, size)

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras, and say which pixel convention is taken.

        Args:
            content: the file.
            size: width and height of the images, px, where the file does not hold them.
        """
        from omniscv.cameras import names

        entries = super().read(content, size)
        for lens in self.nodes(content).values():
            if lens.has("cx") and lens.values.get("model", "pinhole") in names():
                _log.warning(
                    "no mark 'omniscv': 1 in the file: read as another program's, whose pixel centres are at "
                    "whole numbers; add the mark where they are at .5"
                )
                break
        return entries
