"""OpenCV's three models, as arrays and as files: of ``cv2.FileStorage``, of ROS, and of people's scripts.

Half pixel: OpenCV puts pixel centres at whole numbers, so its principal point is ours minus 0.5. In
``opencv`` K has no skew, which OpenCV ignores in this model, and the last two of 14 coefficients, which tilt
the sensor, are 0. ``opencv-fisheye`` and ``opencv-omnidir`` have it in ``K[0, 1] = fx skew``, and carry
``fisheye-equidistant`` and ``fisheye-stereographic``, too, without the circle in which these end.

The keys of files are those of OpenCV's calibration samples, or any of ``K`` and ``D`` below, also of two
cameras (``K1``, ``left_camera_matrix``). ``fisheye_model`` may be missing but not that of the other model:
four coefficients of it describe another lens.

Source: OpenCV 5, calib3d; opencv_contrib, ccalib (omnidir.cpp); ROS, sensor_msgs/CameraInfo.
"""

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import number, shown, wrong
from omniscv.calibration.documents import Content
from omniscv.calibration.forms import Entry, Form, matrix_3x4, rotation_of
from omniscv.calibration.nodes import Node, Values, canonical, families, floats, marked, plain, whole
from omniscv.calibration.parts import Sized
from omniscv.calibration.table import HEIGHT, PLAIN, WIDTH, D
from omniscv.cameras import Camera, create
from omniscv.cameras.lens_parameters import Numbers
from omniscv.cameras.rig import ORIGIN
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_log = logging.getLogger("omniscv")
Floats = NDArray[np.float64]

K = (
    "camera_matrix|K|mtx|intrinsic_matrix|camera_intrinsics|intrinsics|intrinsic|cam_matrix|cam_mtx|cameraMat|"
    "camera_matrix_row_major|camera_mat|M|matrix|cmtx|K_matrix|intrinsics_matrix|camera_intrinsic|camera_matrix_K|camMatrix|intr|intri|new_K"
)
_FOUR = "intrinsics|intrinsic|camera_intrinsics|cam_intrinsics=fx,fy,cx,cy"
_UPRIGHT = "fx,0,cx,0,fy,cy,0,0,1"
_SKEWED = "fx,s,cx,0,fy,cy,0,0,1"
_SIZES = f"{WIDTH} {HEIGHT}"
_WORDS = "distortion_model|distortion_type|lens_model|lens_type"
_LOOSE_WORDS = (
    "camera_model|model|type|model_type|camera_type|calibration_type|calibration_model|projection_model"
)
_FLAGS = "fisheye_model|fisheye|is_fisheye|use_fisheye"
_PLAIN_WORDS = ("radtan", "none", "pinhole", "perspective", "frame")
_OTHER_WORDS = (
    " fov atan doublesphere ds eucm ucm omni omnidirectional mei unified extendedunified thinprismfisheye "
    "division ftheta inversebrownconrady modifiedbrownconrady scaramuzza ocam radtanthinprismfisheye "
    "fisheye624 spherical "
)
_SIDE = r"left|right|l|r|rgb|colou?r|depth|ir|infrared|event|thermal|cam(?:era)?[0-9]?"
_SIDED = rf"(?:(?P<name>{_SIDE})\.?(?:camera)??)??(?P<key>{plain(f'{K}|{D}')})\.?(?P<after>{_SIDE}|[0-9])?"
_FARTHEST_M = 10.0  # cameras of a pair; T is in the unit of the board, which may be mm
_STEREO = "R, T"  # in one
EITHER = "opencv or opencv-fisheye"


def model_of(node: Node) -> str:
    """Return which of the three models a camera has; ``EITHER`` where four coefficients may be of two;
    ArgumentError for a word for another model."""
    given = floats("distortion_coefficients", node.take(D, []) or [])
    if node.has("xi") and (len(given) == 4 or any(floats("xi", node.take("xi")))):
        return "opencv-omnidir"
    for word in (canonical(node.take(paths)) for paths in (_WORDS, _LOOSE_WORDS) if node.has(paths)):
        if word == "equidistant":
            return "opencv-fisheye"
        if word in _PLAIN_WORDS and (word != "none" or node.has(_WORDS)):
            return "opencv"
        if f" {word} " in _OTHER_WORDS or (node.has(_WORDS) and isinstance(node.take(_WORDS), str)):
            got = node.take(_WORDS, None) or node.take(_LOOSE_WORDS)
            raise wrong("distortion_model", "plumb_bob, rational_polynomial or equidistant", got)
    flag = str(node.take(_FLAGS, "")).lower().removesuffix(".0")
    if flag in ("0", "1", "true", "false"):
        return "opencv-fisheye" if flag in ("1", "true") else "opencv"
    return EITHER if len(given) == 4 and any(given) else "opencv"


def _set_stereo(found: dict[str, Node], pose: Mapping[str, Any]) -> None:
    """Give two cameras their poses by R and T of ``cv2.stereoCalibrate``."""
    if len(found) == 2 and pose.get("R") is not None and pose.get("T") is not None:
        poses = np.eye(4)[:3], matrix_3x4("R", pose["R"], pose["T"])
        for node, rows in zip(found.values(), poses, strict=True):
            node.values = {**node.values, _STEREO: rows.tolist()}


def _is_matrix(node: Node) -> bool:
    """Return whether the key is that of a matrix, or of what should be one."""
    value = node.take(K)
    return "data" in value if isinstance(value, Mapping) else isinstance(value, list | str)


def _sides(document: Any, outer: tuple[Any, ...] = ()) -> dict[str, Node]:
    """Return the cameras of keys such as K1, D1, or left_camera_matrix; R and T lead to the second."""
    if not isinstance(document, Mapping):
        return {}
    sides, shared = families(document, _SIDED)
    sides = {side: lens for side, lens in sides.items() if Node(lens).has(K)}
    if not sides:
        return {k: v for below in document.values() for k, v in _sides(below, (document, *outer)).items()}
    pose: Values = {str(key): shared.pop(key) for key in ("R", "T") if key in shared}
    long = {"l": "left", "r": "right"} | {str(i): f"cam{i}" for i in range(10)}
    found = {long.get(side, side): Node({**shared, **sides[side]}, outer) for side in sorted(sides)}
    _set_stereo(found, pose)
    return found


class OpenCV(Form):
    """One of the three models in files of any spelling."""

    def nodes(self, content: Content) -> dict[str, Node]:
        """Return the cameras that have a matrix, by name: ``cam0``, their key, or their side."""
        found: dict[str, Node] = {}
        for document in content.documents:
            for path, node in marked(document, [K], accepts=_is_matrix):
                name = next((part for part in reversed(path) if isinstance(part, str)), "cam0")
                found[name if name not in found else f"{name}-{len(found)}"] = node
            if not found:
                found |= _sides(document)
            elif isinstance(document, Mapping):
                _set_stereo(found, document)
        return found

    def is_of(self, content: Content) -> bool:
        """Return whether a file's cameras are all of this model, as their keys say."""
        nodes = self.nodes(content)
        models = {model_of(node) for node in nodes.values()}
        if EITHER in models:
            raise ArgumentError(
                "expected coefficients of one model, got four, which may be of two: give format opencv "
                "(k1 k2 p1 p2 of the plain model) or opencv-fisheye (k1 k2 k3 k4), such as "
                "--from opencv, or --set camera.format=opencv"
            )
        return models == {self.name}

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras; poses of two by R and T, whose unit is that of the board."""
        entries = super().read(content, size)
        apart = max(np.linalg.norm(one.pose.position) if one.pose else 0.0 for one in entries.values())
        says = "taken as metres, as OpenCV's files do not say the unit: the cameras are %.6g m apart"
        if apart > _FARTHEST_M:
            entries = {name: entry._replace(pose=None) for name, entry in entries.items()}
            says = "expected metres between two cameras, got %.6g: the poses are left out; divide T by 1000"
            says += " if it is in mm"
        if apart:
            _log.warning("T: " + says, apart)
        return entries

    def entry(self, node: Node, size: tuple[int, int] | None) -> Entry:
        if (model := model_of(node)) not in (self.name, EITHER):
            raise ArgumentError(f"expected a camera of {self.name}, got {model}: read the file as {model!r}")
        for path in (_WORDS, _LOOSE_WORDS, _FLAGS):
            node.take(path, None)
        return super().entry(node, size)

    def text(self, document: Any, suffix: str) -> str:
        """Return the text of ``cv2.FileStorage``, by the suffix ``.yml``, ``.xml`` or ``.json``."""
        import cv2  # slow to load, and reading does without

        suffix = suffix if suffix in (".yml", ".yaml", ".xml", ".json") else ".yml"
        storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        terms = (1, -1) if "xi" in document else (-1, 1)  # as the samples of the modules have them
        for key, value in document.items():
            if isinstance(value, list):
                value = np.reshape(value, (3, 3) if key == "camera_matrix" else terms)
            storage.write(key, value)
        return str(storage.releaseAndGetString())


def _form(name: str, programs: str, models: str, **constant: int) -> OpenCV:
    harmless = "^(rectification|projection)matrix$"
    poses = ((_STEREO, "T_c_b"),)
    return OpenCV(name, programs, K, models, size=_SIZES, poses=poses, harmless=harmless, constant=constant)


OPENCV = _form(
    "opencv",
    "OpenCV's samples, numpy archives, scripts: K and D in any spelling",
    f"- pinhole {K}={_UPRIGHT} {D}?={PLAIN}\n< - pinhole {_FOUR} {D}?={PLAIN}",
    fisheye_model=0,
)
FISHEYE = _form(
    "opencv-fisheye",
    "the same of cv2.fisheye",
    f"- kannala-brandt {K}={_SKEWED} {D}=k1,k2,k3,k4;0\n< - kannala-brandt {_FOUR} {D}=k1,k2,k3,k4;0",
    fisheye_model=1,
)
OMNIDIR = _form("opencv-omnidir", "the same of cv2.omnidir", f"- unified {K}={_SKEWED} xi {D}=k1,k2,p1,p2")


def _binned(node: Node, word: str, values: Numbers, width: int, height: int) -> Sized:
    """Crop to the region of interest, then bin: pixels of the sensor become those of the image."""
    size = []
    for axis, full in (("x", width), ("y", height)):
        by = max(1, whole(f"binning_{axis}", node.take(f"binning_{axis}", 1) or 1))
        side = {"x": "width", "y": "height"}[axis]
        start = number("roi", node.take(f"roi.{axis}_offset", 0), least=0)
        part = int(number("roi", node.take(f"roi.{side}", 0), least=0)) or full
        if start + part > full:
            raise ArgumentError(f"roi: expected a part of the image of {full} px, got {start:.15g} + {part}")
        values[f"f{axis}"] /= by
        values[f"c{axis}"] = (values[f"c{axis}"] + 0.5 - start) / by - 0.5
        size.append(part // by)
    node.take("roi.do_rectify", None)
    return values, (size[0], size[1])


class Ros(Form):
    """``camera_info``: the camera of the raw picture; and of the rectified one, where that is turned."""

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        entries = super().read(content, size)
        nodes = self.nodes(content)
        for name, node in nodes.items():
            turn = floats("rectification_matrix", node.take("rectification_matrix|R|rectification", []) or [])
            P = floats("projection_matrix", node.take("projection_matrix|P|projection", []) or [])
            if len(turn) != 9 or not any(turn) or np.abs(rotation_of(turn) - np.eye(3)).max() < 1e-9:
                continue
            if len(P) != 12 or not P[0]:
                raise wrong("rectification_matrix", "an identity, or a projection_matrix", turn)
            raw = entries[name].camera
            lens = create("pinhole", raw.width, raw.height, fx=P[0], fy=P[5], cx=P[2] + 0.5, cy=P[6] + 0.5)
            entries[f"{name}-rectified"] = Entry(lens, Pose(np.zeros(3), rotation_of(turn).T))
            if len(nodes) == 1:  # where the cameras of a pair are, the file does not say
                entries[name] = entries[name]._replace(pose=ORIGIN)
        return entries


ROS = Ros(
    "ros",
    "ROS 1 and 2: camera_info as file, .ini or print",
    f"{K} distortion_model|rectification_matrix|projection_matrix|rectification|projection|P",
    f"""
    plumb_bob|rational_polynomial pinhole {K}={_UPRIGHT} {D}=;{PLAIN}
    none pinhole {K}={_UPRIGHT} {D}=;k1,k2,p1,p2,k3
    equidistant kannala-brandt {K}={_UPRIGHT} {D}=k1,k2,k3,k4
    < plumb_bob|rational_polynomial pinhole {_FOUR} {D}=;{PLAIN}
    < equidistant kannala-brandt {_FOUR} {D}=k1,k2,k3,k4
    """,
    word="distortion_model|camera_model",
    size=_SIZES,
    constant={"camera_name": "camera"},
    harmless="^r(ectification(matrix)?)?$|^p(rojection(matrix)?)?$",
    finish=_binned,
)


# -- arrays --------------------------------------------------------------------------------------------


def from_opencv(K: ArrayLike, D: ArrayLike, width: int, height: int) -> Camera:
    """Return the ``pinhole`` camera of ``cv2.projectPoints``'s K and D.

    Args:
        K: (3, 3), px, ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` with pixel centres at whole numbers:
            0.5 is added to cx and cy.
        D: 4, 5, 8, 12 or 14 numbers (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, 0, 0), as (N,), (N, 1)
            or (1, N).
        width, height: image size, px; K and D do not hold it.
    """
    return _camera(OPENCV, width, height, K, D)


def to_opencv(camera: Camera) -> tuple[Floats, Floats]:
    """Return K (3, 3) and D (4, 5, 8 or 12) for ``cv2.projectPoints``; 0.5 is taken from the principal point.

    OpenCV projects points with z < 0 too, mirrored.
    """
    K, D, _ = _arrays(OPENCV, camera)
    return K, D


def from_opencv_fisheye(K: ArrayLike, D: ArrayLike, width: int, height: int) -> Camera:
    """Return the ``kannala-brandt`` camera of ``cv2.fisheye``'s K and D.

    Args:
        K: (3, 3), px, ``[[fx, fx skew, cx], [0, fy, cy], [0, 0, 1]]`` with pixel centres at whole numbers:
            0.5 is added to cx and cy.
        D: four numbers (k1, k2, k3, k4), as (4,), (4, 1) or (1, 4).
        width, height: image size, px.
    """
    return _camera(FISHEYE, width, height, K, D)


def to_opencv_fisheye(camera: Camera) -> tuple[Floats, Floats]:
    """Return K (3, 3) and D (4,) for ``cv2.fisheye``; 0.5 is taken from the principal point.

    OpenCV's ``projectPoints`` works on x / z, so it is right only for points with z > 0; it takes skew as
    its argument ``alpha``, ``K[0, 1] / K[0, 0]``.
    """
    K, D, _ = _arrays(FISHEYE, camera)
    return K, D


def from_opencv_omnidir(K: ArrayLike, xi: float, D: ArrayLike, width: int, height: int) -> Camera:
    """Return the ``unified`` camera of ``cv2.omnidir``'s K, xi and D.

    Args:
        K: (3, 3) as :func:`from_opencv_fisheye` takes it.
        xi: no unit.
        D: four numbers (k1, k2, p1, p2), as (4,), (4, 1) or (1, 4).
        width, height: image size, px.
    """
    return _camera(OMNIDIR, width, height, K, D, xi=np.squeeze(np.asarray(xi, dtype=object)).tolist())


def to_opencv_omnidir(camera: Camera) -> tuple[Floats, float, Floats]:
    """Return K (3, 3), xi and D (4,) for ``cv2.omnidir``; 0.5 is taken from the principal point."""
    K, D, values = _arrays(OMNIDIR, camera)
    return K, values["xi"], D


def _camera(form: Form, width: int, height: int, K: ArrayLike, D: ArrayLike, **more: Any) -> Camera:
    arrays = {"K": np.asarray(K, dtype=object).tolist(), "D": np.asarray(D, dtype=object).tolist()}
    if len(floats("K", arrays["K"])) != 9:
        raise ArgumentError(f"K: expected 3 x 3 finite numbers, got {shown(K)}")
    row, values = form.row(Node(arrays | more), "none")
    return form.camera(row, width, height, values)


def _arrays(form: Form, camera: Camera) -> tuple[Floats, Floats, Numbers]:
    row, values = form.held(camera)
    matrix, terms = (np.array(key.write(values)) for key in row.keys if len(key.names) > 1)
    return matrix.reshape(3, 3), terms, values
