"""COLMAP's text files ``cameras.txt`` and ``rigs.txt``, and the lines of ``frames.txt``.

Half pixel: none to shift. COLMAP's top-left pixel has its centre at (0.5, 0.5), as ours. The camera frames
agree: x right, y down, z forward. Carried: the models of ``MODELS``, and ``equirectangular``. Special
cases are written as the general model: ``fisheye-equidistant`` as a fisheye without coefficients,
``fisheye-stereographic`` and an undistorted ``unified`` as ``EUCM``, without the circle in which they end.

Not carried: every other model, a limit ``fov_deg``, a name that is no whole number, a rig's time offsets.
COLMAP reaches only rays less than 90 degrees off the axis in every model but ``EQUIRECTANGULAR``; a comment
says so for cameras that see more.

Source: COLMAP 4.2, ``src/colmap/sensor/models.h`` and ``scene/reconstruction_io_text.cc``.
"""

from collections.abc import Mapping

import numpy as np

from omniscv.arguments import numbers, one_of, shown, within
from omniscv.calibration import intrinsics
from omniscv.cameras import Camera, Equirectangular
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

MODELS = intrinsics.format_models("""
SIMPLE_PINHOLE             pinhole          f cx cy
PINHOLE                    pinhole          fx fy cx cy
SIMPLE_RADIAL              pinhole          f cx cy k1
RADIAL                     pinhole          f cx cy k1 k2
OPENCV                     pinhole          fx fy cx cy k1 k2 p1 p2
FULL_OPENCV                pinhole          fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
SIMPLE_FISHEYE             kannala-brandt   f cx cy
FISHEYE                    kannala-brandt   fx fy cx cy
SIMPLE_RADIAL_FISHEYE      kannala-brandt   f cx cy k1
RADIAL_FISHEYE             kannala-brandt   f cx cy k1 k2
OPENCV_FISHEYE             kannala-brandt   fx fy cx cy k1 k2 k3 k4
RAD_TAN_THIN_PRISM_FISHEYE fisheye624       fx fy cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3
SIMPLE_DIVISION            division         f cx cy k
DIVISION                   division         fx fy cx cy k
EUCM                       extended-unified fx fy cx cy alpha beta
""")
"""COLMAP's models by name, with our model and COLMAP's order of the parameters."""

_SPECIAL = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_FISHEYE", "FISHEYE", "DIVISION"}
_SPECIAL |= {"SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
# Many programs that read COLMAP's files do not know these special cases of other models.
_WRITTEN = [row for name, row in MODELS.items() if name not in _SPECIAL]

NAMES = (*MODELS, "EQUIRECTANGULAR")


def read_colmap(text: str) -> dict[str, Camera]:
    """Return the cameras of a ``cameras.txt``, named by their ids."""
    cameras: dict[str, Camera] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if words := line.partition("#")[0].split():
            with within(f"line {number}"):
                name, camera = _camera(words)
                if name in cameras:
                    raise ArgumentError(f"expected each CAMERA_ID once, got {name} again")
                cameras[name] = camera
    if not cameras:
        raise ArgumentError("expected lines 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]', got none")
    return cameras


def write_colmap(cameras: Mapping[str, Camera]) -> str:
    """Return the ``cameras.txt`` of cameras named by whole numbers, their ids."""
    lines = [
        "# Camera list with one line of data per camera:",
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
        f"# Number of cameras: {len(cameras)}",
    ]
    for name, camera in cameras.items():
        with within(name):
            camera_id = intrinsics.whole_number("name", name)
            line = camera_line(camera_id, camera)
        if _sees_backwards(camera):
            lines.append(f"# {camera_id}: COLMAP uses only the rays less than 90 degrees off the axis.")
        lines.append(line)
    return "\n".join(lines) + "\n"


def camera_line(camera_id: int, camera: Camera) -> str:
    """Return a camera's line of ``cameras.txt``, without a line break."""
    if isinstance(camera, Equirectangular):
        return f"{camera_id} EQUIRECTANGULAR {camera.width} {camera.height} {camera.width} {camera.height}"
    known = ", ".join(dict.fromkeys(row.model for row in MODELS.values()))
    expected = f"COLMAP: expected equirectangular, {known}, unskewed"
    row, values = intrinsics.write_numbers(camera, _WRITTEN, 0.0, expected)
    return " ".join(map(str, [camera_id, row.name, camera.width, camera.height, *values]))


def refuses(camera: Camera) -> str | None:
    """Return why COLMAP cannot carry a camera, in one line; None where it can."""
    try:
        camera_line(1, camera)
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
    """Return the rig of a ``cameras.txt`` and a ``rigs.txt`` with one rig, in the frame of its reference."""
    known = read_colmap(cameras)
    lines = [words for line in rigs.splitlines() if (words := line.partition("#")[0].split())]
    if len(lines) != 1 or len(lines[0]) < 4:
        raise ArgumentError(
            f"rigs.txt: expected one line 'RIG_ID NUM_SENSORS CAMERA ID ...', got {shown(lines)}"
        )
    _, count, *words = lines[0]
    sensors: dict[str, RigCamera] = {}
    while words:
        (sensor, name), words = words[:2], words[2:]
        pose = Pose(np.zeros(3), np.eye(3))
        with within(f"rigs.txt: sensor {name}"):
            if sensor != "CAMERA" or name not in known or name in sensors:
                raise ArgumentError(f"expected each sensor a CAMERA of cameras.txt, got {shown(sensor)}")
            if sensors:
                if words[:1] != ["1"]:
                    raise ArgumentError(f"expected HAS_POSE 1, got {shown(words[:1])}")
                pose, words = pose_of(words[1:8]), words[8:]
            sensors[name] = RigCamera(known[name], pose)
    if len(sensors) != intrinsics.whole_number("NUM_SENSORS", count):
        raise ArgumentError(f"rigs.txt: NUM_SENSORS: expected {len(sensors)}, as listed, got {count}")
    return Rig(sensors)


def rig_to_colmap(rig: Rig) -> tuple[str, str]:
    """Return ``cameras.txt`` and ``rigs.txt`` of a rig whose cameras are named by their ids."""
    intrinsics.check_first_is_origin(rig, "COLMAP")
    for name, mounted in rig.cameras.items():
        if mounted.time_offset:
            got = f"{mounted.time_offset:.15g}"
            raise ArgumentError(f"{name}: time_offset: expected 0, as COLMAP carries none, got {got}")
    cameras = write_colmap({name: mounted.camera for name, mounted in rig.cameras.items()})
    return cameras, rig_line(1, {int(name): mounted.pose for name, mounted in rig.cameras.items()}) + "\n"


def rig_line(rig_id: int, sensors: Mapping[int, Pose]) -> str:
    """Return a rig's line of ``rigs.txt``.

    Args:
        rig_id: from 1.
        sensors: poses in one frame by the ids of cameras; the first camera is COLMAP's reference.
    """
    (reference, T_rig_ref), *others = sensors.items()
    words = [f"{rig_id} {len(sensors)} CAMERA {reference}"]
    for camera_id, pose in others:
        words.append(f"CAMERA {camera_id} 1 {pose_words(T_rig_ref.inverse() @ pose)}")
    return " ".join(words)


def frame_line(frame_id: int, rig_id: int, pose: Pose, images: Mapping[int, int]) -> str:
    """Return a frame's line of ``frames.txt``.

    Args:
        frame_id, rig_id: from 1.
        pose: of the reference camera, world frame.
        images: ids of images by ids of cameras.
    """
    data = " ".join(f"CAMERA {camera_id} {image_id}" for camera_id, image_id in images.items())
    return f"{frame_id} {rig_id} {pose_words(pose)} {len(images)} {data}"


def _camera(words: list[str]) -> tuple[str, Camera]:
    if len(words) < 4:
        raise ArgumentError(f"expected 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]', got {shown(' '.join(words))}")
    model = one_of("MODEL", words[1], NAMES)
    name = str(intrinsics.whole_number("CAMERA_ID", words[0]))
    width, height = intrinsics.whole_number("WIDTH", words[2]), intrinsics.whole_number("HEIGHT", words[3])
    if model == "EQUIRECTANGULAR":
        size = numbers(f"PARAMS of {model}", words[4:], (2,)).tolist()
        if size != [width, height]:
            raise ArgumentError(
                f"PARAMS of EQUIRECTANGULAR: expected the image size {width} {height}, got {size}"
            )
        return name, Equirectangular(width, height)
    row = MODELS[model]
    values = numbers(f"PARAMS of {model}", words[4:], (len(row.numbers),)).tolist()
    return name, intrinsics.camera_of(row.model, width, height, intrinsics.read_numbers(row, values, 0.0))


def _sees_backwards(camera: Camera) -> bool:
    """Return whether a pixel of a grid sees 90 degrees off the axis or more."""
    if isinstance(camera, Equirectangular):
        return False
    u = np.linspace(0, camera.width, 65)
    v = np.linspace(0, camera.height, 65)
    rays = camera.unproject(np.stack(np.meshgrid(u, v), axis=-1))
    return bool((rays.directions[rays.valid][:, 2] <= 0).any())
