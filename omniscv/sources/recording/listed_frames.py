"""Frames and poses that files list: nerfstudio's, the TUM RGB-D benchmark's, panoramas, tables of poses."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import number, one_of, shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory_columns import Rows
from omniscv.geometry.trajectory_files import read_poses, read_trajectory
from omniscv.pictures import foreign
from omniscv.sources.pictures import read_picture
from omniscv.sources.recording.posed_frames import (
    Files,
    Frame,
    Options,
    Pinhole,
    Sequence,
    mode_of,
    pictures_in,
)
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, read_bytes

_LATEST_S = 0.02  # between stamps of colour, depth and pose of the TUM benchmark

_TUM = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
    "": (525.0, 525.0, 319.5, 239.5),
}
"""By a word in the folder's name: fx, fy, cx, cy of 640 x 480 px, centres at whole numbers; distortion."""


def inside(folder: Path, name: str) -> Path:
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise ArgumentError(f"expected a file in the folder, got {shown(name)}")
    return folder / name


@cache
def poses_in(file: Path, keyed: bool, **options: Any) -> dict[str, Pose | None]:
    """Return the poses of a file by name or number; see :func:`read_poses`."""
    if not file.exists():
        raise ArgumentError("expected a file of poses, got none")
    return read_poses(file, keyed=keyed, **options)


def named_pose(file: Path, names: list[str], **options: Any) -> Pose | None:
    """Return the pose of the first of some names that a file has."""
    with within(file.name):
        poses = poses_in(file, True, **options)
        if (name := next((name for name in names if name in poses), None)) is None:
            raise ArgumentError(f"expected a pose of {shown(names[0])}, got those of {shown([*poses][:4])}")
        return poses[name]


def nerfstudio(folder: Path, options: Options) -> Sequence:
    """Return the frames of nerfstudio's transforms.json."""
    files = sorted(folder.glob("transforms.json")) or sorted(folder.glob("transforms*.json"))
    of_file = [parse_json(read_bytes(file, MOST_JSON_BYTES)) for file in files]
    frames, ignored = list[Frame](), 0
    entries = [(data, entry) for data in of_file for entry in data["frames"]]
    keys = [{"transform_matrix": {**data, **entry}["transform_matrix"]} for data, entry in entries]
    poses = Rows.of_entries([(f"frames[{i}]", key) for i, key in enumerate(keys)]).poses("opengl")
    for i, ((data, entry), *pose) in enumerate(zip(entries, *poses, strict=True)):
        with within(f"frames[{i}]"):
            values = {**data, **entry}
            lit = inside(folder, values["file_path"])
            depth = values.get("depth_file_path") or values.get("depth_path")
            paths = {
                "lit": lit if lit.suffix.lower() in foreign.SUFFIXES else lit.with_name(lit.name + ".png")
            }
            paths |= {"depth": inside(folder, depth)} if depth else {}
            lens = _nerfstudio_lens(values, paths["lit"])
            unit = "m" if str(depth).lower().endswith((".npy", ".exr")) else "mm"
            holds = {"depth": Files(kind="planar" if lens else "ray", unit=unit)}
            frames.append(Frame(paths, Pose(*pose), lens, holds))
            ignored += "mask_path" in values
    says = [f"masks of {ignored} frames are not taken: all pixels of captures count"] if ignored else []
    says += [f"{key} stays" for key in ("applied_transform", "applied_scale") if key in of_file[0]]
    return Sequence(frames, says=tuple(says))


def _nerfstudio_lens(values: dict[str, Any], lit: Path) -> Pinhole | None:
    """Return the lens of a frame; None for a panorama."""
    known = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "EQUIRECTANGULAR")
    if one_of("camera_model", values.get("camera_model", "OPENCV"), known) == "EQUIRECTANGULAR":
        return None
    bent = tuple(number(key, values.get(key, 0)) for key in ("k1", "k2", "p1", "p2", "k3"))
    if values.get("k4") or values.get("is_fisheye"):
        raise ArgumentError("expected a pinhole with k1, k2, p1, p2, k3, got k4 or is_fisheye")
    height, width = (values["h"], values["w"]) if "w" in values else read_picture(lit).pixels.shape[:2]
    if "fl_x" not in values:
        half = number("camera_angle_x", values["camera_angle_x"], above=0, below=3.1) / 2
        values["fl_x"] = width / 2 / np.tan(half)
    given = {"fl_y": values["fl_x"], "cx": width / 2, "cy": height / 2, **values, "w": width, "h": height}
    fx, fy, cx, cy, w, h = (
        number(key, given[key], above=0) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")
    )
    return Pinhole(fx, fy, cx, cy, w, h, bent if any(bent) else ())


def tum(folder: Path, options: Options) -> Sequence:
    """Return the frames of a sequence of the TUM RGB-D benchmark: those with a pose, by their stamps."""
    truth = read_trajectory(folder / "groundtruth.txt")
    poses, (depth_times, depths) = np.array(truth.times), _stamped(folder / "depth.txt")
    times, colors = _stamped(folder / "rgb.txt")
    word = next((word for word in _TUM if word and word in str(folder.absolute())), "")
    fx, fy, cx, cy, *bent = _TUM[word]
    lens, frames = Pinhole(fx, fy, cx + 0.5, cy + 0.5, 640, 480, tuple(bent)), []
    for time, name in zip(times, colors, strict=True):
        i, j = np.abs(poses - time).argmin(), np.abs(depth_times - time).argmin()
        if abs(poses[i] - time) <= _LATEST_S:
            paths = {"lit": inside(folder, name)}
            if abs(depth_times[j] - time) <= _LATEST_S:
                paths["depth"] = inside(folder, depths[j])
            frames.append(Frame(paths, truth[int(i)], lens, {"depth": Files(unit="1/5000")}))
    says = [f"lens of {word or 'ROS, as the folder is not named after freiburg1, 2 or 3'}"]
    if late := len(colors) - len(frames):
        says.append(f"{late} pictures left out: no pose within {_LATEST_S} s")
    return Sequence(frames, says=tuple(says))


def _stamped(file: Path) -> tuple[Array, list[str]]:
    """Return the times, seconds, and the names of files of a list of the TUM benchmark."""
    with within(file.name):
        lines = read_bytes(file, MOST_JSON_BYTES).decode("utf-8", "replace").splitlines()
        rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
        if not rows or {*map(len, rows)} != {2}:
            raise ArgumentError("expected lines of a time and a name, got others or none")
        return np.array([number("time", time) for time, _ in rows]), [name for _, name in rows]


def is_panoramas(path: Path) -> bool:
    """Return whether the first picture of colours or masks is twice as wide as high."""
    for file in pictures_in(path):
        if (mode := mode_of(file, path)[0]) in ("lit", "object_mask"):
            height, width = read_picture(file, mode, clip=True).pixels.shape[:2]
            return bool(width == 2 * height)
    return False


def panoramas(path: Path, options: Options, of_openexr: int = 0) -> Sequence:
    """Return panoramas by the words in their names, at one place or at those of a file."""
    places: dict[tuple[str, ...], dict[str, Path]] = {}
    for file in pictures_in(path):
        mode, words = mode_of(file, path)
        if (other := places.setdefault(words, {}).setdefault(mode, file)) != file:
            raise ArgumentError(f"expected one of {mode} at a place, got {other.name} and {file.name}")
    if options.depth and not options.depth.ray:
        raise ArgumentError("depth: expected ray-UNIT of panoramas, which have no optical axis, got planar")
    if len(places) > 1 and not options.poses:
        raise ArgumentError(f"expected --poses FILE, or panoramas of one place, got {len(places)} places")
    if options.poses and options.pose:
        raise ArgumentError("expected --poses, or --position and --yaw; got both")
    frames = list[Frame]()
    for words, files in places.items():
        names = [name for file in files.values() for name in (file.name, file.stem)]
        pose = options.pose or Pose.from_angles((0, 0, 0))
        if options.poses:
            said = {"frame": options.frame, "unit": options.unit}
            pose = named_pose(options.poses, [*names, "_".join(words)], **said) or pose
        files = {mode: files[mode] for mode in ("lit", "depth", "object_mask", "normals") if mode in files}
        frames.append(Frame(files, pose, None, {"depth": Files(kind="ray")}))
    return Sequence(frames, says=("resampled to six faces",), of_openexr=of_openexr)
