"""Calibration files that users already have: OpenCV, Kalibr, COLMAP, OCamCalib, Aria, Isaac Sim, NCore.

Each format's module describes what it carries, and its half pixel against ours (our pixel centres are at .5).
A format that cannot carry a camera raises ``ArgumentError``; nothing is approximated silently.
"""

import re
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Literal, NamedTuple

from omniscv.arguments import one_of, within
from omniscv.calibration import nvidia, opencv
from omniscv.calibration.aria import read_aria, rig_from_aria, rig_to_aria, write_aria
from omniscv.calibration.colmap import NAMES, read_colmap, write_colmap
from omniscv.calibration.fitting import Fit, fit
from omniscv.calibration.kalibr import read_kalibr, write_kalibr
from omniscv.calibration.nvidia import read_isaac, read_ncore, write_isaac, write_ncore
from omniscv.calibration.ocamcalib import read_ocamcalib, write_ocamcalib
from omniscv.calibration.opencv import (
    from_opencv,
    from_opencv_fisheye,
    from_opencv_omnidir,
    read_opencv,
    read_opencv_fisheye,
    read_opencv_omnidir,
    to_opencv,
    to_opencv_fisheye,
    to_opencv_omnidir,
    write_opencv,
    write_opencv_fisheye,
    write_opencv_omnidir,
)
from omniscv.calibration.own import read_json, write_json
from omniscv.calibration.rigs import (
    RigFormat,
    load_rig,
    rig_from_colmap,
    rig_from_kalibr,
    rig_to_colmap,
    rig_to_kalibr,
    save_rig,
)
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.storage import bounded

__all__ = [
    "Fit",
    "FormatName",
    "RigFormat",
    "fit",
    "formats",
    "from_opencv",
    "from_opencv_fisheye",
    "from_opencv_omnidir",
    "load",
    "load_rig",
    "read_aria",
    "read_colmap",
    "read_isaac",
    "read_json",
    "read_kalibr",
    "read_ncore",
    "read_ocamcalib",
    "read_opencv",
    "read_opencv_fisheye",
    "read_opencv_omnidir",
    "rig_from_aria",
    "rig_from_colmap",
    "rig_from_kalibr",
    "rig_to_aria",
    "rig_to_colmap",
    "rig_to_kalibr",
    "save",
    "save_rig",
    "to_opencv",
    "to_opencv_fisheye",
    "to_opencv_omnidir",
    "write_aria",
    "write_colmap",
    "write_isaac",
    "write_json",
    "write_kalibr",
    "write_ncore",
    "write_ocamcalib",
    "write_opencv",
    "write_opencv_fisheye",
    "write_opencv_omnidir",
]

FormatName = Literal[
    "json",
    "opencv",
    "opencv-fisheye",
    "opencv-omnidir",
    "kalibr",
    "colmap",
    "ocamcalib",
    "aria",
    "isaac",
    "ncore",
]


class _Format(NamedTuple):
    """How a format is recognised by a file's text, read and written."""

    recognises: Callable[[str], object]
    read: Callable[[str], dict[str, Camera]]
    write: Callable[..., str]


def _marked(pattern: str) -> Callable[[str], object]:
    return re.compile(pattern, re.MULTILINE).search


def _opencv(name: str) -> Callable[[str], object]:
    return lambda text: opencv.model_of(text) == name


_FORMATS: dict[str, _Format] = {
    "json": _Format(_marked(r'^[{\s]*"?model"?[ \t]*:'), read_json, write_json),
    "opencv": _Format(_opencv("opencv"), read_opencv, write_opencv),
    "opencv-fisheye": _Format(_opencv("opencv-fisheye"), read_opencv_fisheye, write_opencv_fisheye),
    "opencv-omnidir": _Format(_opencv("opencv-omnidir"), read_opencv_omnidir, write_opencv_omnidir),
    "kalibr": _Format(_marked(r"^[ \t]*camera_model[ \t]*:"), read_kalibr, write_kalibr),
    "colmap": _Format(_marked(rf"^[ \t]*\d+[ \t]+({'|'.join(NAMES)})[ \t]"), read_colmap, write_colmap),
    "ocamcalib": _Format(_marked(r"^#[ \t]*polynomial coefficients"), read_ocamcalib, write_ocamcalib),
    "aria": _Format(_marked(r'"CameraCalibrations"'), read_aria, write_aria),
    "isaac": _Format(nvidia.looks_like_isaac, read_isaac, write_isaac),
    "ncore": _Format(_marked(r'"pixeldist_to_angle_poly"'), read_ncore, write_ncore),
}


def formats() -> list[str]:
    """Return the names of the formats."""
    return list(_FORMATS)


def load(path: str | PathLike[str], format: FormatName | None = None) -> dict[str, Camera]:
    """Return the cameras of a calibration file, by name.

    COLMAP's are named by their ids, Kalibr's ``cam0``, ``cam1``, ..., Aria's by their labels, Isaac's by
    their prims; the one camera of the other formats is ``cam0``.

    Args:
        path: the file.
        format: one of :func:`formats`; recognised by the file's content if not given.

    Raises:
        ArgumentError: the file cannot be read, its format is not recognised, or it does not follow the
            format; the message starts with the path.
    """
    with within(path):
        text = bounded.read_text(Path(path))
        found = [name for name, each in _FORMATS.items() if each.recognises(text)]
        if format is None and len(found) != 1:
            raise ArgumentError(
                f"expected a file that looks like one of {', '.join(_FORMATS)}; it looks like "
                f"{' and '.join(found) or 'none of them'}: give format"
            )
        return _FORMATS[found[0] if format is None else one_of("format", format, _FORMATS)].read(text)


def save(path: str | PathLike[str], cameras: Mapping[str, Camera], format: FormatName) -> None:
    """Write cameras as a calibration file.

    Args:
        path: the file, replaced if it exists; for OpenCV's formats ``.xml`` and ``.json`` decide on its form.
        cameras: by name, at least one. Kalibr's names are ``cam0``, ``cam1``, ...; COLMAP's whole numbers;
            Aria's its labels; Isaac's are of prims; the other formats hold one camera and no name.
        format: one of :func:`formats`.

    Raises:
        ArgumentError: an unknown format, no camera, a camera or name that the format cannot carry, or a
            file that cannot be written; an existing file is then as it was.
    """
    write = _FORMATS[one_of("format", format, _FORMATS)].write
    if not cameras:
        raise ArgumentError("cameras: expected at least one, got none")
    with within(path):
        named = {"suffix": Path(path).suffix} if format.startswith("opencv") else {}
        text = write(cameras, **named)
        try:
            Path(path).write_text(text, encoding="utf-8")
        except OSError as cause:
            raise ArgumentError(f"expected a file that can be written, got {cause}") from cause
