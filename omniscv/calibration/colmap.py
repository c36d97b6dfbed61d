"""COLMAP's ``cameras.txt``: one line a camera, ``CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]``.

Half pixel: none to shift. COLMAP's top-left pixel has its centre at (0.5, 0.5), as ours.
Carried, by their params: ``PINHOLE`` (fx, fy, cx, cy) and ``SIMPLE_PINHOLE`` (f, cx, cy; read only) as
``pinhole``, or ``scaramuzza`` where fx and fy differ; ``OPENCV_FISHEYE`` (fx, fy, cx, cy, k1, k2, k3, k4) as
``kannala-brandt``; ``EQUIRECTANGULAR`` (width, height) as ``equirectangular``. Not carried: every
other model, a limit ``fov_deg``, a name that is no whole number. The camera frames agree: x right,
y down, z forward.
"""

from collections.abc import Mapping

from omniscv.arguments import numbers, one_of, shown, within
from omniscv.calibration.common import camera_of, intrinsics_of, whole_number
from omniscv.cameras import Camera, Equirectangular
from omniscv.errors import ArgumentError

PARAMETER_COUNTS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "OPENCV_FISHEYE": 8, "EQUIRECTANGULAR": 2}


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
            model, parameters = _parameters(camera)
        words = [camera_id, model, camera.width, camera.height, *map(float, parameters)]
        lines.append(" ".join(map(str, words)))
    return "\n".join(lines) + "\n"


def _camera(words: list[str]) -> tuple[str, Camera]:
    if len(words) < 4:
        raise ArgumentError(f"expected 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]', got {shown(' '.join(words))}")
    model = one_of("MODEL", words[1], PARAMETER_COUNTS)
    name = str(whole_number("CAMERA_ID", words[0]))
    width, height = whole_number("WIDTH", words[2]), whole_number("HEIGHT", words[3])
    parameters = numbers(f"PARAMS of {model}", words[4:], (PARAMETER_COUNTS[model],)).tolist()
    if model == "EQUIRECTANGULAR":
        if parameters != [width, height]:
            raise ArgumentError(
                f"PARAMS of EQUIRECTANGULAR: expected the image size {width} {height}, got {parameters}"
            )
        return name, Equirectangular(width, height)
    if model == "SIMPLE_PINHOLE":
        parameters = [parameters[0], *parameters]
    return name, camera_of(width, height, parameters)


def _parameters(camera: Camera) -> tuple[str, list[float]]:
    if isinstance(camera, Equirectangular):
        return "EQUIRECTANGULAR", [camera.width, camera.height]
    intrinsics = intrinsics_of(camera)
    if intrinsics is None:
        raise ArgumentError(f"COLMAP: expected pinhole, kannala-brandt or equirectangular, got {camera.name}")
    return "PINHOLE" if len(intrinsics) == 4 else "OPENCV_FISHEYE", intrinsics
