"""OpenCV's three models, as arrays and as the files that ``cv2.FileStorage`` writes: YAML, XML or JSON.

Half pixel: OpenCV puts pixel centres at whole numbers, so its principal point is ours minus 0.5. Carried:

``opencv``
    ``pinhole``: K and D of ``cv2.projectPoints``, 4, 5, 8 or 12 coefficients. K has no skew: OpenCV ignores
    it in this model. The last two of 14 coefficients tilt the sensor, which our model does not.
``opencv-fisheye``
    ``kannala-brandt``: K and D of ``cv2.fisheye``, skew in ``K[0, 1] = fx skew``, which its functions take as
    ``alpha``; and ``fisheye-equidistant`` without the circle in which it ends.
``opencv-omnidir``
    ``unified``: K, xi and D of ``cv2.omnidir``, skew in ``K[0, 1] = fx skew``; and ``fisheye-stereographic``
    without the circle in which it ends.

Not carried: every other model, a limit ``fov_deg``; the arrays do not hold the image size either.

The keys of files are ``image_width``, ``image_height``, ``camera_matrix``, ``distortion_coefficients`` and
``fisheye_model``, or ``xi`` of an omnidirectional camera. ``fisheye_model`` may be missing but not that of
the other model: four coefficients of it describe another lens. The keys of ROS's ``camera_info`` and ``K``,
``D``, ``width`` and ``height`` mean the same.

Source: OpenCV 5, calib3d; opencv_contrib, ccalib (omnidir.cpp); the files' keys are those of OpenCV's
calibration samples.
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import number, numbers, shown
from omniscv.calibration import intrinsics
from omniscv.calibration.intrinsics import HALF_PIXEL
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.records import checked, record

Floats = NDArray[np.float64]

_MODELS = intrinsics.format_models("""
opencv-4       pinhole        fx fy cx cy k1 k2 p1 p2
opencv-5       pinhole        fx fy cx cy k1 k2 p1 p2 k3
opencv-8       pinhole        fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
opencv-12      pinhole        fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4
opencv-fisheye kannala-brandt fx fy cx cy skew k1 k2 k3 k4
opencv-omnidir unified        fx fy cx cy skew k1 k2 p1 p2 xi
""")
_COUNTS = (4, 5, 8, 12)
_SUFFIXES = (".yml", ".yaml", ".xml", ".json")


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
    matrix = _matrix_numbers(K, skewed=False)
    values = _vector(D, None)
    if len(values) == 14 and values[12:] == [0, 0]:
        values = values[:12]
    if len(values) not in _COUNTS:
        got = f"{len(values)}: {shown(values)}"
        raise ArgumentError(f"D: expected 4, 5, 8 or 12 coefficients (and no tilt), got {got}")
    terms = _MODELS["opencv-12"].numbers[4:]
    return intrinsics.camera_of("pinhole", width, height, matrix | dict(zip(terms, values, strict=False)))


def to_opencv(camera: Camera) -> tuple[Floats, Floats]:
    """Return K (3, 3) and D (4, 5, 8 or 12) for ``cv2.projectPoints``; 0.5 is taken from the principal point.

    OpenCV projects points with z < 0 too, mirrored.
    """
    values = _values(camera, "pinhole", "OpenCV: expected a camera pinhole without skew")
    return _matrix(values), np.array(values[4:])


def from_opencv_fisheye(K: ArrayLike, D: ArrayLike, width: int, height: int) -> Camera:
    """Return the ``kannala-brandt`` camera of ``cv2.fisheye``'s K and D.

    Args:
        K: (3, 3), px, ``[[fx, fx skew, cx], [0, fy, cy], [0, 0, 1]]`` with pixel centres at whole numbers:
            0.5 is added to cx and cy.
        D: four numbers (k1, k2, k3, k4), as (4,), (4, 1) or (1, 4).
        width, height: image size, px; K and D do not hold it.
    """
    k = dict(zip(("k1", "k2", "k3", "k4"), _vector(D, 4), strict=True))
    return intrinsics.camera_of("kannala-brandt", width, height, _matrix_numbers(K) | k)


def to_opencv_fisheye(camera: Camera) -> tuple[Floats, Floats]:
    """Return K (3, 3) and D (4,) for ``cv2.fisheye``; 0.5 is taken from the principal point.

    OpenCV's ``projectPoints`` works on x / z, so it is right only for points with z > 0; it takes skew as
    its argument ``alpha``, ``K[0, 1] / K[0, 0]``.
    """
    values = _values(camera, "kannala-brandt", "OpenCV fisheye: expected a camera kannala-brandt")
    return _matrix(values, values[4]), np.array(values[5:])


def from_opencv_omnidir(K: ArrayLike, xi: float, D: ArrayLike, width: int, height: int) -> Camera:
    """Return the ``unified`` camera of ``cv2.omnidir``'s K, xi and D.

    Args:
        K: (3, 3) as :func:`from_opencv_fisheye` takes it.
        xi: no unit.
        D: four numbers (k1, k2, p1, p2), as (4,), (4, 1) or (1, 4).
        width, height: image size, px; the arrays do not hold it.
    """
    terms = dict(zip(("k1", "k2", "p1", "p2"), _vector(D, 4), strict=True))
    xi = number("xi", np.asarray(xi, dtype=object).item() if np.size(xi) == 1 else xi)
    return intrinsics.camera_of("unified", width, height, _matrix_numbers(K) | terms | {"xi": xi})


def to_opencv_omnidir(camera: Camera) -> tuple[Floats, float, Floats]:
    """Return K (3, 3), xi and D (4,) for ``cv2.omnidir``; 0.5 is taken from the principal point."""
    values = _values(camera, "unified", "OpenCV omnidir: expected a camera unified")
    return _matrix(values, values[4]), values[9], np.array(values[5:9])


def _matrix_numbers(K: ArrayLike, *, skewed: bool = True) -> dict[str, float]:
    rows = numbers("K", K, (3, 3)).tolist()
    (fx, s, cx), (_, fy, cy), _ = rows
    if rows != [[fx, s, cx], [0, fy, cy], [0, 0, 1]] or (s != 0 and not skewed) or fx == 0:
        expected = f"[[fx, {'fx skew' if skewed else '0'}, cx], [0, fy, cy], [0, 0, 1]]"
        raise ArgumentError(f"K: expected {expected}, got {rows}")
    return {"fx": fx, "fy": fy, "cx": cx + HALF_PIXEL, "cy": cy + HALF_PIXEL, "skew": s / fx}


def _vector(D: ArrayLike, count: int | None) -> list[float]:
    values: list[float] = numbers("D", np.squeeze(np.asarray(D, dtype=object)), (count,)).tolist()
    return values


def _values(camera: Camera, model: str, expected: str) -> list[float]:
    rows = [row for row in _MODELS.values() if row.model == model]
    return intrinsics.write_numbers(camera, rows, HALF_PIXEL, expected)[1]


def _matrix(values: list[float], skew: float = 0.0) -> Floats:
    fx, fy, cx, cy = values[:4]
    return np.array([[fx, fx * skew, cx], [0, fy, cy], [0, 0, 1]])


# -- files ---------------------------------------------------------------------------------------------


def read(model: str, text: str, size: tuple[int, int] | None = None) -> dict[str, Camera]:
    """Return the camera, ``cam0``, of a file of one of the three models.

    Args:
        model: ``opencv``, ``opencv-fisheye`` or ``opencv-omnidir``.
        text: of the file.
        size: width and height, px, for a file that does not hold them.
    """
    file = _parsed(text, size, {"opencv": 0, "opencv-fisheye": 1}.get(model))
    if model == "opencv":
        return {"cam0": from_opencv(file.camera_matrix, file.coefficients, *file.size)}
    if model == "opencv-fisheye":
        return {"cam0": from_opencv_fisheye(file.camera_matrix, file.four(), *file.size)}
    if file.xi is None:
        raise ArgumentError("missing key 'xi'")
    return {"cam0": from_opencv_omnidir(file.camera_matrix, file.xi, file.four(), *file.size)}


def write(model: str, cameras: Mapping[str, Camera], suffix: str = ".yml") -> str:
    """Return the file of one camera, for ``cv2.FileStorage``; its name is not carried.

    Args:
        model: as for :func:`read`.
        cameras: one, by name.
        suffix: ``.yml``, ``.xml`` or ``.json``.
    """
    with intrinsics.only_camera(cameras, "OpenCV") as camera:
        if model == "opencv":
            K, D = to_opencv(camera)
            values = {"fisheye_model": 0, "camera_matrix": K, _D: D.reshape(-1, 1)}
        elif model == "opencv-fisheye":
            K, D = to_opencv_fisheye(camera)
            values = {"fisheye_model": 1, "camera_matrix": K, _D: D.reshape(4, 1)}
        else:
            K, xi, D = to_opencv_omnidir(camera)
            values = {"camera_matrix": K, _D: D.reshape(1, 4), "xi": xi}
    return _dump(camera, values, suffix)


@lru_cache(maxsize=1)  # three formats are recognised by it
def model_of(text: str) -> str | None:
    """Return which of the three formats a file has, also as ROS's ``camera_info`` or as bare ``K`` and ``D``.

    ``EITHER`` for four coefficients without a key that says which model they belong to; None for other files.
    """
    if not _HAS_MATRIX.search(text):
        return None
    try:
        values = _values_of(text)
        count = len(_data(_D, values.get(_D)))
    except ArgumentError:
        return None
    if "xi" in values:
        return "opencv-omnidir"
    if (flag := str(values.get("fisheye_model"))) in ("0", "1"):
        return "opencv-fisheye" if flag == "1" else "opencv"
    if any(values.get(key) in _FISHEYES for key in ("distortion_model", "camera_model", "model")):
        return "opencv-fisheye"
    return EITHER if count == 4 and "distortion_model" not in values else "opencv"


def is_own_yaml(text: str) -> bool:
    """Return whether a text has what only OpenCV writes into YAML: its first line, or tags of matrices."""
    return _NOT_YAML.search(text) is not None


EITHER = "opencv or opencv-fisheye"

_D = "distortion_coefficients"
_NOT_YAML = re.compile(r"^%YAML.*|!!opencv-(nd-)?matrix", re.MULTILINE)
_HAS_MATRIX = re.compile(r"""\bcamera_?[mM]atrix\b|^[ \t{]*["']?[Kk]["']?[ \t]*:""", re.MULTILINE)
_MODEL_NAMES = ("the plain model", "OpenCV's fisheye model")
_FISHEYES = ("equidistant", "fisheye")
_OTHER_KEYS = {
    **dict.fromkeys(("K", "k", "cameraMatrix"), "camera_matrix"),
    **dict.fromkeys(("D", "d", "distCoeffs", "dist_coeffs"), _D),
    **{"width": "image_width", "height": "image_height"},
}
_MOST_ROWS = 14


def _data(name: str, value: object, count: int | None = None) -> Floats:
    """Return the numbers of a matrix: its ``data``, a list, or words in XML; or a list of them or of rows."""
    if isinstance(value, dict):
        if "data" not in value:
            raise ArgumentError(f"{name}: missing key 'data'")
        name, value = f"{name}: data", value["data"]
    if isinstance(value, str):
        value = value.split()
    if isinstance(value, list) and len(value) <= _MOST_ROWS and all(isinstance(row, list) for row in value):
        value = [item for row in value for item in row]
    return numbers(name, value, (count,))


def _scalar(name: str, value: object) -> float:
    return float(_data(name, value, 1)[0]) if isinstance(value, dict) else number(name, value)


@record(eq=False)
class _File:
    """The keys of ``cv2.FileStorage`` that describe a camera."""

    image_width: int = checked(intrinsics.whole_number)
    image_height: int = checked(intrinsics.whole_number)
    camera_matrix: Floats = checked(lambda name, value: _data(name, value, 9).reshape(3, 3))
    coefficients: Floats = checked(_data, key=_D)
    fisheye_model: Any = None
    xi: float | None = checked(_scalar, default=None)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.image_width, self.image_height

    def four(self) -> Floats:
        """Return the coefficients of a model that has four; ArgumentError for another number."""
        return numbers(f"{_D}: data", self.coefficients, (4,))


def _values_of(text: str) -> dict[str, Any]:
    xml = text.lstrip("\ufeff \t\r\n").startswith("<")
    values = _from_xml(text) if xml else intrinsics.parse_mapping(_NOT_YAML.sub("", text))
    return {_OTHER_KEYS.get(key, key): value for key, value in values.items()}


def _parsed(text: str, size: tuple[int, int] | None, fisheye: int | None = None) -> _File:
    values = _values_of(text)
    if size is not None:
        known = values.get("image_width", size[0]), values.get("image_height", size[1])
        if tuple(map(str, known)) != tuple(map(str, size)):
            raise ArgumentError(
                f"size: expected {shown(known[0])} x {shown(known[1])}, got {size[0]} x {size[1]}"
            )
        values |= {"image_width": size[0], "image_height": size[1]}
    for key in ("image_width", "image_height"):
        if key not in values:
            raise ArgumentError(f"missing key {key!r}: add it, or give the size (--size)")
    file = intrinsics.read_known(_File, values)
    if fisheye is not None and file.fisheye_model not in (None, fisheye, str(fisheye)):
        raise ArgumentError(
            f"fisheye_model: expected {fisheye}, {_MODEL_NAMES[fisheye]}, got {shown(file.fisheye_model)}; "
            f"read the file as '{('opencv-fisheye', 'opencv')[fisheye]}'"
        )
    return file


def _from_xml(text: str) -> dict[str, Any]:
    """Return the values below the root of a file of ``cv2.FileStorage``: texts, or dicts of them."""
    from xml.etree import ElementTree

    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):  # entities can expand to gigabytes
        raise ArgumentError("expected XML without <!DOCTYPE or <!ENTITY, got one of them")
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
    except ElementTree.ParseError as cause:
        raise ArgumentError(f"expected XML, got {cause}") from cause
    return {node.tag: {child.tag: child.text for child in node} or node.text for node in root}


def _dump(camera: Camera, values: Mapping[str, Any], suffix: str) -> str:
    import cv2  # slow to load, and reading does without

    suffix = suffix if suffix in _SUFFIXES else ".yml"
    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for key, value in {"image_width": camera.width, "image_height": camera.height, **values}.items():
        storage.write(key, value)
    return str(storage.releaseAndGetString())
