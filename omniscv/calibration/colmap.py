"""COLMAP's text files: ``cameras.txt``, and the lines of ``rigs.txt`` and ``frames.txt``.

Half pixel: none to shift. COLMAP's top-left pixel has its centre at (0.5, 0.5), as ours. The camera frames
agree: x right, y down, z forward. Carried: the models of ``MODELS``, and ``equirectangular``. Lenses that are
another model's special case go as that one: ``fisheye-equidistant`` as a fisheye without coefficients,
``fisheye-stereographic`` and an undistorted ``unified`` as ``EUCM``, without the circle in which they end.

Not carried: every other model, a limit ``fov_deg``, a name that is no whole number. COLMAP reaches only rays
less than 90 degrees off the axis in every model but ``EQUIRECTANGULAR``; a comment says so where a camera
sees more.

Source: COLMAP 4.2, ``src/colmap/sensor/models.h`` and ``scene/reconstruction_io_text.cc``.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from omniscv.arguments import numbers, one_of, shown, within
from omniscv.calibration.common import whole_number
from omniscv.calibration.intrinsics import FormatModel, camera_of, fit_format, read_numbers
from omniscv.cameras import Camera, Equirectangular
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_TABLE = """
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
"""
_ROWS = [line.split() for line in _TABLE.strip().splitlines()]
MODELS = {name: FormatModel(name, model, tuple(names)) for name, model, *names in _ROWS}
"""COLMAP's models by name, with our model and COLMAP's order of the parameters."""

_ONLY_READ = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_FISHEYE", "FISHEYE", "DIVISION"}
_ONLY_READ |= {"SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
# Special cases of others, which more programs that read COLMAP's files know.
_WRITTEN = [name for name in MODELS if name not in _ONLY_READ]

NAMES = (*MODELS, "EQUIRECTANGULAR")


def read_colmap(text: str) -> dict[str, Camera]:
    """Return the cameras of a ``cameras.txt``, named by their ids.

    Raises:
        ArgumentError: no camera, an id twice, a model other than those above, or a line that is not
            ``CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]`` with the model's number of finite parameters.
    """
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
    """Return the ``cameras.txt`` of cameras named by whole numbers, their ids.

    Raises:
        ArgumentError: a name that is no whole number >= 1, or a model that COLMAP does not have.
    """
    lines = [
        "# Camera list with one line of data per camera:",
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
        f"# Number of cameras: {len(cameras)}",
    ]
    for name, camera in cameras.items():
        with within(name):
            camera_id = whole_number("name", name)
            line = camera_line(camera_id, camera)
        if _sees_backwards(camera):
            lines.append(f"# {camera_id}: COLMAP uses only the rays less than 90 degrees off the axis.")
        lines.append(line)
    return "\n".join(lines) + "\n"


def camera_line(camera_id: int, camera: Camera) -> str:
    """Return a camera's line of ``cameras.txt``, without a line break.

    Raises:
        ArgumentError: a camera that COLMAP cannot carry.
    """
    if isinstance(camera, Equirectangular):
        return f"{camera_id} EQUIRECTANGULAR {camera.width} {camera.height} {camera.width} {camera.height}"
    found = fit_format(camera, [MODELS[name] for name in _WRITTEN], 0.0)
    if found is None:
        known = ", ".join(dict.fromkeys(row.model for row in MODELS.values()))
        raise ArgumentError(f"COLMAP: expected equirectangular, {known}, unskewed, got {camera.name}")
    row, values = found
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
    inverse = Rotation.from_matrix(pose.R_w_c.T)
    x, y, z, w = (inverse.as_quat(canonical=True) + 0.0).tolist()
    t = (-pose.t_w_c @ pose.R_w_c + 0.0).tolist()
    return " ".join(map(str, [w, x, y, z, *t]))


def pose_of(words: list[str]) -> Pose:
    """Return the pose whose :func:`pose_words` are given.

    Raises:
        ArgumentError: not seven finite numbers, or a quaternion of length 0.
    """
    w, x, y, z, *t = numbers("QW QX QY QZ TX TY TZ", words, (7,)).tolist()
    if not np.linalg.norm([w, x, y, z]) > 1e-12:
        raise ArgumentError(f"QW QX QY QZ: expected a quaternion, got {shown(words[:4])}")
    R_c_w = Rotation.from_quat([x, y, z, w]).as_matrix()
    return Pose(-np.array(t) @ R_c_w, R_c_w.T)


def rig_line(rig_id: int, sensors: Mapping[int, Pose]) -> str:
    """Return a rig's line of ``rigs.txt``: ids of cameras and their poses in one frame, the first camera is
    the reference, whose frame COLMAP takes for the rig's."""
    (reference, T_rig_ref), *others = sensors.items()
    parts = [f"{rig_id} {len(sensors)} CAMERA {reference}"]
    for camera_id, pose in others:
        parts.append(f"CAMERA {camera_id} 1 {pose_words(T_rig_ref.inverse() @ pose)}")
    return " ".join(parts)


def frame_line(frame_id: int, rig_id: int, pose: Pose, images: Mapping[int, int]) -> str:
    """Return a frame's line of ``frames.txt``.

    Args:
        frame_id, rig_id: from 1.
        pose: of the reference camera, world frame.
        images: ids of images by the ids of the cameras that took them.
    """
    data = " ".join(f"CAMERA {camera_id} {image_id}" for camera_id, image_id in images.items())
    return f"{frame_id} {rig_id} {pose_words(pose)} {len(images)} {data}"


def _camera(words: list[str]) -> tuple[str, Camera]:
    if len(words) < 4:
        raise ArgumentError(f"expected 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]', got {shown(' '.join(words))}")
    model = one_of("MODEL", words[1], NAMES)
    name = str(whole_number("CAMERA_ID", words[0]))
    width, height = whole_number("WIDTH", words[2]), whole_number("HEIGHT", words[3])
    if model == "EQUIRECTANGULAR":
        size = numbers(f"PARAMS of {model}", words[4:], (2,)).tolist()
        if size != [width, height]:
            raise ArgumentError(
                f"PARAMS of EQUIRECTANGULAR: expected the image size {width} {height}, got {size}"
            )
        return name, Equirectangular(width, height)
    row = MODELS[model]
    values = numbers(f"PARAMS of {model}", words[4:], (len(row.numbers),)).tolist()
    return name, camera_of(row.model, width, height, read_numbers(row, values, 0.0))


def _sees_backwards(camera: Camera) -> bool:
    """Whether a pixel at the image's border, or on its axes, sees 90 degrees off the axis or more."""
    if isinstance(camera, Equirectangular):
        return False
    u = np.linspace(0, camera.width, 65)
    v = np.linspace(0, camera.height, 65)
    rays = camera.unproject(np.stack(np.meshgrid(u, v), axis=-1))
    return bool((rays.directions[rays.valid][:, 2] <= 0).any())
