"""OpenCV's fisheye model: K and D as arrays, and the file that OpenCV's calibration sample writes.

Half pixel: OpenCV puts pixel centres at whole numbers, so its principal point is ours minus 0.5.
Carried: ``kannala-brandt``. Not carried: every other model, a limit ``fov_deg``, skew; the arrays
do not hold the image size either.
"""

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import numbers, shown, within
from omniscv.calibration import common
from omniscv.calibration.common import HALF_PIXEL, field
from omniscv.cameras import Camera, KannalaBrandt
from omniscv.errors import ArgumentError

_NOT_YAML = re.compile(r"^%YAML.*|!!opencv-(nd-)?matrix", re.MULTILINE)


def from_opencv_fisheye(K: ArrayLike, D: ArrayLike, width: int, height: int) -> KannalaBrandt:
    """Return the ``kannala-brandt`` camera of ``cv2.fisheye``'s K and D.

    Args:
        K: (3, 3), px, ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` with pixel centres at whole numbers:
            0.5 is added to cx and cy.
        D: four numbers (k1, k2, k3, k4), as (4,), (4, 1) or (1, 4).
        width, height: image size, px; K and D do not hold it.

    Raises:
        ArgumentError: other shapes, numbers that are not finite, skew, or focal lengths not above 0.
    """
    rows = numbers("K", K, (3, 3)).tolist()
    k = numbers("D", np.squeeze(np.asarray(D, dtype=object)), (4,))
    (fx, _, cx), (_, fy, cy), _ = rows
    if rows != [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]:
        raise ArgumentError(f"K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {rows}")
    return KannalaBrandt(width, height, fx, fy, cx + HALF_PIXEL, cy + HALF_PIXEL, k)


def to_opencv_fisheye(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return K (3, 3) and D (4,) for ``cv2.fisheye``; 0.5 is taken from the principal point.

    OpenCV's ``projectPoints`` works on x / z, so it is right only for points with z > 0.

    Raises:
        ArgumentError: not a ``kannala-brandt`` camera, or one with a limit ``fov_deg``.
    """
    if not isinstance(camera, KannalaBrandt):
        raise ArgumentError(f"OpenCV fisheye: expected a camera kannala-brandt, got {camera.name}")
    common.refuse_limit(camera)
    cx, cy = camera.center - HALF_PIXEL
    return np.array([[camera.fx, 0, cx], [0, camera.fy, cy], [0, 0, 1]]), camera.k.copy()


def read_opencv_fisheye(text: str) -> dict[str, Camera]:
    """Return the camera, named ``cam0``, of a YAML or JSON file as OpenCV's calibration sample writes it.

    The keys are ``image_width``, ``image_height``, ``camera_matrix``, ``distortion_coefficients`` and
    ``fisheye_model``, which may be missing but not 0: the same file with four coefficients of the plain
    model means another lens.

    Raises:
        ArgumentError: a key is missing or holds something else, or as :func:`from_opencv_fisheye`.
    """
    data = common.mapping(_NOT_YAML.sub("", text))
    fisheye = data.get("fisheye_model", 1)
    if fisheye != 1:
        raise ArgumentError(
            f"fisheye_model: expected 1, OpenCV's fisheye model, got {shown(fisheye)}; "
            "no camera here has the tangential terms of the plain model"
        )
    width, height = (common.whole_number(key, field(data, key)) for key in ("image_width", "image_height"))
    matrices = []
    for key, count in (("camera_matrix", 9), ("distortion_coefficients", 4)):
        with within(key):
            matrices.append(numbers("data", field(field(data, key), "data"), (count,)))
    return {"cam0": from_opencv_fisheye(matrices[0].reshape(3, 3), matrices[1], width, height)}


def write_opencv_fisheye(cameras: Mapping[str, Camera]) -> str:
    """Return the YAML file of one camera, for ``cv2.FileStorage``; its name is not carried.

    Raises:
        ArgumentError: not exactly one camera, or as :func:`to_opencv_fisheye`.
    """
    name, camera = common.only_camera(cameras, "OpenCV")
    with within(name):
        K, D = to_opencv_fisheye(camera)
    import cv2  # slow to load, and reading does without

    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("fisheye_model", 1)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", D.reshape(4, 1))
    return str(storage.releaseAndGetString())
