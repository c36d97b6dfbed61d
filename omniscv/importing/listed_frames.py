"""Frames and poses that files list: nerfstudio's, the TUM RGB-D benchmark's, panoramas, tables of poses."""

import json
import unicodedata
from collections.abc import Collection, Iterator, Mapping
from functools import cache
from itertools import starmap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import number, shown, text, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory_columns import PER_M, Rows
from omniscv.geometry.trajectory_files import check_frame, read_poses, read_rows, read_trajectory
from omniscv.importing.conventions import Words
from omniscv.importing.lenses import Pinhole, Wide, of_file, of_values
from omniscv.importing.posed_frames import (
    Files,
    Frame,
    Options,
    Sequence,
    layer_lines,
    mode_of,
    pictures_in,
    with_layers,
)
from omniscv.pictures import foreign
from omniscv.pictures.photo_sphere import PhotoSphere, read_photo_sphere
from omniscv.storage.bounded import MOST_JSON_BYTES, decode_text, named_file, read_bytes

_DOWN = np.array([0.0, 0, -1])  # the axis y of a camera that turns by yaw alone, world frame
_LEVEL = 1e-6
_LATEST_S = 0.02  # between stamps of colour, depth and pose of the TUM benchmark

_TUM = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""By a word of the folder's name or of its lists: fx, fy, cx, cy of 640 x 480 px, centres at whole numbers;
distortion."""


def inside(folder: Path, name: str) -> Path:
    """Return the path in a ``folder`` of a ``name`` in a file, whose backslashes may be those of Windows."""
    if "\\" in name and not (folder / name).exists():
        name = name.replace("\\", "/")
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise ArgumentError(f"expected a file in the folder, got {shown(name)}")
    return named_file(folder, name)


def size_of(picture: Path, mode: str = "lit") -> tuple[int, int]:
    """Return the width and height of a ``picture``, px, which shows a ``mode``."""
    height, width = foreign.read(picture, mode).pixels.shape[:2]
    return width, height


def words_of(
    columns: Collection[str], axes: str, unit: str | float | None = None, inverse: bool = False
) -> Words:
    """Return what is said of poses in columns.

    Args:
        columns: their names; without those of a matrix or a quaternion they have angles.
        axes: a name of :func:`omniscv.geometry.trajectory_columns.axes_of`.
        unit: of positions, a word or metres; None for that of the axes.
        inverse: whether poses are from the world to the camera.
    """
    is_angles = not {"m0", "qw"} & {*columns}
    if unit is None:
        unit = "cm" if axes == "unreal" else "m"
    metres = 1 / PER_M[unit] if isinstance(unit, str) else unit
    return Words("body" if is_angles else axes, inverse, metres, quaternions="qw" in columns)


@cache
def poses_in(file: Path, keyed: bool, **options: Any) -> dict[str, Pose | None]:
    """Return the poses of a ``file`` by name, whose letters are composed, or number, if not ``keyed``.

    ``options`` are those of :func:`read_poses`.
    """
    if not file.exists():
        raise ArgumentError("expected a file of poses, got none")
    poses = read_poses(file, keyed=keyed, **options)
    composed = {unicodedata.normalize("NFC", name): poses[name] for name in poses}
    if len(composed) < len(poses):
        raise ArgumentError("expected names that differ in more than composed letters, got others")
    return composed


def named_pose(file: Path, names: list[str], **options: Any) -> Pose | None:
    """Return the pose of the first of some ``names`` that a ``file`` has; ``options`` as of `poses_in`."""
    with within(file.name):
        poses = poses_in(file, True, **options)
        composed = [unicodedata.normalize("NFC", name) for name in names]
        for name in composed:
            if name in poses:
                return poses[name]
        raise ArgumentError(f"expected a pose of {shown(composed[0])}, got those of {shown([*poses][:4])}")


class _Axes(NamedTuple):
    """What the rotations of poses turn, a line about it, and why it is refused, if it is."""

    frame: str
    line: str = ""
    refused: str = ""


def frame_of_poses(options: Options) -> _Axes:
    """Return what the rotations of ``--poses`` turn: the user's word, or ``body`` if they turn by yaw alone.

    Others, which ``body`` and ``camera`` read in two ways, are refused.
    """
    if options.poses is None:
        return _Axes("body")
    if options.frame is not None:
        return _Axes(options.frame)
    with within(options.poses.name):
        check_frame(options.poses, None)
        by_body = poses_in(options.poses, True, frame="body", unit=options.unit)
        by_camera = poses_in(options.poses, True, frame="camera", unit=options.unit)
        is_turned = False
        for name, pose in by_body.items():
            other = by_camera[name]
            if pose is None or other is None:
                continue
            is_turned |= bool(np.any(pose.R_w_c != other.R_w_c))
            if np.abs(pose.R_w_c[:, 1] - _DOWN).max() <= _LEVEL:
                continue
            expected = f"expected --frame, because the pose of {shown(name)} turns by more than yaw"
            body = f"--frame body (x ahead, z up) means {_angles(pose)}"
            camera = f"--frame camera (x right, z ahead) means {_angles(other)}"
            return _Axes("body", "", f"{options.poses.name}: {expected}: {body}, {camera}; got none")
    return _Axes("body", "poses turn by yaw alone: taken as --frame body" if is_turned else "")


def _angles(pose: Pose) -> str:
    yaw, pitch, roll = map(_rounded, pose.angles())
    return f"yaw {yaw:g}, pitch {pitch:g}, roll {roll:g} (left, up and right side down +)"


def _rounded(angle: float) -> float:
    return round(angle, 2) + 0.0  # no negative zero


def _transforms(folder: Path) -> list[dict[str, Any]]:
    """Return the documents of ``transforms.json``, or of those of a train and a test split."""
    from omniscv.calibration.documents import Content  # slow to load

    files = sorted(folder.glob("transforms.json")) or sorted(folder.glob("transforms*.json"))
    documents: list[Any] = []
    for file in files:
        with within(file.name):
            content = Content(read_bytes(file, MOST_JSON_BYTES))
            first = content.values[0] if content.values else None
            if isinstance(first, list):
                raise ArgumentError(
                    "expected a mapping with the list 'frames', got a list; write {frames: [...]}"
                )
            if first is None or not isinstance(first.get("frames"), list):
                raise content.error or ArgumentError("expected a list 'frames', got none")
            if not all(isinstance(entry, dict) for entry in first["frames"]):
                raise ArgumentError(
                    "frames: expected mappings with file_path and transform_matrix, got others"
                )
            documents.append(content.values[0])
    return documents


def nerfstudio(folder: Path, options: Options) -> Sequence:
    """Return the frames of nerfstudio's transforms.json.

    ``folder`` is that of the file; ``options`` are of the user.
    """
    documents = _transforms(folder)
    rows: list[tuple[str, dict[str, Any]]] = []
    entries: list[tuple[dict[str, Any], dict[str, Any]]] = []  # document and frame
    for document in documents:
        for entry in document["frames"]:
            rows.append((f"frames[{len(rows)}]", {"transform_matrix": entry.get("transform_matrix")}))
            entries.append((document, entry))
    if not entries:
        raise ArgumentError("transforms.json: expected frames, got an empty list, or no file")
    poses = [Pose.from_angles((0, 0, 0))] * len(rows)
    if options.poses is None:
        poses = list(starmap(Pose, zip(*Rows.of_entries(rows).poses("opengl"), strict=True)))
    reader = _Nerfstudio(folder, options)
    frames: list[Frame] = []
    for i, (document, entry) in enumerate(entries):
        with within(f"frames[{i}]"):
            frames.append(reader.frame(document, entry, poses[i]))
    says: list[str] = []
    masked = sum(frame.mask is not None for frame in frames)
    if masked:
        says.append(f"{masked} frames are black, without label or surface, where masks are 0")
    says += layer_lines(reader.layers)
    for key in ("applied_transform", "applied_scale"):
        if key in documents[0]:
            says.append(f"{key} stays")
    return Sequence(frames, says=tuple(says), words=Words("opengl"))


class _Nerfstudio:
    """Reads the frames of a transforms.json; a lens that several frames have is read once.

    Attributes:
        layers: of each frame, what its file of colours has in layers.
    """

    def __init__(self, folder: Path, options: Options) -> None:
        self._folder = folder
        self._options = options
        self._lenses: dict[str, Pinhole | Wide | None] = {}
        self.layers: list[foreign.Parts] = []

    def frame(self, document: Mapping[str, Any], entry: Mapping[str, Any], pose: Pose) -> Frame:
        """Return the frame of an entry of a document, at a pose."""
        from omniscv.calibration.parts import lens_of_frame  # slow to load

        lit = inside(self._folder, text("file_path", entry.get("file_path")))
        if lit.suffix.lower() not in foreign.SUFFIXES:
            lit = lit.with_name(lit.name + ".png")
        depth = entry.get("depth_file_path") or entry.get("depth_path")
        mask = entry.get("mask_path")
        values = lens_of_frame(document, entry)
        lens = self._lens(values, lit)
        is_float = depth is None or str(depth).lower().endswith((".npy", ".exr"))
        unit = "m" if is_float else _depth_unit(values)
        paths = {"lit": lit}
        if depth:
            paths["depth"] = inside(self._folder, depth)
        hidden = inside(self._folder, mask) if mask else None
        paths, parts = with_layers(paths)
        self.layers.append(parts)
        holds = {"depth": Files(kind="planar" if lens else "ray", unit=unit)}
        return Frame(paths, pose, lens, holds, hidden)

    def _lens(self, values: Mapping[str, Any], lit: Path) -> Pinhole | Wide | None:
        """Return the lens of values, or of the user's file; of the size of the picture if it has none."""
        from omniscv.calibration.nodes import Node  # slow to load

        key = json.dumps(values)
        if key not in self._lenses:
            file = self._options.intrinsics
            if file:
                Node(values).check_acting("nerfstudio", ("pose", "unit", "time", "mask"))
                self._lenses[key] = of_file(file, size_of(lit))
            else:
                size = (0, 0) if {"w", "h"} <= values.keys() else size_of(lit)
                self._lenses[key] = of_values(values, "nerfstudio", size)
        return self._lenses[key]


def _depth_unit(values: Mapping[str, Any]) -> str:
    """Return the unit of depth in whole numbers: ``integer_depth_scale`` metres of one, else mm."""
    scale = number("integer_depth_scale", values.get("integer_depth_scale", 0.001), above=0)
    return "mm" if scale == 0.001 else f"{scale!r}/1"


def tum(folder: Path, options: Options) -> Sequence:
    """Return the frames of a sequence of the TUM RGB-D benchmark: those with a pose, by their stamps.

    ``folder`` is that of the sequence; ``options`` are of the user.
    """
    truth = read_trajectory(folder / "groundtruth.txt")
    pose_times = np.array(truth.seconds)
    depth_times, depths = _stamped(folder / "depth.txt")
    times, colors = _stamped(folder / "rgb.txt")
    says: list[str] = []
    lens: Pinhole | Wide | None
    if options.intrinsics:
        lens = of_file(options.intrinsics, size_of(inside(folder, colors[0])))
    else:
        word, lens = _tum_lens(folder)
        says.append(f"lens of {word}")
    frames = []
    for time, name in zip(times, colors, strict=True):
        i = int(np.abs(pose_times - time).argmin())
        j = int(np.abs(depth_times - time).argmin())
        if abs(pose_times[i] - time) > _LATEST_S:
            continue
        paths = {"lit": inside(folder, name)}
        if abs(depth_times[j] - time) <= _LATEST_S:
            paths["depth"] = inside(folder, depths[j])
        frames.append(Frame(paths, truth[i], lens, {"depth": Files(unit="1/5000")}))
    if late := len(colors) - len(frames):
        says.append(f"{late} pictures left out: no pose within {_LATEST_S} s")
    return Sequence(frames, says=tuple(says), words=Words(quaternions=True))


def _tum_lens(folder: Path) -> tuple[str, Pinhole]:
    """Return the word and the lens of the benchmark's camera that a folder, or its list, is named after."""
    start = decode_text(read_bytes(folder / "rgb.txt", MOST_JSON_BYTES), "replace")[:1000]
    for word, (fx, fy, cx, cy, *distortion) in _TUM.items():
        if word in folder.absolute().name or word in start:
            return word, Pinhole(fx, fy, cx + 0.5, cy + 0.5, 640, 480, tuple(distortion))
    expected = "expected --intrinsics FILE, a lens file, or a folder of the benchmark's freiburg1, 2 or 3"
    raise ArgumentError(f"{expected}, whose lens is known; got {shown(folder.name)}")


def _stamped(file: Path) -> tuple[Array, list[str]]:
    """Return the times, seconds, and the names of files of a list of the TUM benchmark."""
    with within(file.name):
        lines = decode_text(read_bytes(file, MOST_JSON_BYTES), "replace").splitlines()
        rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
        if not rows or {*map(len, rows)} != {2}:
            raise ArgumentError("expected lines of a time and a name, got others or none")
        times = []
        names = []
        for time, name in rows:
            times.append(number("time", time))
            names.append(name)
        return np.array(times), names


def is_panoramas(path: Path) -> bool:
    """Return whether the first picture of colours or masks is twice as wide as high."""
    for file in pictures_in(path):
        mode, _ = mode_of(file, path)
        if mode in ("lit", "object_mask"):
            width, height = size_of(file, mode)
            if width == 2 * height:
                return True
            with within(file.name):
                return read_photo_sphere(file) is not None
    return False


def _places_in(path: Path, options: Options) -> dict[tuple[str, ...], dict[str, Path]]:
    """Return the pictures by mode of each place, which has the words of their names that are no mode's."""
    places: dict[tuple[str, ...], dict[str, Path]] = {}
    for file in pictures_in(path, options):
        mode, words = mode_of(file, path)
        other = places.setdefault(words, {}).setdefault(mode, file)
        if other != file:
            raise ArgumentError(f"expected one of {mode} at a place, got {other.name} and {file.name}")
    return places


def panoramas(path: Path, options: Options, of_openexr: int = 0) -> Sequence:
    """Return panoramas, or pictures of a lens, by words in their names, at one place or those of a file.

    Args:
        path: of a picture, or of a folder of them.
        options: of the user.
        of_openexr: 1 if the first and the last column show one meridian, of OpenEXR's axes; else 0.
    """
    places = _places_in(path, options)
    lens = None
    if options.intrinsics:
        mode, file = next(iter(next(iter(places.values())).items()))
        lens = of_file(options.intrinsics, size_of(file, mode))
    _check_panoramas(options, len(places), has_lens=lens is not None)
    axes = frame_of_poses(options)
    if axes.refused and not any("depth" in files for files in places.values()):
        raise ArgumentError(axes.refused)  # with depth, pictures are asked first
    frames: list[Frame] = []
    layers: list[foreign.Parts] = []
    for words, files in places.items():
        files, parts = with_layers(files)
        layers.append(parts)
        pose = pose_of_place(options, axes.frame, files, path, words)
        spheres = {} if lens else _spheres(files)
        if "lit" in spheres and spheres["lit"].is_posed:
            pose = _turned(pose, spheres["lit"], options)
        files = {mode: files[mode] for mode in ("lit", "depth", "object_mask", "normals") if mode in files}
        holds = {"depth": Files(kind="planar" if lens else "ray")}
        frames.append(Frame(files, pose, lens, holds, spheres=spheres))
    says = [] if lens else ["resampled to six faces"]
    says += _lines_of_spheres(frames, options)
    if axes.line:
        says.append(axes.line)
    says += layer_lines(layers)
    poses = words_of(columns_in(options), axes.frame, options.unit)
    return Sequence(frames, says=tuple(says), of_openexr=of_openexr, words=poses, refused=axes.refused)


def _spheres(files: Mapping[str, Path]) -> dict[str, PhotoSphere]:
    """Return by mode what the pictures of a place say of their sphere: of depth and masks as of colours.

    Pictures of other modes that say nothing, and have another shape than the colours, are whole.
    """
    spheres: dict[str, PhotoSphere] = {}
    if "lit" not in files:
        return spheres
    with within(files["lit"].name):
        sphere = read_photo_sphere(files["lit"])
    if sphere is None:
        return spheres
    width, height = size_of(files["lit"])
    for mode, file in files.items():
        own_width, own_height = size_of(file, mode) if sphere.is_cropped else (width, height)
        if own_width * height == own_height * width:
            spheres[mode] = sphere
    return spheres


def _turned(pose: Pose, sphere: PhotoSphere, options: Options) -> Pose:
    """Return the pose of a panorama as it says that its camera was held; what the user says comes first."""
    if options.poses:
        return pose
    yaw_deg, pitch_deg, roll_deg = sphere.angles_deg
    if options.yaw_deg is not None:
        yaw_deg = options.yaw_deg
    return Pose.from_angles(pose.position, yaw_deg, pitch_deg, roll_deg)


def _lines_of_spheres(frames: list[Frame], options: Options) -> Iterator[str]:
    """Yield what was done by what panoramas say of their sphere, for people."""
    spheres = [frame.spheres["lit"] for frame in frames if "lit" in frame.spheres]
    posed = sum(sphere.is_posed for sphere in spheres)
    if posed and options.poses:
        yield f"{posed} pictures say how they were held: --poses comes first"
    elif posed:
        heading = "north is +X" if options.yaw_deg is None else "--yaw comes before their heading"
        yield f"{posed} pictures turned as they say they were held (Photo Sphere; {heading})"
    shares = [sphere.share for sphere in spheres if sphere.is_cropped]
    if shares:
        shown_share = f"{100 * min(shares):.3g} % or more of their spheres"
        yield f"{len(shares)} pictures show {shown_share}; elsewhere they are black, without label or surface"


def _check_panoramas(options: Options, place_count: int, has_lens: bool) -> None:
    """Raise ArgumentError for options that do not fit together, or to so many places."""
    if options.depth and not options.depth.ray and not has_lens:
        raise ArgumentError("depth: expected ray-UNIT of panoramas, which have no optical axis, got planar")
    if place_count > 1 and not options.poses:
        raise ArgumentError(f"expected --poses FILE, or panoramas of one place, got {place_count} places")
    if options.poses and options.pose:
        raise ArgumentError("expected --poses, or --position and --yaw; got both")


def pose_of_place(
    options: Options, axes: str, files: Mapping[str, Path], folder: Path, words: tuple[str, ...] = ()
) -> Pose:
    """Return the pose of pictures in the user's file, by their names; without a file that of all.

    Args:
        options: of the user.
        axes: the frame of poses in the file.
        files: the pictures by mode.
        folder: of all pictures.
        words: in the names of the pictures, which may name a pose, too.

    Raises:
        ArgumentError: the file has no pose of these pictures.
    """
    pose = options.pose or Pose.from_angles((0, 0, 0))
    if not options.poses:
        return pose
    names: list[str] = []
    for file in files.values():
        if file.is_relative_to(folder):
            names.append(file.relative_to(folder).as_posix())
        names += (file.name, file.stem)
    names.append("_".join(words))
    return named_pose(options.poses, names, frame=axes, unit=options.unit) or pose


def columns_in(options: Options) -> Collection[str]:
    """Return the columns of ``--poses``; those of a matrix for JSON, or without a file.

    ``options`` are of the user.
    """
    if not options.poses or options.poses.suffix.lower() == ".json":
        return ("m0",)
    return read_rows(options.poses, keyed=True)[1].columns
