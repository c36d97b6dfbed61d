"""OpenCV's fisheye model: K and D as arrays, and the file that OpenCV's calibration sample writes.

Half pixel: OpenCV puts pixel centres at whole numbers, so its principal point is ours minus 0.5.
Carried: ``kannala-brandt``. Not carried: every other model, a limit ``fov_deg``, skew; the arrays
do not hold the image size either.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.calibration.intrinsics import Intrinsics, lens, of_lens
from omniscv.calibration.parsing import field, mapping, numbers, shown, whole_number, within
from omniscv.cameras import Camera
from omniscv.cameras.kannala_brandt import KannalaBrandt
from omniscv.errors import ArgumentError

CENTER_SHIFT_PX = 0.5
"""Added to a principal point of OpenCV's."""

_MATRIX_TAG = re.compile(r"!!opencv-(nd-)?matrix")


def from_opencv_fisheye(K: ArrayLike, D: ArrayLike, width: int, height: int) -> KannalaBrandt:
    """The ``kannala-brandt`` camera of ``cv2.fisheye``'s K and D.

    Args:
        K: (3, 3), px, ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` with pixel centres at whole numbers:
            0.5 is added to cx and cy.
        D: four numbers (k1, k2, k3, k4), as (4,), (4, 1) or (1, 4).
        width, height: image size, px; K and D do not hold it.

    Raises:
        ArgumentError: other shapes, numbers that are not finite, skew, or focal lengths not above 0.
    """
    K_flat = _flat("K", K, [(3, 3)])
    k = _flat("D", D, [(4,), (4, 1), (1, 4)])
    fx, skew, cx, zero, fy, cy, *last = K_flat
    if skew != 0 or zero != 0 or last != [0, 0, 1]:
        raise ArgumentError(f"K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {K_flat} (row by row)")
    return lens(width, height, Intrinsics(fx, fy, cx + CENTER_SHIFT_PX, cy + CENTER_SHIFT_PX), k)


def to_opencv_fisheye(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """K (3, 3) and D (4,) for ``cv2.fisheye``; 0.5 is taken from the principal point.

    OpenCV's ``projectPoints`` works on x / z, so it is right only for points with z > 0.

    Raises:
        ArgumentError: not a ``kannala-brandt`` camera, or one with a limit ``fov_deg``.
    """
    if not isinstance(camera, KannalaBrandt):
        raise ArgumentError(f"OpenCV fisheye: expected a camera kannala-brandt, got {camera.name}")
    (fx, fy, cx, cy), k = of_lens(camera)
    K = np.array([[fx, 0, cx - CENTER_SHIFT_PX], [0, fy, cy - CENTER_SHIFT_PX], [0, 0, 1]])
    return K, np.array(k)


def read_opencv_fisheye(text: str) -> dict[str, Camera]:
    """The camera, named ``cam0``, of a YAML or JSON file as OpenCV's calibration sample writes it.

    The keys are ``image_width``, ``image_height``, ``camera_matrix``, ``distortion_coefficients`` and
    ``fisheye_model``, which may be missing but not 0: the same file with four coefficients of the plain
    model means another lens.

    Raises:
        ArgumentError: a key is missing or holds something else, or as :func:`from_opencv_fisheye`.
    """
    body = "\n".join(line for line in text.splitlines() if not line.startswith("%YAML"))
    data = mapping(_MATRIX_TAG.sub("", body))
    is_fisheye = data.get("fisheye_model", 1)
    if is_fisheye != 1:
        raise ArgumentError(
            f"fisheye_model: expected 1, OpenCV's fisheye model, got {shown(is_fisheye)}; "
            "the plain model with its tangential terms is none of ours"
        )
    width, height = (whole_number(key, field(data, key)) for key in ("image_width", "image_height"))
    K = _matrix(data, "camera_matrix", 9)
    D = _matrix(data, "distortion_coefficients", 4)
    return {"cam0": from_opencv_fisheye(np.reshape(K, (3, 3)), D, width, height)}


def write_opencv_fisheye(cameras: Mapping[str, Camera]) -> str:
    """The YAML file of one camera, for ``cv2.FileStorage``; its name is not carried.

    Raises:
        ArgumentError: not exactly one camera, or as :func:`to_opencv_fisheye`.
    """
    if len(cameras) != 1:
        raise ArgumentError(f"OpenCV's file holds one camera, got {len(cameras)}: {shown(list(cameras))}")
    ((name, camera),) = cameras.items()
    with within(name):
        K, D = to_opencv_fisheye(camera)
    return "\n".join(
        [
            "%YAML:1.0",
            "---",
            f"image_width: {camera.width}",
            f"image_height: {camera.height}",
            "fisheye_model: 1",
            *_matrix_lines("camera_matrix", K),
            *_matrix_lines("distortion_coefficients", D.reshape(4, 1)),
            "",
        ]
    )


def _flat(key: str, value: ArrayLike, shapes: list[tuple[int, ...]]) -> list[float]:
    array = np.asarray(value, dtype=object)
    if array.shape not in shapes:
        raise ArgumentError(f"{key}: expected shape {' or '.join(map(str, shapes))}, got {array.shape}")
    return numbers(key, array.ravel().tolist(), array.size)


def _matrix(data: object, key: str, count: int) -> list[float]:
    matrix = field(data, key)
    with within(key):
        return numbers("data", field(matrix, "data"), count)


def _matrix_lines(key: str, matrix: NDArray[np.float64]) -> list[str]:
    rows, columns = matrix.shape
    return [
        f"{key}: !!opencv-matrix",
        f"   rows: {rows}",
        f"   cols: {columns}",
        "   dt: d",
        f"   data: [ {', '.join(map(repr, matrix.ravel().tolist()))} ]",
    ]
