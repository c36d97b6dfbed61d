"""COLMAP's ``cameras.txt`` and ``cameras.bin``, ``rigs.txt``, and the lines of ``frames.txt``.

Half pixel: none to shift. COLMAP's top-left pixel has its centre at (0.5, 0.5), as ours. Special cases are
written as the general model, which more programs know: ``fisheye-equidistant`` as a fisheye without
coefficients, ``fisheye-stereographic`` and an undistorted ``unified`` as ``EUCM``, without the circle in
which they end. COLMAP reaches only rays less than 90 degrees off the axis in every model but
``EQUIRECTANGULAR``.

Source: COLMAP 4.2, ``src/colmap/sensor/models.h``, ``scene/reconstruction_io_text.cc`` and ``_binary.cc``.
"""

import re
import struct
from collections.abc import Mapping

import numpy as np

from omniscv.arguments import numbers, shown, within, wrong
from omniscv.calibration.documents import Content
from omniscv.calibration.forms import Form, Layout, PoseMatrix, Reading, Writing
from omniscv.calibration.intrinsics import check_first_is_origin
from omniscv.calibration.keys import FISHEYE4, MATRIX, RADTAN4, RADTAN8, Model, ModelName, Number, array
from omniscv.calibration.nodes import Values, whole
from omniscv.cameras import Camera, Equirectangular
from omniscv.cameras.rig import ORIGIN, Rig, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose


def _model(word: str, name: ModelName, *numbers: Number, read_only: bool = False) -> Model:
    """Return a model by COLMAP's word, our name, and the numbers of its parameters."""
    return Model(name, (array("PARAMS", *numbers),), (word,), read_only)


_FISHEYE624: tuple[Number, ...] = ("k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1", "s0", "s1", "s2", "s3")
_BEFORE_THIN_PRISM = (
    _model("SIMPLE_PINHOLE", "pinhole", "f", "cx", "cy", read_only=True),
    _model("PINHOLE", "pinhole", *MATRIX),
    _model("SIMPLE_RADIAL", "pinhole", "f", "cx", "cy", "k1", read_only=True),
    _model("RADIAL", "pinhole", "f", "cx", "cy", "k1", "k2", read_only=True),
    _model("OPENCV", "pinhole", *MATRIX, *RADTAN4),
    _model("OPENCV_FISHEYE", "kannala-brandt", *MATRIX, *FISHEYE4),
    _model("FULL_OPENCV", "pinhole", *MATRIX, *RADTAN8),
    _model("FOV", "field-of-view", *MATRIX, "omega"),
    _model("SIMPLE_RADIAL_FISHEYE", "kannala-brandt", "f", "cx", "cy", "k1", read_only=True),
    _model("RADIAL_FISHEYE", "kannala-brandt", "f", "cx", "cy", "k1", "k2", read_only=True),
)
_AFTER_THIN_PRISM = (
    _model("RAD_TAN_THIN_PRISM_FISHEYE", "fisheye624", *MATRIX, *_FISHEYE624),
    _model("SIMPLE_DIVISION", "division", "f", "cx", "cy", "k"),
    _model("DIVISION", "division", *MATRIX, "k", read_only=True),
    _model("SIMPLE_FISHEYE", "kannala-brandt", "f", "cx", "cy", read_only=True),
    _model("FISHEYE", "kannala-brandt", *MATRIX, read_only=True),
    _model("EUCM", "extended-unified", *MATRIX, "alpha", "beta"),
    _model("EQUIRECTANGULAR", "equirectangular", "W", "H"),
)
_MODELS = _BEFORE_THIN_PRISM + _AFTER_THIN_PRISM
"""In the order of COLMAP's ids, which its binary files hold; THIN_PRISM_FISHEYE is no model of ours.

Special cases of others are only read: many programs that read COLMAP's files do not know them.
"""


def _words_and_counts(models: tuple[Model, ...]) -> list[tuple[str, int]]:
    """Return COLMAP's word of each model and the number of its parameters."""
    return [(str(model.words[0]), len(model.keys[0].numbers)) for model in models]


_IDS = [
    *_words_and_counts(_BEFORE_THIN_PRISM),
    ("THIN_PRISM_FISHEYE", 12),
    *_words_and_counts(_AFTER_THIN_PRISM),
]
"""Name and number of parameters of every model, by COLMAP's id."""
NAMES = tuple(name for name, _ in _IDS)


def _lenses(content: Content) -> dict[str, Values]:
    """Return the lines of a file, or of its binary form, by camera id."""
    text = _of_binary(content.data) if content.is_binary else content.text
    cameras: dict[str, Values] = {}
    if not re.search(rf"^[ \t]*\d+[ \t]+({'|'.join(NAMES)})[ \t]", text, re.MULTILINE):
        return cameras
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        with within(f"line {number}"):
            if len(words) < 4:
                raise ArgumentError(f"expected 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]', got {shown(line)}")
            name = str(whole("CAMERA_ID", words[0]))
            if name in cameras:
                raise ArgumentError(f"expected each CAMERA_ID once, got {name} again")
            cameras[name] = {
                "MODEL": words[1],
                "WIDTH": words[2],
                "HEIGHT": words[3],
                "PARAMS": words[4:],
            }
    return cameras


def _of_binary(data: bytes) -> str:
    """Return the text of a ``cameras.bin``; "" for other bytes."""
    lines = []
    at = 8
    try:
        for _ in range(struct.unpack_from("<Q", data)[0]):
            camera_id, model, width, height = struct.unpack_from("<IIQQ", data, at)
            name, count = _IDS[model]
            values = struct.unpack_from(f"<{count}d", data, at + 24)
            lines.append(" ".join(map(str, [camera_id, name, width, height, *values])))
            at += 24 + 8 * count
    except (struct.error, IndexError):
        return ""
    return "\n".join(lines) if at == len(data) else ""


class Colmap(Form):
    """The form of COLMAP; names are ids, and a comment tells cameras that COLMAP sees in part."""

    def write(self, cameras: Mapping[str, RigCamera], *, rig: bool = False, suffix: str = "") -> str:
        """Return the ``cameras.txt`` of cameras by id.

        Args:
            cameras: by names that are whole numbers.
            rig: whether they are a rig, whose poses stand in another file.
            suffix: of the file's name, which does not matter.
        """
        return write_colmap({name: mounted.camera for name, mounted in cameras.items()})


COLMAP = Colmap(
    "colmap",
    "COLMAP, GLOMAP: cameras.txt, cameras.bin",
    marks=("MODEL", "PARAMS"),
    layout=Layout(
        models=_MODELS,
        word=("MODEL",),
        size=("WIDTH", "HEIGHT"),
        shift_px=0.0,
        poses=(PoseMatrix("rigs.txt", "T_c_b"),),
    ),
    reading=Reading(split=_lenses),
    writing=Writing(label="{1}", from_first=True),
    refused="THIN_PRISM_FISHEYE, DIVISION with two focal lengths",
)


def write_colmap(cameras: Mapping[str, Camera]) -> str:
    """Return the ``cameras.txt`` of cameras named by whole numbers, their ids."""
    lines = [
        "# Camera list with one line of data per camera:",
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
        f"# Number of cameras: {len(cameras)}",
    ]
    for name, camera in cameras.items():
        with within(name):
            if not re.fullmatch(r"[1-9]\d{0,8}", name, re.ASCII):
                raise ArgumentError(f"name: expected a whole number >= 1, got {shown(name)}")
            values = COLMAP.values_of(camera)
        if _sees_backwards(camera):
            lines.append(f"# {name}: COLMAP uses only the rays less than 90 degrees off the axis.")
        size = camera.width, camera.height
        params = size if isinstance(camera, Equirectangular) else values["PARAMS"]
        lines.append(" ".join(map(str, [name, values["MODEL"], *size, *params])))
    return "\n".join(lines) + "\n"


def refuses(camera: Camera) -> str | None:
    """Return why COLMAP cannot carry a camera, in one line; None where it can."""
    try:
        COLMAP.values_of(camera)
    except ArgumentError as cause:
        return str(cause)
    return None


def pose_words(pose: Pose) -> str:
    """Return ``QW QX QY QZ TX TY TZ`` of a pose as COLMAP has it: from the world to the camera."""
    world = pose.inverse()
    x, y, z, w = world.quaternion()
    return " ".join(map(str, [w, x, y, z, *(world.position + 0.0).tolist()]))


def pose_of(words: list[str]) -> Pose:
    """Return the pose that :func:`pose_words` wrote."""
    w, x, y, z, *t = numbers("QW QX QY QZ TX TY TZ", words, (7,)).tolist()
    return Pose.from_quaternion(t, (x, y, z, w)).inverse()


def rig_from_colmap(cameras: str, rigs: str) -> Rig:
    """Return the rig of a ``cameras.txt`` and a ``rigs.txt`` with one rig, in the frame of its reference.

    Args:
        cameras: the text of ``cameras.txt``.
        rigs: the text of ``rigs.txt``.

    Raises:
        ArgumentError: texts of another form, or several rigs.
    """
    lenses = COLMAP.read(Content(cameras))
    lines = [line.partition("#")[0].split() for line in rigs.splitlines()]
    lines = [words for words in lines if words]
    if len(lines) != 1 or len(lines[0]) < 4:
        raise wrong("rigs.txt", "one line 'RIG_ID NUM_SENSORS CAMERA ID ...'", lines)
    _, count, *words = lines[0]
    sensors: dict[str, RigCamera] = {}
    while words:
        (sensor, name) = words[:2]
        words = words[2:]
        pose = ORIGIN
        with within(f"rigs.txt: sensor {name}"):
            if sensor != "CAMERA" or name not in lenses or name in sensors:
                raise ArgumentError(f"expected each sensor a CAMERA of cameras.txt, got {shown(sensor)}")
            if sensors:
                if words[:1] != ["1"]:
                    raise ArgumentError(f"expected HAS_POSE 1, got {shown(words[:1])}")
                pose = pose_of(words[1:8])
                words = words[8:]
            sensors[name] = RigCamera(lenses[name].camera, pose)
    if len(sensors) != whole("NUM_SENSORS", count):
        raise ArgumentError(f"rigs.txt: NUM_SENSORS: expected {len(sensors)}, as listed, got {count}")
    return Rig(sensors)


def rig_to_colmap(rig: Rig) -> tuple[str, str]:
    """Return ``cameras.txt`` and ``rigs.txt`` of a rig whose cameras are named by their ids."""
    check_first_is_origin(rig.cameras, "COLMAP")
    lenses: dict[str, Camera] = {}
    poses: dict[int, Pose] = {}
    for name, mounted in rig.cameras.items():
        if mounted.time_offset:
            raise wrong(f"{name}: time_offset", "0, as COLMAP carries none", mounted.time_offset)
        lenses[name] = mounted.camera
    text = write_colmap(lenses)
    for name, mounted in rig.cameras.items():
        poses[int(name)] = mounted.pose
    return text, rig_line(1, poses) + "\n"


def rig_line(rig_id: int, sensors: Mapping[int, Pose]) -> str:
    """Return a rig's line of ``rigs.txt``.

    Args:
        rig_id: the rig's number, ``rig_id``.
        sensors: poses in one frame by the ids of cameras; the first camera is COLMAP's reference.
    """
    (reference, T_rig_ref), *others = sensors.items()
    T_ref_rig = T_rig_ref.inverse()
    words = [f"{rig_id} {len(sensors)} CAMERA {reference}"]
    for camera_id, pose in others:
        words.append(f"CAMERA {camera_id} 1 {pose_words(T_ref_rig @ pose)}")
    return " ".join(words)


def frame_line(frame_id: int, rig_id: int, pose: Pose, images: Mapping[int, int]) -> str:
    """Return a frame's line of ``frames.txt``.

    Args:
        frame_id: the frame's number.
        rig_id: that of its rig.
        pose: of the reference camera, world frame.
        images: ids of images by those of cameras.
    """
    data = " ".join(f"CAMERA {camera_id} {image_id}" for camera_id, image_id in images.items())
    return f"{frame_id} {rig_id} {pose_words(pose)} {len(images)} {data}"


def _sees_backwards(camera: Camera) -> bool:
    """Return whether a pixel of a grid sees 90 degrees off the axis or more."""
    if isinstance(camera, Equirectangular):
        return False
    axes = np.linspace(0, camera.width, 65), np.linspace(0, camera.height, 65)
    rays = camera.unproject(np.stack(np.meshgrid(*axes), axis=-1))
    return bool((rays.directions[rays.valid][:, 2] <= 0).any())
