"""Import frames with poses: a table of published layouts, and layouts of the user's own.

A layout is data: which files there are, what their numbers mean, where poses are, in which axes
(docs/capture-folders.md). nerfstudio's ``transforms.json`` and the TUM RGB-D benchmark list their frames.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from omniscv.arguments import flag, number, numbers, one_of, shown, text, within
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Array, Pose, cube_rotations
from omniscv.geometry.instant import turn_about_z
from omniscv.geometry.trajectory_files import read_trajectory
from omniscv.pictures import foreign
from omniscv.records import checked, mapping, nested, optional, read, record
from omniscv.sources import pictures
from omniscv.sources.base import ObjectTable
from omniscv.sources.pictures import read_picture
from omniscv.sources.recording.layouts import LAYOUTS
from omniscv.sources.recording.posed_frames import (
    Files,
    Frame,
    Options,
    Pinhole,
    Sequence,
    listed_numbers,
    mode_of,
    objects_of,
    pictures_in,
)
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, parse_yaml, read_bytes, read_text

PANORAMAS = {"latlong": 0, "openexr-latlong": 1}
"""Layouts of one picture 2:1. Of 1, the first and the last column show one meridian, of OpenEXR's axes."""
_FRONT = cube_rotations()[0][1]
_I, _GL = np.eye(3), np.diag([1.0, -1, -1])
_AXES = {
    "camera": (_I, _I),
    "opengl": (_I, _GL),
    "body": (_I, R_LEVEL),
    "ned": (_GL, np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])),
}
"""W and C of ``R_w_c = W R C``: from the file's world to ours, and from our camera to the file's."""
_SAME, _RIGID = 2e-3, 1e-3  # of a rotation's entries: poses have six digits or fewer
_SAME_PLACE_M = 1e-3
_LATEST_S = 0.02  # between stamps of colour, depth and pose of the TUM benchmark
_COLUMNS = ("x", "y", "z", "yaw", "pitch", "roll", "qx", "qy", "qz", "qw")

_LAYOUTS = Path(__file__).with_name("layouts.yaml")
_TUM = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
    "": (525.0, 525.0, 319.5, 239.5),
}
"""By a word in the folder's name: fx, fy, cx, cy of 640 x 480 px, centres at whole numbers; distortion."""


def _intrinsics(name: str, value: Any) -> Pinhole | None:
    if value is None or isinstance(value, Pinhole):
        return value
    keys = ("fx", "fy", "cx", "cy", "centers")
    given = {"centers": 0.5} | mapping(name, value, (*keys, "distortion"))
    fx, fy, cx, cy, center = (number(f"{name}.{key}", given.get(key)) for key in keys)
    bent = listed_numbers(name, given.get("distortion", ()))
    return Pinhole(fx, fy, cx + 0.5 - center, cy + 0.5 - center, distortion=bent)


def _files(name: str, value: Any, keys: tuple[str, ...] = ()) -> Any:
    given = {"file": value} if isinstance(value, str) else value
    return given if isinstance(given, Files) else read(Files, mapping(name, given, ("file", *keys)), name)


@record
class _Poses:
    """Where poses are: texts of numbers or JSON by frame, or a text with a row of each, by number or name."""

    file: str = checked(text)
    row: str = checked(text, default="")
    position: str = checked(text, default="")
    rotation: str = checked(text, default="")
    axes: str = checked(one_of, words=_AXES, default="camera")
    inverse: bool = checked(flag, default=False)
    unit: str = checked(one_of, words=pictures.PER_M, default="m")
    yaw_deg: float = checked(number, default=0.0)
    agrees: str = checked(text, default="")


@record
class Layout:
    """The keys of ``--layout my.yaml``."""

    pictures: str = checked(one_of, words=("latlong", "faces", "pinhole"))
    place: str = checked(text)
    lit: Files | None = checked(_files, default=None)
    depth: Files | None = checked(_files, keys=("kind", "unit", "missing"), default=None)
    object_mask: Files | None = checked(_files, keys=("ids", "names", "missing"), default=None)
    poses: _Poses | None = checked(nested(_Poses), default=None)
    position: Any = checked(optional(partial(numbers, shape=(3,))), default=None)
    intrinsics: Pinhole | None = checked(_intrinsics, default=None)
    faces: str = checked(one_of, words=LAYOUTS, default="top-bottom")
    found: str = checked(text, default="")
    says: str = checked(text, default="")


@cache
def _finders() -> dict[str, tuple[str, Callable[[Path, Options], Sequence]]]:
    """Return, by layout, the pattern of a file by which it is found, and its reader."""
    rows = {name: read(Layout, data, name) for name, data in parse_yaml(read_text(_LAYOUTS)).items()}
    rows["tartanair"] = replace(rows["tartanground"], found="image_?cam_front")
    finders: dict[str, Any] = {
        name: (row.found, partial(_of_layout, layout=row)) for name, row in rows.items()
    }
    finders |= {"nerfstudio": ("transforms*.json", _nerfstudio), "tum": ("rgb.txt", _tum)}
    return finders | {"latlong": ("", _panoramas), "openexr-latlong": ("", partial(_panoramas, of_openexr=1))}


def sequences() -> tuple[str, ...]:
    """Return the names of layouts of frames with poses, and of panoramas."""
    return tuple(_finders())


def find_sequence(path: Path, layout: str, options: Options) -> Sequence | None:
    """Return the frames of a folder, or of one panorama; None where it is none of these layouts.

    Args:
        path: of the folder or picture.
        layout: one of :func:`sequences`, ``auto`` for what lies there, or a file ``.yaml`` of a layout.
        options: of the user.

    Raises:
        ArgumentError: files of a layout without poses, or poses that contradict each other.
    """
    _poses_in.cache_clear()  # files may have changed since the last import
    find: Any = None
    if layout.endswith((".yaml", ".yml")):
        with within(layout):
            data = read_bytes(Path(layout), MOST_JSON_BYTES).decode("utf-8", "replace")
            find = partial(_of_layout, layout=read(Layout, parse_yaml(data)), strict=True)
        layout = Path(layout).stem
    elif layout == "auto":
        named = (name for name, (found, _) in _finders().items() if found and any(path.glob(found)))
        layout = next(named, "latlong" if _is_panoramas(path) else "")
    if find is None and layout not in _finders():
        return None
    try:
        sequence = (find or _finders()[layout][1])(path, options)
    except ArgumentError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, OSError, re.error) as cause:
        got = f"{type(cause).__name__} {shown(str(cause))}"
        raise ArgumentError(f"expected a folder of layout {layout}, got {got}") from cause
    if not sequence.modes:
        raise ArgumentError(f"expected pictures of layout {layout}, got none")
    said = {"position or yaw": options.pose, "poses": options.poses, "mirrored": options.mirrored}
    if given := [name for name, value in said.items() if value and layout not in PANORAMAS]:
        raise ArgumentError(f"{given[0]}: expected none, because layout {layout} says it")
    _share_places(sequence.frames)
    return replace(sequence, layout=layout, options=options)


def _share_places(frames: list[Frame]) -> None:
    """Move frames within a millimetre of an earlier one to its position."""
    positions = np.array([frame.pose.position for frame in frames])
    owner = list(range(len(frames)))
    for i, near in enumerate(KDTree(positions).query_ball_point(positions, _SAME_PLACE_M)):
        owner[i] = min((j for j in near if j < i and owner[j] == j), default=i)
    for frame, j in zip(frames, owner, strict=True):
        frame.pose = Pose(positions[j], frame.pose.R_w_c)


def _of_layout(folder: Path, options: Options, layout: Layout, strict: bool = False) -> Sequence:
    """Return the frames of a layout that is data; ``strict``: each mode must have files."""
    lens = Pinhole(1, 1, 1, 1, 2, 2) if layout.pictures == "faces" else layout.intrinsics
    is_posed = bool(layout.poses) != (layout.position is not None)
    if not is_posed or (lens is None) != (layout.pictures == "latlong"):
        expected = "expected poses or a position, and intrinsics of pinhole pictures only"
        raise ArgumentError(f"{expected}; got none, or too many")
    files = {"lit": layout.lit, "depth": layout.depth, "object_mask": layout.object_mask}
    holds = {mode: form for mode, form in files.items() if form}
    place, frames = re.compile(f"(?:.*/)??(?:{layout.place})"), dict[tuple[str, ...], Frame]()
    unposed = 0
    for file in sorted(folder.rglob("[!.]*")):
        match = place.fullmatch(file.relative_to(folder).as_posix())
        if match is None or match.groups() in frames:
            continue
        paths = {mode: _filled(folder, form.file, match) for mode, form in holds.items()}
        paths = {mode: path for mode, path in paths.items() if path.exists()}
        pose = _pose(folder, layout, match) if paths else None
        unposed += bool(paths) and pose is None
        if pose is not None:
            frames[match.groups()] = Frame(paths, pose, lens, holds)
    says = [layout.says] if layout.says else []
    says += [f"{unposed} frames left out: their poses are not finite"] if unposed else []
    for mode, form in holds.items() if strict and frames else ():
        if lacking := sum(mode not in frame.files for frame in frames.values()):
            says.append(f"{mode}: {lacking} of {len(frames)} frames have none")
        if lacking == len(frames):
            raise ArgumentError(f"{mode}: expected files {form.file}, got none")
    names = layout.object_mask.names if layout.object_mask else ""
    near = [at / names for at in (folder, *folder.absolute().parents[:2])] if names else []
    table = next((objects_of(file) for file in near if file.exists()), ObjectTable({}))
    return Sequence([*frames.values()], table, tuple(says))


def _filled(folder: Path, pattern: str, match: re.Match[str]) -> Path:
    """Return the path of a pattern with the groups of a place in its braces."""
    return _inside(folder, re.sub(r"\{(\w+)\}", lambda braces: match[braces[1]] or "", pattern))


def _inside(folder: Path, name: str) -> Path:
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise ArgumentError(f"expected a file in the folder, got {shown(name)}")
    return folder / name


def _pose(folder: Path, layout: Layout, match: re.Match[str]) -> Pose | None:
    """Return the pose of a frame; None where it is not finite."""
    if layout.poses is None:
        return Pose.from_angles(layout.position)
    pose = _pose_in_file(_filled(folder, layout.poses.file, match), layout.poses, match)
    if pose is None or layout.pictures != "faces":
        return pose
    return _pose_of_face(pose, folder, layout, match)


def _pose_in_file(file: Path, poses: _Poses, match: re.Match[str]) -> Pose | None:
    """Return the pose that a file has of a frame, in our axes and metres."""
    pose: Pose | None
    with within(file.name):
        if poses.position:
            data = parse_json(read_bytes(file, MOST_JSON_BYTES))
            t = numbers("position", _at(data, poses.position), (3,))
            pose = Pose(t, _rigid(_at(data, poses.rotation)) if poses.rotation else R_LEVEL)
        elif "{" in poses.file or poses.row:
            rows = _poses_in(file, False, not poses.row)
            row = int(match[poses.row]) if poses.row else 0
            if str(row) not in rows:
                raise ArgumentError(f"expected a pose in row {row + 1}, got {len(rows)} rows")
            pose = rows[str(row)]
        else:
            names = [name for name in (*match.groups(), match[0], Path(match[0]).name) if name]
            pose = _named(file, names)
    if pose is None:
        return None
    pose = pose.inverse() if poses.inverse else pose
    W, C = _AXES[poses.axes]
    R = W @ pose.R_w_c @ C if poses.yaw_deg == 0 else turn_about_z(poses.yaw_deg) @ pose.R_w_c
    return Pose(W @ pose.position / pictures.PER_M[poses.unit], R)


def _pose_of_face(front: Pose, folder: Path, layout: Layout, match: re.Match[str]) -> Pose:
    """Return a face's pose, by that of the front; ArgumentError if the file of its own poses disagrees."""
    known = LAYOUTS[layout.faces]
    words = next(words for words in known.words if match["face"] in words.split()).split()
    face = known.arrangement[words.index(match["face"])]
    pose = Pose(front.position, front.R_w_c @ (_FRONT.T @ face.R_w_c))
    if layout.poses is None or not layout.poses.agrees:
        return pose
    file = _filled(folder, layout.poses.agrees, match)
    own = _pose_in_file(file, layout.poses, match)
    if own is not None and np.abs(own.R_w_c - pose.R_w_c).max() > _SAME:
        angle = np.degrees(Rotation.from_matrix(own.R_w_c.T @ pose.R_w_c).magnitude())
        line = f"{file.name} line {int(match[layout.poses.row]) + 1}"
        raise ArgumentError(f"{line}: expected the front's turned {face}, off by {angle:.3g} degrees")
    return pose


def _at(data: Any, path: str) -> Any:
    """Return the value at keys and indices with dots between them."""
    for key in path.split("."):
        data = data[int(key) if isinstance(data, list) else key]
    return data


def _rigid(value: Any) -> Array:
    """Return the rotation nearest to a matrix, which has six digits or fewer."""
    R = numbers("rotation", value, (3, 3))
    if (off := np.abs(R @ R.T - _I).max()) > _RIGID or np.linalg.det(R) < 0:
        got = f"determinant {np.linalg.det(R):.6g}, |R R^T - I| {off:.3g}"
        raise ArgumentError(f"expected a rotation, neither scaled nor mirrored, got {got}")
    return np.asarray(Rotation.from_matrix(R).as_matrix())


@cache
def _poses_in(file: Path, named: bool, whole: bool = False) -> dict[str, Pose | None]:
    """Return the poses of a text, None where they are not finite: of each line, or of all numbers.

    A pose is ``x y z``, ``x y z qx qy qz qw``, or a matrix; or as the names in the first line say. Keys are
    the names in the first column, or the lines' numbers.
    """
    if not file.exists():
        raise ArgumentError("expected a file of poses, got none")
    lines = read_bytes(file, MOST_JSON_BYTES).decode("utf-8-sig", "replace").splitlines()
    rows = [line.partition("#")[0].replace(",", " ").replace(";", " ").split() for line in lines]
    rows = [row for row in rows if row]
    columns = [word.lower() for word in rows.pop(0)][named:] if rows and {"x", "X"} & {*rows[0]} else []
    if columns and not ({*"xyz"} <= {*columns} <= {*_COLUMNS} and len({*columns}) == len(columns)):
        raise ArgumentError(f"expected columns {', '.join(_COLUMNS)}, each once, got {shown(columns)}")
    poses: dict[str, Pose | None] = {}
    for i, row in enumerate([[*chain(*rows)]] if whole else rows):
        name, words = (row[0], row[1:]) if named else (str(i), row)
        if name in poses or len(words) not in ([len(columns)] if columns else (3, 7, 12, 16)):
            expected = f"{'a name once, and ' * named}x y z qx qy qz qw, x y z, or a matrix"
            raise ArgumentError(f"expected lines {expected}; got {shown(' '.join(row))}")
        if any(word.lstrip("+-").lower() in ("inf", "nan") for word in words):
            poses[name] = None
            continue
        values = listed_numbers(f"line {i + 1}", words)
        known = defaultdict(float, zip(columns or (*"xyz", *_COLUMNS[6:]), values, strict=False))
        xyz = [known[axis] for axis in "xyz"]
        if len(values) >= 12 and not columns:
            poses[name] = Pose(np.array(values[3:12:4]), _rigid(np.reshape(values[:12], (3, 4))[:, :3]))
        elif "qw" in known:
            poses[name] = Pose.from_quaternion(xyz, [known[column] for column in _COLUMNS[6:]])
        else:
            poses[name] = Pose.from_angles(xyz, *(known[column] for column in _COLUMNS[3:6]))
    return poses


def _named(file: Path, names: list[str]) -> Pose | None:
    """Return the pose of the first of some names that a file has."""
    with within(file.name):
        poses = _poses_in(file, True)
        if (name := next((name for name in names if name in poses), None)) is None:
            raise ArgumentError(f"expected a pose of {shown(names[0])}, got those of {shown([*poses][:4])}")
        return poses[name]


# -- Layouts that list their frames ----------------------------------------------------------------------


def _nerfstudio(folder: Path, options: Options) -> Sequence:
    """Return the frames of nerfstudio's transforms.json."""
    files = sorted(folder.glob("transforms.json")) or sorted(folder.glob("transforms*.json"))
    of_file = [parse_json(read_bytes(file, MOST_JSON_BYTES)) for file in files]
    frames, ignored = list[Frame](), 0
    for i, (data, entry) in enumerate((data, entry) for data in of_file for entry in data["frames"]):  # noqa: B020
        with within(f"frames[{i}]"):
            values = {**data, **entry}
            matrix = numbers("transform_matrix", values["transform_matrix"][:3], (3, 4))
            lit = _inside(folder, values["file_path"])
            depth = values.get("depth_file_path") or values.get("depth_path")
            paths = {
                "lit": lit if lit.suffix.lower() in foreign.SUFFIXES else lit.with_name(lit.name + ".png")
            }
            paths |= {"depth": _inside(folder, depth)} if depth else {}
            lens = _nerfstudio_lens(values, paths["lit"])
            unit = "m" if str(depth).lower().endswith((".npy", ".exr")) else "mm"
            holds = {"depth": Files(kind="planar" if lens else "ray", unit=unit)}
            frames.append(Frame(paths, Pose(matrix[:, 3], _rigid(matrix[:, :3]) @ _GL), lens, holds))
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


def _tum(folder: Path, options: Options) -> Sequence:
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
            paths = {"lit": _inside(folder, name)}
            if abs(depth_times[j] - time) <= _LATEST_S:
                paths["depth"] = _inside(folder, depths[j])
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


def _is_panoramas(path: Path) -> bool:
    """Return whether the first picture of colours or masks is twice as wide as high."""
    for file in pictures_in(path):
        if (mode := mode_of(file, path)[0]) in ("lit", "object_mask"):
            height, width = read_picture(file, mode, clip=True).pixels.shape[:2]
            return bool(width == 2 * height)
    return False


def _panoramas(path: Path, options: Options, of_openexr: int = 0) -> Sequence:
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
            pose = _named(options.poses, [*names, "_".join(words)]) or pose
        files = {mode: files[mode] for mode in ("lit", "depth", "object_mask", "normals") if mode in files}
        frames.append(Frame(files, pose, None, {"depth": Files(kind="ray")}))
    return Sequence(frames, says=("resampled to six faces",), of_openexr=of_openexr)
