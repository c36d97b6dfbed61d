"""Load and save calibration files and rigs in any format, and our own JSON."""

import json
import re
from collections.abc import Callable, Mapping
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Literal, NamedTuple

from omniscv.arguments import one_of, within
from omniscv.calibration import aria, colmap, intrinsics, kalibr, nvidia, ocamcalib, opencv
from omniscv.cameras import Camera, from_dict
from omniscv.cameras.rig import Rig
from omniscv.errors import ArgumentError, StorageError
from omniscv.storage.bounded import read_text
from omniscv.storage.local import write_text

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
RigFormat = Literal["json", "kalibr", "colmap", "aria"]

_COLMAP_FILES = ("cameras.txt", "rigs.txt")


class _Format(NamedTuple):
    """A format: its test of a file's text, reader and writer."""

    recognises: Callable[[str], object]
    read: Callable[..., dict[str, Camera]]
    write: Callable[..., str]


def _opencv(model: str) -> _Format:
    def recognises(text: str) -> bool:
        return opencv.model_of(text) == model

    return _Format(recognises, partial(opencv.read, model), partial(opencv.write, model))


def _read_json(text: str) -> dict[str, Camera]:
    return {"cam0": from_dict(intrinsics.parse_mapping(text))}


def _write_json(cameras: Mapping[str, Camera]) -> str:
    with intrinsics.only_camera(cameras, "our JSON") as camera:
        return json.dumps(camera.to_dict(), indent=1)


def _matches(pattern: str) -> Callable[[str], object]:
    return re.compile(pattern, re.MULTILINE).search


_FORMATS: dict[str, _Format] = {
    "json": _Format(_matches(r'^[{\s]*"?model"?[ \t]*:'), _read_json, _write_json),
    "opencv": _opencv("opencv"),
    "opencv-fisheye": _opencv("opencv-fisheye"),
    "opencv-omnidir": _opencv("opencv-omnidir"),
    "kalibr": _Format(_matches(r"^[ \t]*camera_model[ \t]*:"), kalibr.read_kalibr, kalibr.write_kalibr),
    "colmap": _Format(
        _matches(rf"^[ \t]*\d+[ \t]+({'|'.join(colmap.NAMES)})[ \t]"), colmap.read_colmap, colmap.write_colmap
    ),
    "ocamcalib": _Format(
        _matches(r"^#[ \t]*polynomial coefficients"), ocamcalib.read_ocamcalib, ocamcalib.write_ocamcalib
    ),
    "aria": _Format(_matches(r'"CameraCalibrations"'), aria.read_aria, aria.write_aria),
    "isaac": _Format(nvidia.ATTRIBUTE.search, nvidia.read_isaac, nvidia.write_isaac),
    "ncore": _Format(_matches(r'"pixeldist_to_angle_poly"'), nvidia.read_ncore, nvidia.write_ncore),
}

_RIG_WRITERS: dict[str, Callable[[Rig], str]] = {
    "json": lambda rig: json.dumps(rig.to_dict(), indent=1),
    "kalibr": kalibr.rig_to_kalibr,
    "aria": aria.rig_to_aria,
}


def formats() -> list[str]:
    """Return the names of the formats."""
    return list(_FORMATS)


def load(
    path: str | PathLike[str], format: FormatName | None = None, size: tuple[int, int] | None = None
) -> dict[str, Camera]:
    """Return the cameras of a calibration file, by name.

    Names are COLMAP's ids, Kalibr's ``cam0``, ``cam1``, ..., Aria's labels and Isaac's prims; the one camera
    of the other formats is ``cam0``.

    Args:
        path: the file.
        format: one of :func:`formats`; recognised by the content if not given.
        size: width and height of the image, px, for files of OpenCV that do not hold them.

    Raises:
        ArgumentError: the file cannot be read, its format is not recognised, or it does not follow the
            format; the message starts with the path.
    """
    with within(path):
        return loads(read_text(Path(path)), format, size)


def loads(
    text: str, format: FormatName | None = None, size: tuple[int, int] | None = None
) -> dict[str, Camera]:
    """Return the cameras of a calibration file's text, as :func:`load`; ArgumentError for other text."""
    known = _format_of(text) if format is None else one_of("format", format, _FORMATS)
    if size is None:
        return _FORMATS[known].read(text)
    if not known.startswith("opencv"):
        raise ArgumentError(f"size: expected none, a file of {known} holds it; got {size[0]} x {size[1]}")
    return _FORMATS[known].read(text, size)


def _format_of(text: str) -> str:
    """Return the format that a file's content shows."""
    matches = [name for name, known in _FORMATS.items() if known.recognises(text)]
    if opencv.is_own_yaml(text):
        matches = [name for name in matches if name.startswith("opencv")]
    if len(matches) == 1:
        return matches[0]
    if opencv.model_of(text) == opencv.EITHER:
        raise ArgumentError(
            "expected coefficients of one model, got four, which may be of two: give format opencv "
            "(k1 k2 p1 p2 of the plain model) or opencv-fisheye (k1 k2 k3 k4), such as "
            "--set camera.format=opencv"
        )
    raise ArgumentError(
        f"expected a file that looks like one of {', '.join(_FORMATS)}; it looks like "
        f"{' and '.join(matches) or 'none of them'}: give format"
    )


def save(path: str | PathLike[str], cameras: Mapping[str, Camera], format: FormatName) -> None:
    """Write cameras as a calibration file.

    Args:
        path: the file, replaced if it exists; for OpenCV's formats the suffixes ``.xml`` and ``.json`` select
            the syntax.
        cameras: by name, at least one. Kalibr's names are ``cam0``, ``cam1``, ...; COLMAP's whole numbers;
            Aria's its labels; Isaac's are of prims; the other formats hold one camera and no name.
        format: one of :func:`formats`.

    Raises:
        ArgumentError: an unknown format, no camera, a camera or name that the format cannot carry, or a
            file that cannot be written; an existing file is then unchanged.
    """
    one_of("format", format, _FORMATS)
    with within(path):
        _write(Path(path), dumps(cameras, format, Path(path).suffix))


def dumps(cameras: Mapping[str, Camera], format: FormatName, suffix: str = "") -> str:
    """Return the text of a calibration file, as :func:`save` writes it.

    Args:
        cameras, format: as for :func:`save`.
        suffix: of the file's name, for OpenCV's formats.

    Raises:
        ArgumentError: an unknown format, no camera, a camera or name that the format cannot carry.
    """
    write = _FORMATS[one_of("format", format, _FORMATS)].write
    if not cameras:
        raise ArgumentError("cameras: expected at least one, got none")
    return write(cameras, suffix) if format.startswith("opencv") else write(cameras)


def load_rig(path: str | PathLike[str]) -> Rig:
    """Return the rig of a file or folder.

    Files are JSON (or YAML) as :meth:`Rig.to_dict` gives it, a chain of Kalibr, or the calibration of an Aria
    device. A folder holds COLMAP's ``cameras.txt`` and ``rigs.txt``.

    Raises:
        ArgumentError: the file cannot be read or is none of these; the message starts with the path.
    """
    path = Path(path)
    with within(path):
        if path.is_dir():
            return colmap.rig_from_colmap(*(read_text(path / name) for name in _COLMAP_FILES))
        text = read_text(path)
        data = intrinsics.parse_mapping(text)
        if "CameraCalibrations" in data:
            return aria.rig_from_aria(text)
        return Rig.from_dict(data) if "cameras" in data else kalibr.rig_from_kalibr(text)


def save_rig(path: str | PathLike[str], rig: Rig, format: RigFormat) -> None:
    """Write a rig as a file, or for ``colmap`` as two files in a folder, which is made if missing.

    Raises:
        ArgumentError: an unknown format, a rig that it cannot carry, or a file that cannot be written.
    """
    path = Path(path)
    with within(path):
        if one_of("format", format, (*_RIG_WRITERS, "colmap")) == "colmap":
            texts = dict(zip((path / name for name in _COLMAP_FILES), colmap.rig_to_colmap(rig), strict=True))
        else:
            texts = {path: _RIG_WRITERS[format](rig)}
        for file, text in texts.items():
            _write(file, text)


def _write(path: Path, text: str) -> None:
    try:
        write_text(path, text)
    except (OSError, StorageError) as cause:
        raise ArgumentError(f"expected a file that can be written, got {cause}") from cause
