"""Load and save calibration files and rigs in any form, and our own JSON."""

import json
import logging
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import one_of, shown, within
from omniscv.calibration import colmap, nvidia, opencv, table
from omniscv.calibration.documents import Content
from omniscv.calibration.fitting import Fit, fit
from omniscv.calibration.forms import Entry, Form, Layout, PoseMatrix
from omniscv.calibration.intrinsics import check_limits
from omniscv.calibration.kalibr import KALIBR
from omniscv.calibration.nodes import Node, Paths, alternatives, first_path, plain
from omniscv.calibration.ocamcalib import HUGIN, OCAMCALIB
from omniscv.cameras import Camera, from_dict, names
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError, StorageError
from omniscv.geometry import Pose
from omniscv.storage.bounded import MOST_JSON_BYTES, read_bytes, read_text
from omniscv.storage.local import write_text

_log = logging.getLogger("omniscv")
_COLMAP_FILES = ("cameras.txt", "rigs.txt")
_MARK = "omniscv"
_NO_RAY = 0.6  # share of the pixels without a ray that gets a warning: a circle in a wide picture has 0.56
_NEAREST = 3  # forms that a message lists


# -- our own JSON ---------------------------------------------------------------------------------------


def _own(content: Content) -> dict[str, Any] | None:
    """Return the document of our own JSON; a foreign one may have our keys, but for the mark."""
    document = content.values[0] if len(content.values) == 1 else None
    if not isinstance(document, dict):
        return None
    if _MARK in document or _is_rig(document.get("cameras")):
        return document
    ours = {"focal", "center", "skew", "distortion", "fov_deg"}
    is_own = document.get("model") in names() and (document["model"] != "pinhole" or ours & document.keys())
    return document if is_own or document.keys() == {"model", "width", "height"} else None


def _is_rig(cameras: object) -> bool:
    """Return whether a value is a mapping of cameras as :meth:`Rig.to_dict` gives it."""
    if not isinstance(cameras, dict):
        return False
    return all(isinstance(mount, dict) and "camera" in mount for mount in cameras.values())


def _plausible(entry: Entry) -> Entry:
    """Return a camera whose numbers a picture can have."""
    camera = entry.camera
    numbers = camera.lens.numbers(camera) if camera.lens else None
    if numbers:
        check_limits(numbers, max(camera.width, camera.height))
    return entry


class Own(Form):
    """Our own JSON, of a camera or a rig."""

    written = tuple(names())

    def is_of(self, content: Content) -> bool:
        """Return whether a file is our own JSON."""
        return _own(content) is not None

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras of a file by name, a single one as ``cam0``.

        Args:
            content: the file.
            size: does not matter: the file holds the size.

        Raises:
            ArgumentError: another form, or numbers that no picture can have.
        """
        document = _own(content)
        if document is None:
            raise content.error or ArgumentError("camera: expected 'model', got another file")
        values = dict(document)
        values.pop(_MARK, None)
        if str(document.get(_MARK, 1)) != "1":
            raise ArgumentError(f"{_MARK}: expected 1, got {shown(document[_MARK])}")
        if "cameras" in values:
            entries = {}
            for name, mount in Rig.from_dict(values).cameras.items():
                entries[name] = _plausible(Entry(mount.camera, mount.pose, mount.time_offset))
            return entries
        if _MARK not in document and {"fx", "cx", "center", "cy"} & values.keys():
            _log.warning(
                "no mark %r: 1 in the file: read as omniscv's own, whose pixel centres are at .5; "
                "add 0.5 to the centre where they were at whole numbers",
                _MARK,
            )
        return {"cam0": _plausible(Entry(from_dict(values)))}

    def write(self, cameras: Mapping[str, RigCamera], *, rig: bool = False, suffix: str = "") -> str:
        """Return the JSON of one camera, or of a rig.

        Args:
            cameras: by name.
            rig: whether they are written as a rig, with poses and time offsets.
            suffix: of the file's name, which does not matter.
        """
        if not rig and len(cameras) != 1:
            raise ArgumentError(f"cameras: json holds one camera, got {len(cameras)}: {shown(list(cameras))}")
        lens = Rig(cameras).to_dict() if rig else next(iter(cameras.values())).camera.to_dict()
        return json.dumps({_MARK: 1, **lens}, indent=1)


JSON = Own("json", "omniscv", marks=(_MARK,), layout=Layout(shift_px=0.0, poses=(PoseMatrix("", "T_b_c"),)))

_IN_ORDER = (
    JSON, table.CAMODOCAL, table.STELLA, table.ORB, table.SENSOR, KALIBR, opencv.ROS, table.GYROFLOW,
    table.OPENICC, table.NERFSTUDIO, table.KITTI, table.MIDDLEBURY, colmap.COLMAP, table.BASALT,
    table.WOODSCAPE, table.ARIA, table.NUSCENES, table.METASHAPE, table.OPENSFM, table.OPENMVG,
    table.ALICEVISION, table.DSO,
    table.ZED, HUGIN, OCAMCALIB, nvidia.ISAAC, nvidia.NCORE, table.OPEN3D, table.INTRINSICS,
    opencv.OPENCV, opencv.FISHEYE, opencv.OMNIDIR,
)  # fmt: skip
FORMS: dict[str, Form] = {form.name: form for form in _IN_ORDER}
"""In the order in which they are recognised: the first whose marks a file has."""


def formats() -> list[str]:
    """Return the names of the formats."""
    return list(FORMS)


# -- reading --------------------------------------------------------------------------------------------


class Loaded(NamedTuple):
    """A file that was read: the name of its format, and its cameras by name."""

    format: str
    entries: dict[str, Entry]

    @property
    def cameras(self) -> dict[str, Camera]:
        """The cameras without poses, by name."""
        return {name: entry.camera for name, entry in self.entries.items()}


def read(data: bytes | str, format: str | None = None, size: tuple[int, int] | None = None) -> Loaded:
    """Return the format and the cameras of a file.

    Args:
        data: the file's bytes or text.
        format: as for :func:`load`.
        size: as for :func:`load`.
    """
    content = Content(data)
    form = _form_of(content) if format is None else FORMS[one_of("format", format, FORMS)]
    return Loaded(form.name, form.read(content, size))


def read_values(
    values: Mapping[str, Any], format: str, size: tuple[int, int], shift_px: float | None = None
) -> Camera:
    """Return the camera of values that a file of a format would hold, as part of another file.

    Args:
        values: the camera's mapping.
        format: one of :func:`formats`.
        size: width and height of the image, px, where the values do not hold it.
        shift_px: what is added to the principal point to make it ours; None: that of the format.
    """
    form = FORMS[format]
    if shift_px is not None:
        form = replace(form, layout=replace(form.layout, shift_px=shift_px))
    node = Node(values)
    has_size = any(node.has(paths) for paths in form.layout.size)
    return form.entry(node, None if has_size else size).camera


def load(
    path: str | PathLike[str], format: str | None = None, size: tuple[int, int] | None = None
) -> dict[str, Camera]:
    """Return the cameras of a calibration file, by name.

    Names are those of the file, such as COLMAP's ids, Kalibr's ``cam0``, ``cam1``, ..., or Aria's labels; a
    camera without a name is ``cam0``.

    Args:
        path: the file.
        format: one of :func:`formats`; recognised by the content if not given.
        size: width and height of the image, px, for files that do not hold them.

    Raises:
        ArgumentError: the file cannot be read, its format is not recognised, or it does not follow the
            format; the message starts with the path.
    """
    cameras = load_file(path, format, size).cameras
    for name, camera in cameras.items():
        for doubt in doubts(camera):
            _log.warning("%s: %s: %s", path, name, doubt)
    return cameras


def load_file(
    path: str | PathLike[str], format: str | None = None, size: tuple[int, int] | None = None
) -> Loaded:
    """Return the format and cameras of a file, with poses and the keys that are ignored.

    Args:
        path: as for :func:`load`.
        format: as for :func:`load`.
        size: as for :func:`load`.
    """
    with within(path):
        return read(read_bytes(Path(path), MOST_JSON_BYTES), format, size)


def loads(
    text: str | bytes, format: str | None = None, size: tuple[int, int] | None = None
) -> dict[str, Camera]:
    """Return the cameras of a calibration file's text, by name; ArgumentError for other text.

    Args:
        text: what the file holds.
        format: as for :func:`load`.
        size: as for :func:`load`.
    """
    return read(text, format, size).cameras


def doubts(camera: Camera) -> list[str]:
    """Return what is odd about a camera of a file, in lines."""
    lines = []
    u, v = camera.center.tolist()
    if not (0 <= u <= camera.width and 0 <= v <= camera.height):
        image = f"the image of {camera.width} x {camera.height} px"
        lines.append(f"its centre ({u:.6g}, {v:.6g}) lies outside {image}")
    columns = np.linspace(0, camera.width, 66)[1:-1]
    rows = np.linspace(0, camera.height, 66)[1:-1]
    blind = 1 - float(camera.valid(np.stack(np.meshgrid(columns, rows), axis=-1)).mean())
    if blind > _NO_RAY:
        lines.append(f"{100 * blind:.3g} % of its pixels have no ray")
    return lines


def _form_of(content: Content) -> Form:
    """Return the first form whose marks a file has."""
    if content.is_binary and not content.values and not colmap.COLMAP.is_of(content):
        raise ArgumentError("expected a text file, numpy's archive or COLMAP's cameras.bin, got other bytes")
    for form in FORMS.values():
        if form.is_of(content):
            return form
    if content.error is not None and "once" in str(content.error):  # a key that is there twice
        raise content.error
    listed = _nearest(content)
    nearest = f"nearest are {', '.join(listed)}: give format" if listed else "none of their keys is in it"
    why = f" ({content.error.message})" if content.error is not None else ""
    raise ArgumentError(f"expected a calibration file, got none of a known form{why}; {nearest}")


def _nearest(content: Content) -> list[str]:
    """Return the forms of whose keys a file has most, as ``NAME (what it lacks)``."""
    keys: set[str] = set()
    for value in content.values:
        _collect_keys(value, keys)
    ranked = []
    for form in FORMS.values():
        if not form.layout.models:
            continue
        needed = [*form.marks]
        for key in form.layout.models[0].keys:
            if not key.optional:
                needed.append(key.paths)
        missing = [paths for paths in needed if not _last_words(paths) & keys]
        lacks = f"no {first_path(missing[0])}" if missing else "its keys stand elsewhere"
        if len(missing) < len(needed):
            ranked.append((len(missing) / len(needed), f"{form.name} ({lacks})"))
    ranked.sort(key=lambda row: row[0])
    return [text for _, text in ranked[:_NEAREST]]


def _collect_keys(value: Any, keys: set[str]) -> None:
    """Add the words of all keys of nested mappings and lists to ``keys``."""
    for key, below in value.items() if isinstance(value, Mapping) else enumerate(value):
        keys.update(plain(str(key)).split("."))
        if isinstance(below, Mapping | list):
            _collect_keys(below, keys)


def _last_words(paths: Paths) -> set[str]:
    """Return the plain last words of alternatives."""
    return {plain(path).rpartition(".")[2] for path in alternatives(paths)}


# -- writing --------------------------------------------------------------------------------------------


def save(path: str | PathLike[str], cameras: Mapping[str, Camera], format: str) -> None:
    """Write cameras as a calibration file.

    Args:
        path: the file, replaced if it exists; for OpenCV's formats the suffixes ``.xml`` and ``.json`` select
            the syntax.
        cameras: by name, at least one. Kalibr's names are ``cam0``, ``cam1``, ...; COLMAP's whole numbers;
            KITTI's ``00``, ``01``, ...; Isaac's are of prims; formats of one camera hold no name.
        format: one of :func:`formats`.

    Raises:
        ArgumentError: an unknown format, no camera, a camera or name that the format cannot carry, or a
            file that cannot be written; an existing file is then unchanged.
    """
    one_of("format", format, FORMS)
    with within(path):
        _write(Path(path), dumps(cameras, format, Path(path).suffix))


def dumps(cameras: Mapping[str, Camera], format: str, suffix: str = "") -> str:
    """Return the text of a calibration file, as :func:`save` writes it.

    Args:
        cameras: as for :func:`save`.
        format: as for :func:`save`.
        suffix: of the file's name, for OpenCV's formats.

    Raises:
        ArgumentError: as :func:`save`.
    """
    form = FORMS[one_of("format", format, FORMS)]
    if not cameras:
        raise ArgumentError("cameras: expected at least one, got none")
    return form.write({name: RigCamera(camera) for name, camera in cameras.items()}, suffix=suffix)


def nearest(camera: Camera, format: str) -> Fit | None:
    """Return the best fit of a camera by the models of a format; None where it carries the camera itself.

    Args:
        camera: a central one.
        format: one of :func:`formats` that is written.

    Raises:
        ArgumentError: none of the models can be fitted.
    """
    form = FORMS[one_of("format", format, FORMS)]
    name = form.writing.name_of("cam0")
    try:
        dumps({name: camera}, format)
        return None
    except ArgumentError as cause:
        fits = []
        for model in form.written:
            with suppress(ArgumentError):
                fitted = fit(camera, model)
                dumps({name: fitted.camera}, format)
                fits.append(fitted)
        if not fits:
            raise ArgumentError(f"{cause.message}; and none of its models can be fitted") from cause
        return max(fits, key=lambda fitted: (round(fitted.coverage, 3), -fitted.rms_px))


def load_rig(path: str | PathLike[str], size: tuple[int, int] | None = None) -> Rig:
    """Return the rig of a file or folder.

    Files are of any form that has poses, such as JSON (or YAML) as :meth:`Rig.to_dict` gives it, or a chain
    of Kalibr. A folder holds COLMAP's ``cameras.txt`` and ``rigs.txt``.

    Args:
        path: the file or folder.
        size: width and height of the images, px, for files that do not hold them.

    Raises:
        ArgumentError: the file cannot be read or holds no poses; the message starts with the path.
    """
    path = Path(path)
    with within(path):
        if path.is_dir():
            cameras = read_text(path / _COLMAP_FILES[0])
            rigs = read_text(path / _COLMAP_FILES[1])
            return colmap.rig_from_colmap(cameras, rigs)
        return loads_rig(read_bytes(path, MOST_JSON_BYTES), size)


def loads_rig(text: str | bytes, size: tuple[int, int] | None = None) -> Rig:
    """Return the rig of a file's text, as :func:`load_rig`.

    Args:
        text: what the file holds.
        size: as for :func:`load_rig`.
    """
    content = Content(text)
    form = _form_of(content)
    entries = form.read(content, size)
    if form.reading.stereo is not None:
        entries = form.reading.stereo(Node(content.values[0]), entries)
    mounts = {}
    for name, entry in entries.items():
        if entry.pose is None and len(entries) > 1:
            paths = " or ".join(first_path(pose.paths) for pose in form.layout.poses) or "none in this form"
            raise ArgumentError(f"{name}: expected the pose of every camera ({paths}), got none")
        mounts[re.sub(r"[^\w.-]+", "_", name).lstrip(".")] = entry.mounted
    return Rig(mounts)


def load_on_body(path: str | PathLike[str]) -> dict[str, Pose]:
    """Return the poses of a file's cameras on their body: by ``T_BS``, ``T_cam_imu``, or of a rig.

    Raises:
        ArgumentError: the file cannot be read, or a camera has no such pose.
    """
    with within(Path(path)):
        content = Content(read_bytes(Path(path), MOST_JSON_BYTES))
        entries = _form_of(content).on_body(content)
        missing = sorted(name for name, entry in entries.items() if entry.pose is None)
        if missing:
            raise ArgumentError(f"{missing[0]}: expected the pose on its body (T_BS, T_cam_imu), got none")
        return {name: entry.mounted.pose for name, entry in entries.items()}


def save_rig(path: str | PathLike[str], rig: Rig, format: str) -> None:
    """Write a rig as a file, or for ``colmap`` as two files in a folder, which is made if missing.

    Args:
        path: the file or folder; files that are there are replaced.
        rig: its cameras, named as the format asks.
        format: one of :func:`formats` that holds poses.

    Raises:
        ArgumentError: an unknown format, a rig that it cannot carry, or a file that cannot be written.
    """
    path = Path(path)
    with within(path):
        form = FORMS[one_of("format", format, FORMS)]
        if form is colmap.COLMAP:
            for name, text in zip(_COLMAP_FILES, colmap.rig_to_colmap(rig), strict=True):
                _write(path / name, text)
        else:
            _write(path, form.write(rig.cameras, rig=True))


def _write(path: Path, text: str) -> None:
    """Write a file, whole or not at all; ArgumentError where it cannot be written."""
    try:
        write_text(path, text)
    except (OSError, StorageError) as cause:
        raise ArgumentError(f"expected a file that can be written, got {cause}") from cause
