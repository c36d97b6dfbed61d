"""Where the cameras of a file stand, for rows whose marks do not say it, and how they are put together."""

import logging
import re
from collections.abc import Mapping
from typing import Any, TypeGuard

import numpy as np

from omniscv.arguments import number, numbers, shown, wrong
from omniscv.calibration.documents import Content
from omniscv.calibration.forms import Entry, Form, matrix_3x4, matrix_of_pose
from omniscv.calibration.nodes import Node, Values, canonical, families, floats, leaves, mappings, marked
from omniscv.cameras.lens_parameters import Numbers
from omniscv.cameras.rig import ORIGIN
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_log = logging.getLogger("omniscv")
Sized = tuple[Numbers, tuple[int, int]]


def shutter(node: Node, word: str, values: Numbers, width: int, height: int) -> Sized:
    """Check VINS's switch of the rolling shutter; a time that it switches off does not act."""
    on = number("rolling_shutter", node.take("rolling_shutter", 1) or 0)
    if not on and "rolling_shutter_tr" in node.values:
        node.values = {key: value for key, value in node.values.items() if key != "rolling_shutter_tr"}
    return values, (width, height)


def orb_cameras(content: Content) -> dict[str, Any]:
    """Return the cameras of ``Camera.fx``, or of ``Camera1.fx`` and ``Camera2.fx``."""
    cameras: dict[str, Any] = {}
    for node in mappings(content, "Camera1.fx|Camera.fx"):
        if not any(key.startswith("Camera") and ".fx" in key for key in node.values):
            continue  # another program's "camera" with "fx" in it
        first = dict(leaves(node.values))
        second = {key: first.pop(key) for key in [*first] if key.startswith("Camera2.")}
        cameras[f"cam{len(cameras)}"] = first
        if second:
            shared = {key: first.pop(key) for key in [*first] if key in ("Stereo.T_c1_c2", "Tlr")}
            shared |= {key: value for key, value in first.items() if key.startswith("Camera.")}
            first["Stereo.T_c1_c2"] = np.eye(4).tolist()
            second = {key.replace("Camera2.", "Camera1."): value for key, value in second.items()}
            cameras[f"cam{len(cameras)}"] = second | shared
    return cameras


def by_baseline(node: Node, entries: dict[str, Entry]) -> dict[str, Entry]:
    """Return a rectified stereo rig: the same camera twice, the second one a baseline to the right."""
    if len(entries) != 1 or node.has("RGBD.DepthMapFactor|DepthMapFactor|depthmap_factor"):
        return entries
    ((name, entry),) = entries.items()
    fx = getattr(entry.camera, "fx", None)
    if node.has("Stereo.b"):
        baseline = number("Stereo.b", node.take("Stereo.b"))
    elif node.has("Camera.bf|Camera.focal_x_baseline") and fx:
        baseline = number("Camera.bf", node.take("Camera.bf|Camera.focal_x_baseline")) / fx
    else:
        return entries
    right = entry._replace(pose=Pose(np.array([baseline, 0, 0]), np.eye(3)))
    return {name: entry._replace(pose=ORIGIN), "cam1": right}


def join_orb(cameras: dict[str, Values]) -> Values:
    """Return the keys of one camera or two, which share type and size."""
    first, *others = cameras.values()
    document = {"File.version": "1.0", **first}
    document.pop("Stereo.T_c1_c2", None)
    for other in others:
        if len(others) > 1 or any(other[key] != first[key] for key in first if key.startswith("Camera.")):
            wanted = "expected two at most, of one model and size (ORB-SLAM writes these once)"
            raise ArgumentError(f"cameras: {wanted}, got {len(cameras)}: {shown([*cameras.values()])}")
        document |= {key.replace("Camera1.", "Camera2."): value for key, value in other.items()}
    return document


_FOCAL = "fl_x|camera_angle_x"
_OF_A_FRAME = re.compile(r"path|matrix|mask|depth|time|index|id$|name|sharp|motion|camera_convention")


def frames(content: Content) -> dict[str, Any]:
    """Return the camera of ``transforms.json``, or those of its frames where each has its own numbers."""
    cameras: list[Values] = []
    for node in mappings(content, "frames"):
        shared = node.values
        listed = node.take("frames")
        frames = listed if isinstance(listed, list) else []
        with_own = [frame for frame in frames if isinstance(frame, Mapping) and Node(frame).has(_FOCAL)]
        of_frames = [lens_of_frame(shared, frame) for frame in with_own]
        if of_frames and len(of_frames) < len(frames):
            raise ArgumentError("frames: expected a focal length in each or in none, got it in some")
        for lens in of_frames or ([lens_of_frame(shared, {})] if node.has(_FOCAL) else []):
            if lens not in cameras:
                cameras.append(lens)
    return {f"cam{i}": lens for i, lens in enumerate(cameras)}


def lens_of_frame(shared: Mapping[str, Any], frame: Mapping[str, Any]) -> Values:
    """Return the values of a frame's lens in ``transforms.json``: its own, else those of the file."""
    own = {key: value for key, value in frame.items() if not _OF_A_FRAME.search(key)}
    lens = {key: value for key, value in shared.items() if key != "frames"} | own
    if lens.get("is_fisheye") and "camera_model" not in lens:
        lens["camera_model"] = "OPENCV_FISHEYE"
    return lens


def angle(node: Node, word: str, values: Numbers, width: int, height: int) -> Sized:
    """Turn a field of view from side to side into a focal length."""
    for name, key, size in (("angle", "camera_angle_x", width), ("angle_y", "camera_angle_y", height)):
        if name in values:
            half = number(key, values.pop(name), above=0, below=np.pi) / 2
            values["fy" if name == "angle_y" else "fx"] = float(size / 2 / np.tan(half))
    return {"fy": values["fx"], **values} if "fx" in values else values, (width, height)


def kitti(content: Content) -> dict[str, Any]:
    """Return the cameras of K, D, S, R, T; and of P, the rectified ones, by ``P = K [I | offset]``."""
    cameras: dict[str, Any] = {}
    for node in mappings(content, "K_00|K_01|K_02|P_rect_00|P_rect_02|P0|P2"):
        if node.has("K1|M1"):
            continue  # a pair of OpenCV's
        parts, _ = families(node.values, r"(?P<key>[kdsrtp])(?P<name>(?:rect)?\d\d?)(?P<after>)")
        upright = np.eye(4)
        if "r" in parts.get("rect00", {}):
            upright[:3] = matrix_3x4("R_rect_00", parts["rect00"]["r"], [0.0] * 3)
        for name, lens in parts.items():
            size = lens.get("s")
            if "k" in lens:
                cameras[name] = {"K": lens["k"], "D": Node(lens).take("D"), "S": size}
                if "r" in lens:
                    cameras[name]["T"] = matrix_3x4(f"R_{name}", lens["r"], Node(lens).take("T")).tolist()
            elif "p" in lens:
                P = np.array(floats(f"P_{name}", lens["p"]))
                if P.size != 12 or not P[0]:
                    raise wrong(f"P_{name}", "3 x 4 numbers of a camera", lens["p"])
                P = P.reshape(3, 4)
                offset = np.eye(4)
                offset[:3, 3] = np.linalg.solve(P[:, :3], P[:, 3])
                label = name.replace("rect", "rect_") if "rect" in name else f"P{name}"
                T_c_0 = (offset @ upright)[:3].ravel().tolist()
                cameras[label] = {"K": P[:, :3].ravel().tolist(), "D": [], "S": size, "T": T_c_0}
    return cameras


def join_kitti(cameras: dict[str, Values]) -> Values:
    """Return the lines of cameras 00, 01, ..."""
    document: Values = {}
    for name, lens in cameras.items():
        if not re.fullmatch(r"\d\d", name):
            raise ArgumentError(f"{name}: expected names 00, 01, ..., got {shown(name)}")
        T = np.array(lens.get("T", np.eye(4).tolist()))
        D = [*lens["D"], *[0.0] * 5][:5]
        document |= {f"S_{name}": lens["S"], f"K_{name}": lens["K"], f"D_{name}": D}
        document |= {f"R_{name}": T[:3, :3].ravel().tolist(), f"T_{name}": T[:3, 3].tolist()}
    return document


def middlebury(content: Content) -> dict[str, Any]:
    """Return cam0 and cam1, which is straight to the right by the baseline, mm."""
    cameras: dict[str, Any] = {}
    for node in mappings(content, "cam0 width height"):
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
        lists = [rig.get(key) for key in ("intrinsics", "resolution", "T_imu_cam")]
        if not all(isinstance(items, list) and len(items) == len(lists[0] or []) for items in lists):
            wanted = "expected intrinsics, resolution and T_imu_cam of every camera"
            raise ArgumentError(f"value0: {wanted}, got other lists")
        shared = {"cam_time_offset_ns": rig.get("cam_time_offset_ns", 0)}
        for lens, size, pose in zip(*lists, strict=True):
            own = {"resolution": size, "T_imu_cam": pose, **shared}
            cameras[f"cam{len(cameras)}"] = {**(lens if isinstance(lens, Mapping) else {}), **own}
    return cameras


_ARIA_SIZES = {
    "camera-slam-left": [640, 480], "camera-slam-right": [640, 480], "camera-rgb": [2880, 2880],
    "camera-et-left": [640, 480], "camera-et-right": [640, 480],
}  # fmt: skip
"""Full resolution by label: a factory calibration, which has no sizes, is of these images."""


def aria(content: Content) -> dict[str, Any]:
    """Return the cameras by their labels; their quaternions as four numbers."""
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
            size = sizes[i] if sizes is not None else entry.get("ImageSize", _ARIA_SIZES.get(label))
            cameras[label] = lens = {**entry, "ImageSize": size}
            pose = lens.get("T_Device_Camera")
            if isinstance(pose, Mapping) and "UnitQuaternion" in pose:
                turn = pose["UnitQuaternion"]
                if not isinstance(turn, list) or len(turn) != 2:
                    raise ArgumentError(f"UnitQuaternion: expected [w, [x, y, z]], got {shown(turn)}")
                xyz = numbers("UnitQuaternion: [x, y, z]", turn[1], (3,)).tolist()
                lens["T_Device_Camera"] = {**pose, "UnitQuaternion": [turn[0], *xyz]}
    return cameras


def join_aria(cameras: dict[str, Values]) -> Values:
    """Return the document; sizes are written where they are not those of the labels."""
    entries = []
    sizes = [values.pop("ImageSize") for values in cameras.values()]
    still = {"Translation": [0.0, 0.0, 0.0], "UnitQuaternion": [1.0, 0.0, 0.0, 0.0]}
    for label, values in cameras.items():
        pose = {**values.pop("T_Device_Camera", still)}
        w, *xyz = pose["UnitQuaternion"]
        own = {"T_Device_Camera": pose | {"UnitQuaternion": [w, xyz]}, "TimeOffsetSec_Device_Camera": 0.0}
        entries.append({"Label": label, "SerialNumber": "", "Calibrated": True, **own, **values})
    known = all(size == _ARIA_SIZES.get(label) for label, size in zip(cameras, sizes, strict=True))
    return {"CameraCalibrations": entries} | ({} if known else {"ImageSizes": sizes})


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

    def visit(value: Any, name: str) -> None:
        if isinstance(value, Mapping):
            name = str(value.get("label", name))
            listed = value.get("calibration")
            lenses = [*filter(_is_metashape, listed if isinstance(listed, list) else [listed])]
            if lenses:
                adjusted = [lens for lens in lenses if lens.get("class") == "adjusted"]
                name = name if name not in cameras else f"{name}-{len(cameras)}"
                cameras[name] = Node((adjusted or lenses)[0], (value,))  # the sensor may hold the size
        if isinstance(value, Mapping | list):
            for item in value.values() if isinstance(value, Mapping) else value:
                visit(item, name)

    for document in content.documents if content.text.lstrip().startswith("<") else []:
        visit(document, "cam0")
    return cameras


def _is_metashape(lens: Any) -> TypeGuard[Mapping[str, Any]]:
    return isinstance(lens, Mapping) and Node(lens).has("f|width|resolution")


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
            data = node.take("value.ptr_wrapper.data")
            lens = dict(leaves(data)) if isinstance(data, Mapping) else {}
            own = {path.rpartition(".")[2]: value for path, value in lens.items()}
            cameras[str(node.take("key", len(cameras)))] = {"model": names[key], **own}
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
    size = [int(match[3]), int(match[4])]
    if len(values) > 4 and values[2] < 1 and values[3] < 1:  # in parts of the size
        values[:4] = [value * side for value, side in zip(values[:4], size * 2, strict=True)]
        values[2:4] = [value - 0.5 for value in values[2:4]]
    return {"cam0": {"model": match[1], "numbers": values, "size": size}}


def write_dso(values: Mapping[str, Any]) -> str:
    """Return the four lines of a camera; pictures are cropped where the lens bends them."""
    size = " ".join(map(str, values["size"]))
    model = values["model"]
    numbers = " ".join(f"{value:.17g}" for value in values["numbers"])
    return f"{model} {numbers}\n{size}\n{'none' if model == 'Pinhole' else 'crop'}\n{size}\n"


_ZED_SIZES = {
    "2K": [2208, 1242], "FHD": [1920, 1080], "FHD1200": [1920, 1200], "HD": [1280, 720],
    "HD1200": [1920, 1200], "SVGA": [960, 600], "VGA": [672, 376], "4K": [3840, 2160],
    "QHDPLUS": [3200, 1800],
}  # fmt: skip


def zed(content: Content) -> dict[str, Any]:
    """Return the cameras of sections such as LEFT_CAM_HD, which have the same keys."""
    sections: Values = {}
    for node in mappings(content, ""):
        sections |= {name: section for name, section in node.values.items() if isinstance(section, Mapping)}
    cameras = {
        name: {**section, "size": _ZED_SIZES.get(name.rpartition("_")[2])}
        for name, section in sections.items()
        if re.fullmatch(r"(LEFT|RIGHT)_CAM_[A-Z0-9]+", name)
    }
    for name, section in sections.items() if cameras else ():
        if name not in cameras and (odd := [key for key in section if _ZED_LENS.fullmatch(key)]):
            raise ArgumentError(f"{name}.{odd[0]}: expected this key in sections of cameras, got it here")
    keys = [{key.lower() for key in lens} for lens in cameras.values()]
    for name, own in zip(cameras, keys, strict=True):
        if odd := sorted(own ^ keys[0]):
            raise ArgumentError(f"{name}: expected the keys of the other cameras, got more or fewer: {odd}")
    return cameras


_ZED_LENS = re.compile(r"f[xy]|c[xy]|[kp]\d", re.IGNORECASE)


def gyroflow(node: Node, word: str, values: Numbers, width: int, height: int) -> Sized:
    """Refuse stretches and digital lenses."""
    for key in ("input_horizontal_stretch", "input_vertical_stretch"):
        if (value := number(key, node.take(key, 1) or 1)) != 1:
            raise ArgumentError(f"{key}: expected 1 (stretches are not modelled), got {value:.15g}")
    if canonical(lens := node.take("digital_lens", None)) not in ("none", ""):
        raise ArgumentError(f"digital_lens: expected none (it is not modelled), got {shown(lens)}")
    return values, (width, height)


_DISTORTION = "distortion_model|distortion_type|distortion.model|distortion.type"


class OfOthers(Form):
    """A form whose keys are ours as well, but for our mark."""

    def entry(self, node: Node, size: tuple[int, int] | None) -> Entry:
        """Return a camera; beside the model of its distortion, ``model`` may be the name of a device."""
        distortion = canonical(node.take(_DISTORTION, None))
        known = {canonical(word) for row in self.rows for word in row.words} - {"pinhole", "perspective"}
        if distortion in known - {"none"} and canonical(node.values.get("model")) not in known - {distortion}:
            node.values = {key: value for key, value in node.values.items() if key != "model"}
        return super().entry(node, size)

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras, and say which pixel convention is taken."""
        from omniscv.cameras import names

        entries = super().read(content, size)
        lenses = self.nodes(content).values()
        if any(lens.has("cx") and lens.values.get("model", "pinhole") in names() for lens in lenses):
            _log.warning(
                "no mark 'omniscv': 1 in the file: read as another program's, whose pixel centres are at "
                "whole numbers; add the mark where they are at .5"
            )
        return entries
