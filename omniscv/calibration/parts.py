"""Where the cameras of a file stand, for rows whose marks do not say it, and how they are put together."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from omniscv.arguments import number, shown
from omniscv.calibration.documents import Content, put_once
from omniscv.calibration.forms import Entry, Node, Values, canonical, floats, matrix_of_pose
from omniscv.calibration.intrinsics import Numbers
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_Sized = tuple[Numbers, tuple[int, int]]


def _mappings(content: Content, marks: str) -> list[Node]:
    """Return the documents that have all marks."""
    nodes = [Node(value) for value in content.documents if isinstance(value, Mapping)]
    return [node for node in nodes if all(node.has(mark) for mark in marks.split())]


def shutter(node: Node, word: str, values: Numbers, width: int, height: int) -> _Sized:
    """Check VINS's switch of the rolling shutter; a time that it switches off does not act."""
    on = number("rolling_shutter", node.take("rolling_shutter", 1) or 0)
    if not on and "rolling_shutter_tr" in node.values:
        node.values = {key: value for key, value in node.values.items() if key != "rolling_shutter_tr"}
    return values, (width, height)


def orb_cameras(content: Content) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    for node in _mappings(content, "Camera1.fx|Camera.fx"):
        if not any(key.startswith("Camera") and ".fx" in key for key in node.values):
            continue  # another program's "camera" with "fx" in it
        flat = dict(node.unread())
        second = {f"Camera1.{path[8:]}": value for path, value in flat.items() if path.startswith("Camera2.")}
        if not second:
            cameras[f"cam{len(cameras)}"] = flat
        else:
            first = {k: v for k, v in flat.items() if not k.startswith(("Camera2.", "Tlr"))}
            cameras[f"cam{len(cameras)}"] = first | {"Stereo.T_c1_c2": np.eye(4).tolist()}
            shared = ("Camera.type", "Camera.width", "Camera.height", "Stereo.T_c1_c2", "Tlr")
            cameras[f"cam{len(cameras)}"] = second | {key: flat[key] for key in shared if key in flat}
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
    return {name: entry._replace(pose=Pose(np.zeros(3), np.eye(3))), "cam1": right}


def join_orb(cameras: dict[str, Values]) -> Values:
    first, *others = cameras.values()
    if len(others) > 1:
        raise ArgumentError(f"cameras: ORB-SLAM holds two at most, got {len(cameras)}")
    document = {
        "File.version": "1.0",
        **{key: value for key, value in first.items() if key != "Stereo.T_c1_c2"},
    }
    for other in others:
        for key in ("Camera.type", "Camera.width", "Camera.height"):
            if other[key] != first[key]:
                raise ArgumentError(
                    f"{key}: expected the same of both cameras, got {first[key]} and {other[key]}"
                )
        document |= {key.replace("Camera1.", "Camera2."): value for key, value in other.items()}
    return document


def frames(content: Content) -> dict[str, Any]:
    """Return the camera of ``transforms.json``, or those of its frames where each has its own numbers."""
    cameras: list[Values] = []
    for node in _mappings(content, "frames"):
        shared = {key: value for key, value in node.values.items() if key != "frames"}
        frames = node.values["frames"] if isinstance(node.values["frames"], list) else []
        lenses = [Node(frame) for frame in frames if isinstance(frame, Mapping) and Node(frame).has(_FOCAL)]
        of_frames = [
            {**shared, **{k: v for k, v in lens.values.items() if not _OF_A_FRAME.search(k)}}
            for lens in lenses
        ]
        if of_frames and len(of_frames) < len(frames):
            raise ArgumentError("frames: expected a focal length in each or in none, got it in some")
        for lens in of_frames or ([shared] if node.has(_FOCAL) else []):
            if lens not in cameras:
                cameras.append(lens)
    for lens in cameras:
        if lens.get("is_fisheye") and "camera_model" not in lens:
            lens["camera_model"] = "OPENCV_FISHEYE"
    return {f"cam{i}": lens for i, lens in enumerate(cameras)}


_FOCAL = "fl_x|camera_angle_x"


_OF_A_FRAME = re.compile(r"path|matrix|mask|depth|time|index|id$|name|sharp|motion|camera_convention")


def angle(node: Node, word: str, values: Numbers, width: int, height: int) -> _Sized:
    """Turn a field of view from side to side into a focal length."""
    if "angle" in values:
        half = number("camera_angle_x", values.pop("angle"), above=0, below=np.pi) / 2
        values["f"] = float(width / 2 / np.tan(half))
    return values, (width, height)


def kitti(content: Content) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    for node in _mappings(content, "K_00|K_01|K_02|P_rect_00|P_rect_02|P0|P2"):
        values = node.values
        upright = np.eye(4)
        if "R_rect_00" in values:
            upright[:3, :3] = np.reshape(floats("R_rect_00", values["R_rect_00"]), (3, 3))
        for key in values:
            if match := re.fullmatch(r"K_(\d\d)", key):
                i = match[1]
                lens = {"K": values[key], "D": Node(values).take(f"D_{i}"), "S": values.get(f"S_{i}")}
                if f"R_{i}" in values:
                    rotation, shift = (floats(name, values[name]) for name in (f"R_{i}", f"T_{i}"))
                    lens["T"] = np.column_stack([np.reshape(rotation, (3, 3)), shift]).ravel().tolist()
                cameras[i] = lens
        for key in values:
            if match := re.fullmatch(r"P_rect_(\d\d)|P(\d)", key):
                P = (
                    np.reshape(floats(key, values[key]), (3, 4))
                    if len(floats(key, values[key])) == 12
                    else None
                )
                if P is None or not P[0, 0]:
                    raise ArgumentError(
                        f"{key}: expected 3 x 4 numbers of a camera, got {shown(values[key])}"
                    )
                offset = np.eye(4)
                offset[:3, 3] = np.linalg.solve(P[:, :3], P[:, 3])
                name = f"rect_{match[1]}" if match[1] else key
                lens = {"K": P[:, :3].ravel().tolist(), "D": [], "T": (offset @ upright)[:3].ravel().tolist()}
                cameras[name] = lens | {"S": values.get(f"S_rect_{match[1]}")}
    return cameras


def join_kitti(cameras: dict[str, Values]) -> Values:
    document: Values = {}
    for name, lens in cameras.items():
        if not re.fullmatch(r"\d\d", name):
            raise ArgumentError(f"{name}: expected names 00, 01, ..., got {shown(name)}")
        document |= {
            f"S_{name}": lens["S"],
            f"K_{name}": lens["K"],
            f"D_{name}": [*lens["D"], *[0.0] * 5][:5],
        }
        T = np.array(lens.get("T", np.eye(4).tolist()))
        document |= {f"R_{name}": T[:3, :3].ravel().tolist(), f"T_{name}": T[:3, 3].tolist()}
    return document


def middlebury(content: Content) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    for node in _mappings(content, "cam0 width height"):
        if (
            not isinstance(node.values["cam0"], str)
            or len(re.findall(r"[-\d.e+]+", node.values["cam0"])) != 9
        ):
            continue
        size = {key: node.values[key] for key in ("width", "height")}
        baseline = number("baseline", node.values.get("baseline", 0)) / 1000
        for name, x in (("cam0", 0.0), ("cam1", baseline)):
            if name in node.values:
                T = matrix_of_pose(Pose(np.array([x, 0, 0]), np.eye(3)))
                cameras[name] = {"K": node.values[name], **size, "T": T}
    return cameras


def join_middlebury(cameras: dict[str, Values]) -> Values:
    first, *others = cameras.values()
    document = {"cam0": first["K"]}
    baseline = 0.0
    for other in others:
        T = np.array(other.get("T", np.eye(4).tolist()))
        if (
            len(others) > 1
            or T[1:3, 3].any()
            or (T[:3, :3] != np.eye(3)).any()
            or other["width"] != first["width"]
        ):
            raise ArgumentError(
                "middlebury: expected two cameras, the second straight to the right, got others"
            )
        document["cam1"], baseline = other["K"], 1000 * T[0, 3]
        document["doffs"] = other["K"][2] - first["K"][2]
    return document | {"baseline": float(baseline), "width": first["width"], "height": first["height"]}


def basalt(content: Content) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    for node in _mappings(content, "value0.intrinsics"):
        rig = node.values["value0"]
        lists = [rig.get(key) for key in ("intrinsics", "resolution", "T_imu_cam")]
        if not all(isinstance(items, list) and len(items) == len(lists[0] or []) for items in lists):
            raise ArgumentError(
                "value0: expected intrinsics, resolution and T_imu_cam of every camera, got other lists"
            )
        offset = rig.get("cam_time_offset_ns", 0)
        for lens, size, pose in zip(*lists, strict=True):
            numbers = lens if isinstance(lens, Mapping) else {}
            cameras[f"cam{len(cameras)}"] = {
                **numbers,
                "resolution": size,
                "T_imu_cam": pose,
                "cam_time_offset_ns": offset,
            }
    return cameras


def join_basalt(cameras: dict[str, Values]) -> Values:
    offsets = {values.pop("cam_time_offset_ns", 0.0) for values in cameras.values()}
    if len(offsets) > 1:
        raise ArgumentError(f"time_offset: expected one of all cameras, got {sorted(offsets)}")
    rows = [{**values} for values in cameras.values()]
    still = {"px": 0.0, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
    return {
        "value0": {
            "T_imu_cam": [row.pop("T_imu_cam", still) for row in rows],
            "resolution": [row.pop("resolution") for row in rows],
            "intrinsics": rows,
            "cam_time_offset_ns": offsets.pop(),
        }
    }


_ARIA_SIZES = {
    "camera-slam-left": (640, 480),
    "camera-slam-right": (640, 480),
    "camera-rgb": (2880, 2880),
    "camera-et-left": (640, 480),
    "camera-et-right": (640, 480),
}


"""Full resolution by label: a factory calibration, which has no sizes, is of these images."""


def aria(content: Content) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    for document in content.documents:
        if not isinstance(document, Mapping) or "CameraCalibrations" not in document:
            continue
        entries, sizes = document["CameraCalibrations"], document.get("ImageSizes")
        if (
            not isinstance(entries, list)
            or not entries
            or not all(isinstance(entry, Mapping) for entry in entries)
        ):
            raise ArgumentError(f"CameraCalibrations: expected a list of cameras, got {shown(entries)}")
        if sizes is not None and (not isinstance(sizes, list) or len(sizes) != len(entries)):
            raise ArgumentError(f"ImageSizes: expected one of each camera, got {shown(sizes)}")
        for i, entry in enumerate(entries):
            label = str(entry.get("Label"))
            if label in cameras:
                raise ArgumentError(f"Label: expected each label once, got {label} again")
            size = sizes[i] if sizes is not None else entry.get("ImageSize", _ARIA_SIZES.get(label))
            cameras[label] = {**entry, "ImageSize": None if size is None else list(size)}
    return cameras


def join_aria(cameras: dict[str, Values]) -> Values:
    """Return the document; sizes are written where they are not those of the labels."""
    entries = []
    sizes = [values.pop("ImageSize") for values in cameras.values()]
    still = {"Translation": [0.0, 0.0, 0.0], "UnitQuaternion": [1.0, [0.0, 0.0, 0.0]]}
    for label, values in cameras.items():
        projection = {"Projection": values["Projection"]}
        pose = {"T_Device_Camera": values.get("T_Device_Camera", still)}
        time = {"TimeOffsetSec_Device_Camera": values.get("TimeOffsetSec_Device_Camera", 0.0)}
        entries.append({"Label": label, "SerialNumber": "", "Calibrated": True, **projection, **pose, **time})
    known = all(tuple(size) == _ARIA_SIZES.get(label) for label, size in zip(cameras, sizes, strict=True))
    return {"CameraCalibrations": entries} | ({} if known else {"ImageSizes": sizes})


def nuscenes(content: Content) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    for document in content.documents:
        for entry in document if isinstance(document, list) else []:
            if isinstance(entry, Mapping) and entry.get("camera_intrinsic") and "translation" in entry:
                name = str(entry.get("channel", entry.get("token", f"cam{len(cameras)}")))
                cameras[name] = {"width": 1600, "height": 900, **entry}
    return cameras


STILL = {"translation": [0.0, 0.0, 0.0], "rotation": [1.0, 0.0, 0.0, 0.0]}


def metashape(content: Content) -> dict[str, Any]:
    """Return the calibrations of a lens file or of a project; the adjusted one of a sensor."""
    cameras: dict[str, Any] = {}

    def visit(value: Any, name: str) -> None:
        if isinstance(value, list):
            for item in value:
                visit(item, name)
        if not isinstance(value, Mapping):
            return
        name = str(value.get("label", name))
        listed = value.get("calibration")
        lenses = [
            lens for lens in (listed if isinstance(listed, list) else [listed]) if isinstance(lens, Mapping)
        ]
        if lenses:
            adjusted = [lens for lens in lenses if lens.get("class") == "adjusted"]
            unique = name if name not in cameras else f"{name}-{len(cameras)}"
            cameras[unique] = (adjusted or lenses)[0]
        for key, below in value.items():
            if key != "calibration":
                visit(below, name)

    for document in content.documents if content.text.lstrip().startswith("<") else []:
        visit(document, "cam0")
    return {name: lens for name, lens in cameras.items() if Node(lens).has("f|width|resolution")}


def only(form: str, cameras: Mapping[str, Values]) -> Values:
    """Return the only camera; ArgumentError where there are several."""
    if len(cameras) != 1:
        raise ArgumentError(f"cameras: {form} holds one camera, got {len(cameras)}: {shown(list(cameras))}")
    return next(iter(cameras.values()))


def openmvg(content: Content) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    names: dict[int, str] = {}
    for node in _mappings(content, "intrinsics"):
        listed = node.values["intrinsics"]
        for entry in listed if isinstance(listed, list) else []:
            value = entry.get("value") if isinstance(entry, Mapping) else None
            if not isinstance(value, Mapping) or not isinstance(value.get("ptr_wrapper"), Mapping):
                continue
            key = int(number("polymorphic_id", value.get("polymorphic_id", 0))) & 0x3FFFFFFF
            names.setdefault(key, str(value.get("polymorphic_name")))
            data = value["ptr_wrapper"].get("data", {})
            lens = {name: item for name, item in data.items() if not isinstance(item, Mapping)}
            for below in data.values():
                lens |= below if isinstance(below, Mapping) else {}
            cameras[str(entry.get("key", len(cameras)))] = {"model": names[key], **lens}
    return cameras


def join_openmvg(cameras: dict[str, Values]) -> Values:
    entries = []
    for i, values in enumerate(cameras.values()):
        data = {key: value for key, value in values.items() if key != "model"}
        wrapped = {"id": 0x80000001 + i, "data": data}
        identity = {"polymorphic_id": 0x40000000 + i + 1, "polymorphic_name": values["model"]}
        entries.append({"key": i, "value": {**identity, "ptr_wrapper": wrapped}})
    return {"sfm_data_version": "0.3", "root_path": "", "views": [], "intrinsics": entries, "extrinsics": []}


_DSO = re.compile(
    r"\s*(?:(Pinhole|RadTan|EquiDistant|KannalaBrandt|FOV|ATAN):?\s+)?"
    r"((?:[-+.\deE]+ *){4,8})\n\s*(\d+)\s+(\d+)\s*\n"
    r"\s*(crop|full|none|(?:[-+.\deE]+ *){5}) *\n\s*\d+\s+\d+\s*"
)


def dso(content: Content) -> dict[str, Any]:
    match = _DSO.fullmatch(content.text.replace("\t", " "))
    if match is None:
        return {}
    values = floats("numbers", match[2])
    size = int(match[3]), int(match[4])
    if len(values) > 4 and values[2] < 1 and values[3] < 1:  # in parts of the size
        scale = [*size, *size]
        values[:4] = [value * factor for value, factor in zip(values[:4], scale, strict=True)]
        values[2:4] = [value - 0.5 for value in values[2:4]]
    return {"cam0": {"model": match[1], "numbers": values, "size": list(size)}}


def dso_text(values: Values) -> str:
    numbers, size = values["numbers"], " ".join(map(str, values["size"]))
    words = " ".join(map(str, [*numbers, 0.0][: max(5, len(numbers))]))
    return f"{values['model']} {words}\n{size}\nnone\n{size}\n"


_ZED_SIZES = {
    "2K": (2208, 1242),
    "FHD": (1920, 1080),
    "FHD1200": (1920, 1200),
    "HD": (1280, 720),
    "HD1200": (1920, 1200),
    "SVGA": (960, 600),
    "VGA": (672, 376),
    "4K": (3840, 2160),
    "QHDPLUS": (3200, 1800),
}


def zed(content: Content) -> dict[str, Any]:
    cameras = {}
    for node in _mappings(content, "STEREO|LEFT_CAM_HD|LEFT_CAM_VGA|LEFT_CAM_FHD"):
        for name, section in node.values.items():
            match = re.fullmatch(r"(?:LEFT|RIGHT)_CAM_(\w+)", name)
            if match and isinstance(section, Mapping):
                size = _ZED_SIZES.get(match[1])
                cameras[name] = {**section, "size": None if size is None else list(size)}
    return cameras


def join_zed(cameras: dict[str, Values]) -> Values:
    sections = {}
    for i, (name, values) in enumerate(cameras.items()):
        size = tuple(values.pop("size"))
        word = next((word for word, known in _ZED_SIZES.items() if known == size), None)
        if word is None or i > 1:
            sizes = ", ".join(f"{w}x{h}" for w, h in _ZED_SIZES.values())
            raise ArgumentError(f"{name}: expected two cameras at most, of a size among {sizes}; got {size}")
        sections[name if name.endswith(f"_CAM_{word}") else f"{('LEFT', 'RIGHT')[i]}_CAM_{word}"] = values
    return sections


_HUGIN_IMAGE = re.compile(r"([A-Za-z]+)(\S*)")


def hugin(content: Content) -> dict[str, Any]:
    """Return the images of a project; ``v=0`` is the value of image 0."""
    images: list[dict[str, str]] = []
    if not re.search(r"^p .*\bf\d", content.text, re.MULTILINE):
        return {}
    for line in content.text.split("\n"):
        if line.startswith(("i ", "o ")):
            words: dict[str, str] = {}
            for key, value in _HUGIN_IMAGE.findall(line.partition(' n"')[0][2:]):
                put_once(words, key, value)
            if len(words.keys() & set("abcdegt")) not in (0, 7):
                raise ArgumentError(f"expected all of a, b, c, d, e, g, t or none, got {shown(line)}")
            for key, value in words.items():
                if value.startswith("="):
                    words[key] = (
                        images[int(value[1:])].get(key, "0") if int(value[1:]) < len(images) else "nan"
                    )
            images.append(words)
    cameras: dict[str, Any] = {}
    for image in images:
        lens: Values = {key: number(key, image.get(key, 0)) for key in "whvabcdegt"}
        lens["f"] = image.get("f", "0")
        if lens not in cameras.values():
            cameras[f"cam{len(cameras)}"] = lens
    return cameras


def hugin_numbers(node: Node, word: str, values: Numbers, width: int, height: int) -> _Sized:
    """Panotools: ``r (a r^3 + b r^2 + c r + 1 - a - b - c)``, r = 1 at half the shorter side."""
    terms = {key: number(key, node.take(key, 0)) for key in "abcgtv"}
    a, b, c, g, t, v = terms.values()
    if g or t:
        raise ArgumentError(f"g, t: expected no shear (it is not modelled), got {g:.15g} and {t:.15g}")
    unit, angle = min(width, height) / 2, np.radians(number("v", v, above=0, most=360))
    first = 1 - a - b - c
    if word == "0":
        if a or c:
            raise ArgumentError(
                f"a, c: expected 0 (odd powers of f0 are not modelled), got {a:.15g} and {c:.15g}"
            )
        focal = width / 2 / np.tan(number("v", v, below=180) * np.pi / 360)
        return values | {"fx": focal * first, "fy": focal * first, "k1": b / first * (focal / unit) ** 2}, (
            width,
            height,
        )
    if word == "4":
        if a or b or c or abs(v - 360) > 1e-9 or width != 2 * height or values["du"] or values["dv"]:
            raise ArgumentError(
                "f4: expected a full panorama of 360 degrees, 2:1, without a, b, c, d, e, got another"
            )
        return {}, (width, height)
    scale = width / angle / unit  # of an angle to r
    powers = [unit * factor * scale ** (i + 1) for i, factor in enumerate((first, c, b, a))]
    return values | {f"c{i + 1}": float(power) for i, power in enumerate(powers)}, (width, height)


def gyroflow(node: Node, word: str, values: Numbers, width: int, height: int) -> _Sized:
    for key in ("input_horizontal_stretch", "input_vertical_stretch"):
        if (value := number(key, node.take(key, 1) or 1)) != 1:
            raise ArgumentError(f"{key}: expected 1 (stretches are not modelled), got {value:.15g}")
    if canonical(lens := node.take("digital_lens", None)) not in ("none", ""):
        raise ArgumentError(f"digital_lens: expected none (it is not modelled), got {shown(lens)}")
    return values, (width, height)
