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
from omniscv.calibration.forms import (
    Entry,
    Form,
    Layout,
    LensNumbers,
    PoseMatrix,
    Reading,
    Writing,
    matrix_3x4,
    rotation_of,
)
from omniscv.calibration.keys import FISHEYE4, MATRIX, RADTAN4, RADTAN5, Model, Number, array, scalar
from omniscv.calibration.nodes import Node, Values, canonical, families, floats, marked, plain, whole
from omniscv.calibration.table import HEIGHT, UPRIGHT, WIDTH, D, distortion
from omniscv.cameras import Camera, create
from omniscv.cameras.lens_parameters import Numbers
from omniscv.cameras.rig import ORIGIN
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_log = logging.getLogger("omniscv")
Floats = NDArray[np.float64]

K = (
    "camera_matrix", "K", "mtx", "intrinsic_matrix", "camera_intrinsics", "intrinsics", "intrinsic",
    "cam_matrix", "cam_mtx", "cameraMat", "camera_matrix_row_major", "camera_mat", "M", "matrix", "cmtx",
    "K_matrix", "intrinsics_matrix", "camera_intrinsic", "camera_matrix_K", "camMatrix", "intr", "intri",
    "new_K",
)  # fmt: skip
"""What people call the matrix."""
_FOUR = array(("intrinsics", "intrinsic", "camera_intrinsics", "cam_intrinsics"), *MATRIX)
_SKEWED: tuple[Number | int, ...] = ("fx", "s", "cx", 0, "fy", "cy", 0, 0, 1)
_SIZES = (WIDTH, HEIGHT)
_WORDS = ("distortion_model", "distortion_type", "lens_model", "lens_type")
_LOOSE_WORDS = (
    "camera_model", "model", "type", "model_type", "camera_type", "calibration_type", "calibration_model",
    "projection_model",
)  # fmt: skip
"""Keys of words that may name a camera instead of its model."""
_FLAGS = ("fisheye_model", "fisheye", "is_fisheye", "use_fisheye")
_PLAIN_WORDS = ("radtan", "none", "pinhole", "perspective", "frame")
_OTHER_WORDS = (
    "fov", "atan", "doublesphere", "ds", "eucm", "ucm", "omni", "omnidirectional", "mei", "unified",
    "extendedunified", "thinprismfisheye", "division", "ftheta", "inversebrownconrady",
    "modifiedbrownconrady", "scaramuzza", "ocam", "radtanthinprismfisheye", "fisheye624", "spherical",
)  # fmt: skip
_SIDE = r"left|right|l|r|rgb|colou?r|depth|ir|infrared|event|thermal|cam(?:era)?[0-9]?"
_KEYS = plain("|".join((*K, *D)))
_SIDED = rf"(?:(?P<name>{_SIDE})\.?(?:camera)??)??(?P<key>{_KEYS})\.?(?P<after>{_SIDE}|[0-9])?"
_LONG_SIDES = {"l": "left", "r": "right"} | {str(i): f"cam{i}" for i in range(10)}
_FARTHEST_M = 10.0  # cameras of a pair; T is in the unit of the board, which may be mm
_STEREO = "R, T"
"""The key that gets both as one matrix."""
EITHER = "opencv or opencv-fisheye"


def model_of(node: Node) -> str:
    """Return which of the three models a camera has; ``EITHER`` where four coefficients may be of two;
    ArgumentError for a word for another model."""
    coefficients = floats("distortion_coefficients", node.take(D, []) or [])
    if node.has("xi") and (len(coefficients) == 4 or any(floats("xi", node.take("xi")))):
        return "opencv-omnidir"
    by_word = _model_of_words(node)
    if by_word is not None:
        return by_word
    flag = str(node.take(_FLAGS, "")).lower().removesuffix(".0")
    if flag in ("1", "true"):
        return "opencv-fisheye"
    if flag in ("0", "false"):
        return "opencv"
    return EITHER if len(coefficients) == 4 and any(coefficients) else "opencv"


def _model_of_words(node: Node) -> str | None:
    """Return the model that a camera's words name; None if they name none, ArgumentError if another one."""
    is_certain = node.has(_WORDS)
    for paths in (_WORDS, _LOOSE_WORDS):
        if not node.has(paths):
            continue
        word = canonical(node.take(paths))
        if word == "equidistant":
            return "opencv-fisheye"
        if word in _PLAIN_WORDS and (word != "none" or is_certain):
            return "opencv"
        if word in _OTHER_WORDS or (is_certain and isinstance(node.take(_WORDS), str)):
            value = node.take(_WORDS, None) or node.take(_LOOSE_WORDS)
            raise wrong("distortion_model", "plumb_bob, rational_polynomial or equidistant", value)
    return None


def _set_stereo(nodes: dict[str, Node], pose: Mapping[str, Any]) -> None:
    """Give two cameras their poses by R and T of ``cv2.stereoCalibrate``."""
    if len(nodes) != 2 or pose.get("R") is None or pose.get("T") is None:
        return
    first, second = nodes.values()
    T_c_b = matrix_3x4("R", pose["R"], pose["T"])
    first.values = {**first.values, _STEREO: np.eye(4)[:3].tolist()}
    second.values = {**second.values, _STEREO: T_c_b.tolist()}


def _is_matrix(node: Node) -> bool:
    """Return whether the key is that of a matrix, or of what should be one."""
    value = node.take(K)
    return "data" in value if isinstance(value, Mapping) else isinstance(value, list | str)


def _sides(document: Any, outer: tuple[Any, ...] = ()) -> dict[str, Node]:
    """Return the cameras of keys such as K1, D1, or left_camera_matrix; R and T lead to the second."""
    nodes: dict[str, Node] = {}
    if not isinstance(document, Mapping):
        return nodes
    families_by_side, shared = families(document, _SIDED)
    lenses = {side: lens for side, lens in families_by_side.items() if Node(lens).has(K)}
    if not lenses:
        for below in document.values():
            nodes |= _sides(below, (document, *outer))
        return nodes
    pose: Values = {}
    for key in ("R", "T"):
        if key in shared:
            pose[key] = shared.pop(key)
    for side in sorted(lenses):
        nodes[_LONG_SIDES.get(side, side)] = Node({**shared, **lenses[side]}, outer)
    _set_stereo(nodes, pose)
    return nodes


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
        """Return the cameras; poses of two by R and T, whose unit is that of the board.

        Args:
            content: the file.
            size: width and height of the images, px, where the file does not hold them.
        """
        entries = super().read(content, size)
        apart = 0.0
        for entry in entries.values():
            if entry.pose is not None:
                apart = max(apart, float(np.linalg.norm(entry.pose.position)))
        if apart > _FARTHEST_M:
            for name, entry in entries.items():
                entries[name] = entry._replace(pose=None)
            _log.warning(
                "T: expected metres between two cameras, got %.6g: the poses are left out; "
                "divide T by 1000 if it is in mm",
                apart,
            )
        elif apart:
            _log.warning(
                "T: taken as metres, as OpenCV's files do not say the unit: the cameras are %.6g m apart",
                apart,
            )
        return entries

    def entry(self, node: Node, size: tuple[int, int] | None) -> Entry:
        """Return a camera of a file.

        Args:
            node: its mapping.
            size: width and height of the image, px, where the file does not hold them.

        Raises:
            ArgumentError: a camera of another of the three models, or what we do not model.
        """
        model = model_of(node)
        if model not in (self.name, EITHER):
            raise ArgumentError(f"expected a camera of {self.name}, got {model}: read the file as {model!r}")
        for path in (_WORDS, _LOOSE_WORDS, _FLAGS):
            node.take(path, None)
        return super().entry(node, size)

    def text(self, document: Any, suffix: str) -> str:
        """Return the text of ``cv2.FileStorage``.

        Args:
            document: numbers, and lists of them, by key.
            suffix: of the file's name, ``.yml``, ``.yaml``, ``.xml`` or ``.json``; any other is ``.yml``.
        """
        import cv2  # slow to load, and reading does without

        if suffix not in (".yml", ".yaml", ".xml", ".json"):
            suffix = ".yml"
        storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        terms = (1, -1) if "xi" in document else (-1, 1)  # as the samples of the modules have them
        for key, value in document.items():
            if isinstance(value, list):
                value = np.reshape(value, (3, 3) if key == "camera_matrix" else terms)
            storage.write(key, value)
        return str(storage.releaseAndGetString())


def _form(name: str, programs: str, *models: Model, constant: Mapping[str, int] | None = None) -> OpenCV:
    """Return the form of a model, by the ways in which files have its numbers."""
    layout = Layout(
        models=models,
        size=_SIZES,
        poses=(PoseMatrix(_STEREO, "T_c_b"),),
        harmless="^(rectification|projection)matrix$",
    )
    return OpenCV(name, programs, marks=(K,), layout=layout, writing=Writing(constant=constant or {}))


_COEFFICIENTS = distortion(D, optional=True)
_FISHEYE_COEFFICIENTS = array(D, *FISHEYE4, 0, counts=(4, 5))
OPENCV = _form(
    "opencv",
    "OpenCV's samples, numpy archives, scripts: K and D in any spelling",
    Model("pinhole", (array(K, *UPRIGHT), _COEFFICIENTS)),
    Model("pinhole", (_FOUR, _COEFFICIENTS), read_only=True),
    constant={"fisheye_model": 0},
)
FISHEYE = _form(
    "opencv-fisheye",
    "the same of cv2.fisheye",
    Model("kannala-brandt", (array(K, *_SKEWED), _FISHEYE_COEFFICIENTS)),
    Model("kannala-brandt", (_FOUR, _FISHEYE_COEFFICIENTS), read_only=True),
    constant={"fisheye_model": 1},
)
OMNIDIR = _form(
    "opencv-omnidir",
    "the same of cv2.omnidir",
    Model("unified", (array(K, *_SKEWED), scalar("xi", "xi"), array(D, *RADTAN4))),
)


def _binned(node: Node, lens: LensNumbers) -> LensNumbers:
    """Crop to the region of interest, then bin: pixels of the sensor become those of the image."""
    values = dict(lens.values)
    width = _bin_axis(node, values, "x", "width", lens.width)
    height = _bin_axis(node, values, "y", "height", lens.height)
    node.take("roi.do_rectify", None)
    return lens._replace(values=values, width=width, height=height)


def _bin_axis(node: Node, values: Numbers, axis: str, side: str, full: int) -> int:
    """Change the focal length and the centre of one axis, px; return the size of the image along it, px.

    Args:
        node: of ``camera_info``.
        values: those of the lens, in pixels of the sensor, whose centres are at whole numbers.
        axis: x or y.
        side: ``width`` or ``height``.
        full: size of the sensor's image, px.
    """
    by = max(1, whole(f"binning_{axis}", node.take(f"binning_{axis}", 1) or 1))
    start = number("roi", node.take(f"roi.{axis}_offset", 0), least=0)
    part = int(number("roi", node.take(f"roi.{side}", 0), least=0)) or full
    if start + part > full:
        raise ArgumentError(f"roi: expected a part of the image of {full} px, got {start:.15g} + {part}")
    values[f"f{axis}"] /= by
    values[f"c{axis}"] = (values[f"c{axis}"] + 0.5 - start) / by - 0.5
    return part // by


_TURNED = ("rectification_matrix", "R", "rectification")
_PROJECTION = ("projection_matrix", "P", "projection")


class Ros(Form):
    """``camera_info``: the camera of the raw picture; and of the rectified one, where that is turned."""

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras of a file by name, and that of a rectified picture as ``NAME-rectified``.

        Args:
            content: the file.
            size: width and height of the images, px, where the file does not hold them.
        """
        entries = super().read(content, size)
        nodes = self.nodes(content)
        for name, node in nodes.items():
            turn = floats("rectification_matrix", node.take(_TURNED, []) or [])
            P = floats("projection_matrix", node.take(_PROJECTION, []) or [])
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


_MATRIX = array(K, *UPRIGHT)
_PLUMB_BOB = ("plumb_bob", "rational_polynomial")
_FISHEYE_D = array(D, *FISHEYE4)
ROS = Ros(
    "ros",
    "ROS 1 and 2: camera_info as file, .ini or print",
    marks=(
        K,
        (
            *("distortion_model", "rectification_matrix", "projection_matrix"),
            *("rectification", "projection", "P"),
        ),
    ),
    layout=Layout(
        models=(
            Model("pinhole", (_MATRIX, distortion(D, or_none=True)), _PLUMB_BOB),
            Model("pinhole", (_MATRIX, array(D, *RADTAN5, counts=(0, 5))), ("none",)),
            Model("kannala-brandt", (_MATRIX, _FISHEYE_D), ("equidistant",)),
            Model("pinhole", (_FOUR, distortion(D, or_none=True)), _PLUMB_BOB, read_only=True),
            Model("kannala-brandt", (_FOUR, _FISHEYE_D), ("equidistant",), read_only=True),
        ),
        word=(("distortion_model", "camera_model"),),
        size=_SIZES,
        harmless="^r(ectification(matrix)?)?$|^p(rojection(matrix)?)?$",
    ),
    reading=Reading(finish=_binned),
    writing=Writing(constant={"camera_name": "camera"}),
)


# -- arrays --------------------------------------------------------------------------------------------


def from_opencv(K: ArrayLike, D: ArrayLike, width: int, height: int) -> Camera:
    """Return the ``pinhole`` camera of ``cv2.projectPoints``'s K and D.

    Args:
        K: (3, 3), px, ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` with pixel centres at whole numbers:
            0.5 is added to cx and cy.
        D: 4, 5, 8, 12 or 14 numbers (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, 0, 0), as (N,), (N, 1)
            or (1, N).
        width: of the image, px; K and D do not hold it.
        height: of the image, px.
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
        width: of the image, px.
        height: of the image, px.
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
        width: of the image, px.
        height: of the image, px.
    """
    return _camera(OMNIDIR, width, height, K, D, xi=np.squeeze(np.asarray(xi, dtype=object)).tolist())


def to_opencv_omnidir(camera: Camera) -> tuple[Floats, float, Floats]:
    """Return K (3, 3), xi and D (4,) for ``cv2.omnidir``; 0.5 is taken from the principal point."""
    K, D, values = _arrays(OMNIDIR, camera)
    return K, values["xi"], D


def _camera(form: Form, width: int, height: int, K: ArrayLike, D: ArrayLike, **more: Any) -> Camera:
    """Return the camera of arrays by a form; ``more`` are other keys of its values."""
    arrays = {"K": np.asarray(K, dtype=object).tolist(), "D": np.asarray(D, dtype=object).tolist()}
    if len(floats("K", arrays["K"])) != 9:
        raise ArgumentError(f"K: expected 3 x 3 finite numbers, got {shown(K)}")
    model, values = form.model(Node(arrays | more), ())
    return form.camera(model, LensNumbers(values, width, height))


def _arrays(form: Form, camera: Camera) -> tuple[Floats, Floats, Numbers]:
    """Return K (3, 3), D, and all numbers of a camera by a form."""
    model, values = form.numbers_of(camera)
    matrix, *_, terms = model.keys  # unified has xi between them
    return np.reshape(matrix.write(values), (3, 3)), np.array(terms.write(values)), values
