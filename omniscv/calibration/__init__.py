"""Calibration files that users already have, read and written: OpenCV fisheye, Kalibr, COLMAP, OCamCalib.

Each format's module describes what it carries, and its half pixel against ours (our pixel centres are at .5).
A format that cannot carry a camera raises ``ArgumentError``; nothing is approximated silently.
"""

import re
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Literal

from omniscv import yaml_text
from omniscv.arguments import one_of, within
from omniscv.calibration.colmap import NAMES, read_colmap, write_colmap
from omniscv.calibration.kalibr import read_kalibr, write_kalibr
from omniscv.calibration.ocamcalib import read_ocamcalib, write_ocamcalib
from omniscv.calibration.opencv import (
    from_opencv_fisheye,
    read_opencv_fisheye,
    to_opencv_fisheye,
    write_opencv_fisheye,
)
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

__all__ = [
    "FormatName",
    "RigFormat",
    "formats",
    "from_opencv_fisheye",
    "load",
    "load_rig",
    "read_colmap",
    "read_kalibr",
    "read_ocamcalib",
    "read_opencv_fisheye",
    "rig_from_colmap",
    "rig_from_kalibr",
    "rig_to_colmap",
    "rig_to_kalibr",
    "save",
    "save_rig",
    "to_opencv_fisheye",
    "write_colmap",
    "write_kalibr",
    "write_ocamcalib",
    "write_opencv_fisheye",
]

FormatName = Literal["opencv-fisheye", "kalibr", "colmap", "ocamcalib"]


# What only files of the format contain, its reader and its writer.
_FORMATS: dict[str, tuple[str, Callable[[str], dict[str, Camera]], Callable[[Mapping[str, Camera]], str]]] = {
    # Without fisheye_model, four coefficients may be the plain model's: content does not decide.
    "opencv-fisheye": (r'^[ \t]*"?fisheye_model"?[ \t]*:', read_opencv_fisheye, write_opencv_fisheye),
    "kalibr": (r"^[ \t]*camera_model[ \t]*:", read_kalibr, write_kalibr),
    "colmap": (rf"^[ \t]*\d+[ \t]+({'|'.join(NAMES)})[ \t]", read_colmap, write_colmap),
    "ocamcalib": (r"^#[ \t]*polynomial coefficients", read_ocamcalib, write_ocamcalib),
}


def formats() -> list[str]:
    """Return the names of the formats."""
    return list(_FORMATS)


def load(path: str | PathLike[str], format: FormatName | None = None) -> dict[str, Camera]:
    """Return the cameras of a calibration file, by name.

    COLMAP's are named by their ids, Kalibr's ``cam0``, ``cam1``, ...; the one camera of the other formats
    is ``cam0``.

    Args:
        path: the file.
        format: one of :func:`formats`; recognised by the file's content if not given.

    Raises:
        ArgumentError: the file cannot be read, its format is not recognised, or it does not follow the
            format; the message starts with the path.
    """
    with within(path):
        text = yaml_text.read_text(Path(path))
        found = [name for name, (mark, *_) in _FORMATS.items() if re.search(mark, text, re.MULTILINE)]
        if format is None and len(found) != 1:
            raise ArgumentError(
                f"expected a file that looks like one of {', '.join(_FORMATS)}; it looks like "
                f"{' and '.join(found) or 'none of them'}: give format"
            )
        _, read, _ = _FORMATS[found[0] if format is None else one_of("format", format, _FORMATS)]
        return read(text)


def save(path: str | PathLike[str], cameras: Mapping[str, Camera], format: FormatName) -> None:
    """Write cameras as a calibration file.

    Args:
        path: the file, replaced if it exists.
        cameras: by name, at least one. Kalibr's names are ``cam0``, ``cam1``, ...; COLMAP whole numbers;
            the other formats hold one camera and no name.
        format: one of :func:`formats`.

    Raises:
        ArgumentError: an unknown format, no camera, a camera or name that the format cannot carry, or a
            file that cannot be written; an existing file is then as it was.
    """
    _, _, write = _FORMATS[one_of("format", format, _FORMATS)]
    if not cameras:
        raise ArgumentError("cameras: expected at least one, got none")
    with within(path):
        text = write(cameras)
        try:
            Path(path).write_text(text, encoding="utf-8")
        except OSError as cause:
            raise ArgumentError(f"expected a file that can be written, got {cause}") from cause
