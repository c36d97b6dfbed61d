"""Calibration files that users already have, read and written: OpenCV fisheye, Kalibr, COLMAP, OCamCalib.

Each format's file says what it carries, and its half pixel against ours (our pixel centres are at .5).
A format that cannot carry a camera raises ``ArgumentError``; nothing is approximated silently.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from omniscv.calibration.colmap import PARAMETER_COUNTS, read_colmap, write_colmap
from omniscv.calibration.kalibr import read_kalibr, write_kalibr
from omniscv.calibration.ocamcalib import read_ocamcalib, write_ocamcalib
from omniscv.calibration.opencv import (
    from_opencv_fisheye,
    read_opencv_fisheye,
    to_opencv_fisheye,
    write_opencv_fisheye,
)
from omniscv.calibration.parsing import within
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError

__all__ = [
    "formats",
    "from_opencv_fisheye",
    "load",
    "read_colmap",
    "read_kalibr",
    "read_ocamcalib",
    "read_opencv_fisheye",
    "save",
    "to_opencv_fisheye",
    "write_colmap",
    "write_kalibr",
    "write_ocamcalib",
    "write_opencv_fisheye",
]


class _Format(NamedTuple):
    mark: re.Pattern[str]
    """What only this format's files have in them."""
    read: Callable[[str], dict[str, Camera]]
    write: Callable[[Mapping[str, Camera]], str]


_FORMATS = {
    # Without fisheye_model, four coefficients may as well be the plain model's: not told by content.
    "opencv-fisheye": _Format(
        re.compile(r'^[ \t]*"?fisheye_model"?[ \t]*:', re.MULTILINE),
        read_opencv_fisheye,
        write_opencv_fisheye,
    ),
    "kalibr": _Format(re.compile(r"^[ \t]*camera_model[ \t]*:", re.MULTILINE), read_kalibr, write_kalibr),
    "colmap": _Format(
        re.compile(rf"^[ \t]*\d+[ \t]+({'|'.join(PARAMETER_COUNTS)})[ \t]", re.MULTILINE),
        read_colmap,
        write_colmap,
    ),
    "ocamcalib": _Format(
        re.compile(r"^#[ \t]*polynomial coefficients", re.MULTILINE), read_ocamcalib, write_ocamcalib
    ),
}


def formats() -> list[str]:
    """The names of the formats."""
    return list(_FORMATS)


def load(path: str | PathLike[str], format: str | None = None) -> dict[str, Camera]:
    """The cameras of a calibration file, by name.

    COLMAP's are named by their ids, Kalibr's ``cam0``, ``cam1``, ...; the one camera of the other formats
    is ``cam0``.

    Args:
        path: the file.
        format: one of :func:`formats`; told by the file's content if not given.

    Raises:
        ArgumentError: the file cannot be read, its format cannot be told, or it is not what the format
            says; the message starts with the path.
    """
    with within(str(path)):
        try:
            text = Path(path).read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as cause:
            raise ArgumentError(f"expected a readable text file, got {cause}") from cause
        return _format(_told(text) if format is None else format).read(text)


def save(path: str | PathLike[str], cameras: Mapping[str, Camera], format: str) -> None:
    """Writes cameras as a calibration file.

    Args:
        path: the file, replaced if it exists.
        cameras: by name, at least one. Kalibr wants the names ``cam0``, ``cam1``, ...; COLMAP whole numbers;
            the other formats hold one camera and no name.
        format: one of :func:`formats`.

    Raises:
        ArgumentError: an unknown format, no camera, a camera or name that the format cannot carry, or a
            file that cannot be written; an existing file is then as it was.
    """
    writer = _format(format).write
    if not cameras:
        raise ArgumentError("cameras: expected at least one, got none")
    with within(str(path)):
        text = writer(cameras)
        try:
            Path(path).write_text(text, encoding="utf-8")
        except OSError as cause:
            raise ArgumentError(f"expected a file that can be written, got {cause}") from cause


def _format(name: str) -> _Format:
    if name not in _FORMATS:
        raise ArgumentError(f"format: expected one of {', '.join(_FORMATS)}; got {name!r}")
    return _FORMATS[name]


def _told(text: str) -> str:
    told = [name for name, format_ in _FORMATS.items() if format_.mark.search(text)]
    if len(told) != 1:
        raise ArgumentError(
            f"expected a file that looks like one of {', '.join(_FORMATS)}; it looks like "
            f"{' and '.join(told) or 'none of them'}: give format"
        )
    return told[0]
