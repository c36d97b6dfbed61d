"""Import frames with poses: a table of published layouts, and layouts of the user's own.

A layout is data (docs/capture-folders.md). :mod:`.listed_frames` has those that list their frames.
"""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from omniscv.arguments import flag, number, numbers, one_of, shown, text, within
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Pose, cube_rotations
from omniscv.geometry.instant import turn_about_z
from omniscv.geometry.trajectory_columns import FRAMES, Rows, axes_of, length_unit
from omniscv.geometry.trajectory_files import read_rows
from omniscv.importing import lenses, listed_cameras
from omniscv.importing.conventions import Words
from omniscv.importing.layouts import LAYOUTS
from omniscv.importing.lenses import Pinhole, Wide
from omniscv.importing.listed_frames import (
    inside,
    is_panoramas,
    named_pose,
    nerfstudio,
    panoramas,
    poses_in,
    size_of,
    tum,
    words_of,
)
from omniscv.importing.posed_frames import (
    Files,
    Frame,
    Options,
    Sequence,
    files_in,
    objects_of,
)
from omniscv.records import checked, mapping, nested, optional, read, record
from omniscv.sources.base import ObjectTable
from omniscv.storage.bounded import (
    MOST_JSON_BYTES,
    decode_text,
    parse_json,
    parse_yaml,
    read_bytes,
    read_text,
)

PANORAMAS = {"latlong": 0, "openexr-latlong": 1, "pinhole": 0}
"""Layouts of one picture. Of 1, the first and the last column show one meridian, of OpenEXR's axes."""
_FRONT = cube_rotations()[0][1]
_SAME = 2e-3  # of a rotation's entries: poses have six digits or fewer
_SAME_PLACE_M = 1e-3
_CLOSE_M = 1e-2

_MOST_S = 10.0
_TRY = """
import json, re, sys
pattern, names = json.load(sys.stdin)
for name in names:
    re.fullmatch(pattern, name)
"""
_LAYOUTS = Path(__file__).with_name("layouts.yaml")


def _files(name: str, value: Any, keys: tuple[str, ...] = ()) -> Any:
    given = {"file": value} if isinstance(value, str) else value
    return given if isinstance(given, Files) else read(Files, mapping(name, given, ("file", *keys)), name)


def _axes(name: str, value: Any) -> str:
    if set(axes := text(name, value)) & {*"+-"}:
        axes_of(axes)
    else:
        one_of(name, axes, (*FRAMES, "povray"))
    return axes


@record
class _Poses:
    """Where poses are: texts of numbers or JSON by frame, or a text with a row of each, by number or name."""

    file: str = checked(text)
    row: str = checked(text, default="")
    position: str = checked(text, default="")
    rotation: str = checked(text, default="")
    matrix: str = checked(text, default="")
    axes: str = checked(_axes, default="camera")
    inverse: bool = checked(flag, default=False)
    unit: str | float | None = checked(length_unit, default=None)
    yaw_deg: float = checked(number, default=0.0)
    agrees: str = checked(text, default="")

    def check(self) -> None:
        """Raise ArgumentError for keys that act on files of another form."""
        given = {"rotation": self.rotation, "matrix": self.matrix}
        if idle := next((key for key, value in given.items() if value and not self.position), None):
            advice = "of a row of numbers the names of its columns say what is a rotation"
            raise ArgumentError(f"poses.{idle}: expected it beside position only, of JSON; {advice}")
        if self.row and self.position:
            raise ArgumentError("poses.row: expected none beside position: JSON has the pose of one frame")


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
    intrinsics: Any = None
    faces: str | None = checked(optional(partial(one_of, words=tuple(LAYOUTS))), default=None)
    found: str = checked(text, default="")
    says: str = checked(text, default="")
    level: str = checked(text, default="")
    unused: str = checked(text, default="")
    asks: bool = checked(flag, default=False)


@cache
def _finders() -> dict[str, tuple[str, Callable[[Path, Options], Sequence]]]:
    """Return, by layout, the pattern of a file by which it is found, and its reader."""
    rows = {name: read(Layout, data, name) for name, data in parse_yaml(read_text(_LAYOUTS)).items()}
    rows["tartanair"] = replace(rows["tartanground"], found="image_?cam_front")
    finders: dict[str, Any] = {
        name: (row.found, partial(_of_layout, layout=row)) for name, row in rows.items()
    }
    finders |= {"nerfstudio": ("transforms*.json", nerfstudio), "tum": ("rgb.txt", tum)}
    finders |= {
        "gaussian-splatting": ("cameras.json", listed_cameras.gaussian_splatting),
        "llff": ("poses_bounds.npy", listed_cameras.llff),
        "arkitscenes": ("*.traj", listed_cameras.arkit_scenes),
        "sunrgbd": ("image/../extrinsics/*.txt", listed_cameras.sun_rgbd),
        "hypersim": ("_detail/metadata_scene.csv", listed_cameras.hypersim),
        "isaac": ("**/camera_params_*.json", listed_cameras.isaac),
    }
    return finders | {name: ("", partial(panoramas, of_openexr=kind)) for name, kind in PANORAMAS.items()}


def sequences() -> tuple[str, ...]:
    """Return the names of layouts of frames with poses, and of panoramas."""
    return tuple(_finders())


def find_sequence(path: Path, layout: str, options: Options) -> Sequence | None:
    """Return the frames of a folder, or of one panorama; None where it is none of these layouts.

    ``layout`` is one of :func:`sequences`, ``auto`` for what lies there, or a file ``.yaml`` of a layout.
    Raises ArgumentError for files without poses, or poses that contradict each other.
    """
    poses_in.cache_clear()  # files may have changed since the last import
    find: Any = None
    if layout.endswith((".yaml", ".yml")):
        with within(layout):
            data = decode_text(read_bytes(Path(layout), MOST_JSON_BYTES))
            find = partial(_of_layout, layout=read(Layout, parse_yaml(data)), strict=True)
        layout = Path(layout).stem
    elif layout == "auto":
        there = (name for name, (found, _) in _finders().items() if found and any(path.glob(found)))
        layout = next(there, "")
        if not layout and options.intrinsics:
            layout = "pinhole"
        elif not layout and is_panoramas(path):
            layout = "latlong"
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
    if layout.poses:
        layout.poses.check()
    is_pinhole = layout.pictures == "pinhole"
    is_posed = bool(layout.poses) != (layout.position is not None)
    if not is_posed or is_pinhole != bool(layout.intrinsics or options.intrinsics):
        expected = "expected poses or a position, and intrinsics of pinhole pictures only"
        raise ArgumentError(f"{expected}; got none, or too many")
    lens: Pinhole | Wide | None = lenses.FACE if layout.pictures == "faces" else None
    center = np.zeros(3)
    files = {"lit": layout.lit, "depth": layout.depth, "object_mask": layout.object_mask}
    holds = {mode: form for mode, form in files.items() if form}
    pattern = f"(?:.*/)??(?:{layout.place})"
    frames = dict[tuple[str, ...], Frame]()
    unposed = 0
    table_name = layout.object_mask.names if layout.object_mask else ""
    names = [file.relative_to(folder).as_posix() for file in files_in(folder, options)]
    if strict:
        idle = {"found": layout.found, "faces": layout.faces and layout.pictures != "faces"}
        if given := next((key for key, value in idle.items() if value), None):
            raise ArgumentError(f"{given}: expected no key that acts on nothing, got {shown(idle[given])}")
        _check_time(pattern, names)
    for match in map(re.compile(pattern).fullmatch, names):
        if match is None or match.groups() in frames:
            continue
        paths = {mode: _filled(folder, form.file, match) for mode, form in holds.items()}
        paths = {mode: path for mode, path in paths.items() if path.exists()}
        pose = _pose(folder, layout, match) if paths else None
        unposed += bool(paths) and pose is None
        if pose is not None:
            if is_pinhole and lens is None:
                size = size_of(*next((file, mode) for mode, file in paths.items()))
                if options.intrinsics:
                    lens = lenses.of_file(options.intrinsics, size)
                else:
                    lens, center = lenses.of_layout(layout.intrinsics, folder, size)
            pose = Pose(pose.position + pose.R_w_c @ center, pose.R_w_c)
            listed = _filled(folder, table_name, match) if "{" in table_name else None
            if listed and "object_mask" in paths and not listed.exists():
                raise ArgumentError(f"names: expected a list of objects for each mask, got no {listed.name}")
            frames[match.groups()] = Frame(paths, pose, lens, holds, names=listed)
    says = [layout.says] if layout.says else []
    if layout.level and any(np.array_equal(frame.pose.R_w_c, R_LEVEL) for frame in frames.values()):
        says.append(layout.level)
    if layout.unused and (others := sum(1 for _ in folder.glob(layout.unused))):
        says.append(f"{others} {Path(layout.unused).name} are not taken: masks are the instances")
    says += [f"{unposed} frames left out: their poses are not finite"] if unposed else []
    for mode, form in holds.items() if strict and frames else ():
        if lacking := sum(mode not in frame.files for frame in frames.values()):
            says.append(f"{mode}: {lacking} of {len(frames)} frames have none")
        if lacking == len(frames):
            raise ArgumentError(f"{mode}: expected files {form.file}, got none")
    if "{" in table_name:
        table = _all_objects(frames.values())
        return Sequence([*frames.values()], table, tuple(says), words=_words(folder, layout, pattern, names))
    above = (folder, *folder.absolute().parents[:2])
    near = [at / table_name for place in above for at in (place, place / "assets")] if table_name else []
    table = next((objects_of(file) for file in near if file.exists()), ObjectTable({}))
    words = _words(folder, layout, pattern, names)
    return Sequence([*frames.values()], table, tuple(says), words=words)


def _all_objects(frames: Iterable[Frame]) -> ObjectTable:
    """Return the objects of the lists of all frames, with ids in the order of their names."""
    names = set[str]()
    for frame in frames:
        if frame.names is not None:
            names.update(objects_of(frame.names).names())
    return ObjectTable({}, 0, {name: i for i, name in enumerate(sorted(names), start=1)})


def _words(folder: Path, layout: Layout, pattern: str, names: list[str]) -> Words:
    """Return what a layout says of its poses."""
    poses = layout.poses
    columns = {"m0"}
    if poses is None or layout.pictures == "faces":
        return Words(fixed=True)
    if not poses.position:
        match = next(filter(None, map(re.compile(pattern).fullmatch, names)))
        keyed = not ("{" in poses.file or poses.row)
        columns = {*read_rows(_filled(folder, poses.file, match), keyed, not (keyed or poses.row))[1].columns}
    return replace(words_of(columns, poses.axes, poses.unit, poses.inverse), asks=layout.asks)


def _check_time(pattern: str, names: list[str]) -> None:
    """Raise ArgumentError for a pattern of the user's that takes too long: it is tried in another process."""
    given = json.dumps([pattern, names]).encode()
    try:
        subprocess.run([sys.executable, "-I", "-c", _TRY], input=given, timeout=_MOST_S, capture_output=True)
    except subprocess.TimeoutExpired as cause:
        expected = f"expected a pattern that is matched with {len(names)} names within {_MOST_S:g} s"
        raise ArgumentError(f"place: {expected}, got {shown(pattern)}") from cause


def _filled(folder: Path, pattern: str, match: re.Match[str]) -> Path:
    """Return the path of a pattern with the groups of a place in its braces; the first that fits a ``*``."""
    path = inside(folder, re.sub(r"\{(\w+)\}", lambda braces: match[braces[1]] or "", pattern))
    return min(path.parent.glob(path.name), default=path) if "*" in path.name else path


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
    options: Any = {"frame": poses.axes, "unit": poses.unit, "inverse": poses.inverse}
    with within(file.name):
        if poses.position:
            data = parse_json(read_bytes(file, MOST_JSON_BYTES))
            paths = {"position": poses.position, "rotation": poses.rotation}
            entry = {key: _at(data, path) for key, path in paths.items() if path}
            if is_matrix := bool(poses.matrix and poses.matrix in data):
                at = entry["position"]
                entry = {"transform_matrix": data[poses.matrix]}
            options["inverse"] = poses.inverse and (is_matrix or not poses.matrix)
            pose = Rows.of_entries([("pose", entry)]).listed(**options)["0"]
            if is_matrix and (pose is None or not np.allclose(pose.position, at, rtol=0, atol=_CLOSE_M)):
                expected = f"expected a {poses.matrix} that has its camera at {poses.position}"
                raise ArgumentError(f"{expected}, {shown(at)}; got {pose and shown(pose.position.tolist())}")
        elif "{" in poses.file or poses.row:
            rows = poses_in(file, False, whole=not poses.row, lossy=True, **options)
            row = int(match[poses.row]) if poses.row else 0
            if str(row) not in rows:
                raise ArgumentError(f"expected a pose in row {row + 1}, got {len(rows)} rows")
            pose = rows[str(row)]
        else:
            names = [name for name in (*match.groups(), match[0], Path(match[0]).name) if name]
            pose = named_pose(file, names, lossy=True, **options)
    if pose is None or not poses.yaw_deg:
        return pose
    return Pose(pose.position, turn_about_z(poses.yaw_deg) @ pose.R_w_c)


def _pose_of_face(front: Pose, folder: Path, layout: Layout, match: re.Match[str]) -> Pose:
    """Return a face's pose, by that of the front; ArgumentError if the file of its own poses disagrees."""
    known = LAYOUTS[layout.faces or "top-bottom"]
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
