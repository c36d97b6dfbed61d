"""Import frames with poses: a table of published layouts, and layouts of the user's own.

A layout is data (docs/capture-folders.md). :mod:`.listed_frames` has those that list their frames.
"""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
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
    columns_in,
    frame_of_poses,
    inside,
    is_panoramas,
    named_pose,
    nerfstudio,
    panoramas,
    pose_of_place,
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
    numbered,
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
    if isinstance(value, Files):
        return value
    data = {"file": value} if isinstance(value, str) else value
    return read(Files, mapping(name, data, ("file", *keys)), name)


def _axes(name: str, value: Any) -> str:
    axes = text(name, value)
    if set(axes) & {*"+-"}:
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
        advice = "of a row of numbers the names of its columns say what is a rotation"
        for key, value in (("rotation", self.rotation), ("matrix", self.matrix)):
            if value and not self.position:
                raise ArgumentError(f"poses.{key}: expected it beside position only, of JSON; {advice}")
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
    rows = {}
    for name, data in parse_yaml(read_text(_LAYOUTS)).items():
        rows[name] = read(Layout, data, name)
    rows["tartanair"] = replace(rows["tartanground"], found="image_?cam_front")
    finders: dict[str, tuple[str, Callable[[Path, Options], Sequence]]] = {}
    for name, layout in rows.items():
        finders[name] = (layout.found, partial(_of_layout, layout=layout))
    finders |= {
        "nerfstudio": ("transforms*.json", nerfstudio),
        "tum": ("rgb.txt", tum),
        "gaussian-splatting": ("cameras.json", listed_cameras.gaussian_splatting),
        "llff": ("poses_bounds.npy", listed_cameras.llff),
        "arkitscenes": ("*.traj", listed_cameras.arkit_scenes),
        "sunrgbd": ("image/../extrinsics/*.txt", listed_cameras.sun_rgbd),
        "hypersim": ("_detail/metadata_scene.csv", listed_cameras.hypersim),
        "isaac": ("**/camera_params_*.json", listed_cameras.isaac),
    }
    for name, of_openexr in PANORAMAS.items():
        finders[name] = ("", partial(panoramas, of_openexr=of_openexr))
    return finders


def sequences() -> tuple[str, ...]:
    """Return the names of layouts of frames with poses, and of panoramas."""
    return tuple(_finders())


def find_sequence(path: Path, layout: str, options: Options) -> Sequence | None:
    """Return the frames of a folder, or of one panorama; None where it is none of these layouts.

    Args:
        path: of the folder, or of the panorama.
        layout: one of :func:`sequences`, ``auto`` for what lies there, or a file ``.yaml`` of a layout.
        options: of the user.

    Raises:
        ArgumentError: files without poses, or poses that contradict each other.
    """
    poses_in.cache_clear()  # files may have changed since the last import
    if layout.endswith((".yaml", ".yml")):
        with within(layout):
            data = decode_text(read_bytes(Path(layout), MOST_JSON_BYTES))
            find: Any = partial(_of_layout, layout=read(Layout, parse_yaml(data)), strict=True)
        layout = Path(layout).stem
    else:
        if layout == "auto":
            layout = _layout_of(path, options)
        if layout not in _finders():
            return None
        _, find = _finders()[layout]
    try:
        sequence: Sequence = find(path, options)
    except ArgumentError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, OSError, re.error) as cause:
        actual = f"{type(cause).__name__} {shown(str(cause))}"
        raise ArgumentError(f"expected a folder of layout {layout}, got {actual}") from cause
    if not sequence.modes:
        raise ArgumentError(f"expected pictures of layout {layout}, got none")
    if layout not in PANORAMAS:
        sequence = _by_user(sequence, path, options, layout)
    _share_places(sequence.frames)
    return replace(sequence, layout=layout, options=options)


def _layout_of(path: Path, options: Options) -> str:
    """Return the layout of what lies at a path; empty if it is none that is known."""
    for name, (found, _) in _finders().items():
        if found and any(path.glob(found)):
            return name
    if options.intrinsics:
        return "pinhole"
    return "latlong" if is_panoramas(path) else ""


def _by_user(sequence: Sequence, folder: Path, options: Options, layout: str) -> Sequence:
    """Return frames with the poses of the user's file, if there is one, and lines of what the user says.

    Args:
        sequence: of a layout that has poses.
        folder: of its files.
        options: of the user.
        layout: its name.

    Raises:
        ArgumentError: options that say what a layout says, or frames that are no cameras of one pose.
    """
    _check_unposed(options, layout, is_posable=not sequence.words.fixed)
    says = list(sequence.says)
    if options.intrinsics:
        says.append(f"lens of {options.intrinsics.name}, as --intrinsics says, whatever other files say")
    if options.poses is None:
        return replace(sequence, says=tuple(says))
    axes = frame_of_poses(options)
    if axes.refused and not sequence.modes["depth"]:
        raise ArgumentError(axes.refused)
    for frame in sequence.frames:
        frame.pose = pose_of_place(options, axes.frame, frame.files, folder)
    says.append(f"poses of {options.poses.name}, as --poses says, whatever other files say")
    if axes.line:
        says.append(axes.line)
    words = words_of(columns_in(options), axes.frame, options.unit)
    return replace(sequence, says=tuple(says), words=words, refused=axes.refused)


def _check_unposed(options: Options, layout: str, is_posable: bool) -> None:
    """Raise ArgumentError for options that say what a layout says.

    Args:
        options: of the user.
        layout: its name.
        is_posable: whether its frames may have poses of the user's.
    """
    said = {
        "position or yaw": options.pose is not None,
        "poses": options.poses is not None and not is_posable,
        "mirrored": options.mirrored,
    }
    for name, is_given in said.items():
        if is_given:
            raise ArgumentError(f"{name}: expected none, because layout {layout} says it")


def _share_places(frames: list[Frame]) -> None:
    """Move frames within a millimetre of an earlier one to its position."""
    positions = np.array([frame.pose.position for frame in frames])
    owner = list(range(len(frames)))
    for i, near in enumerate(KDTree(positions).query_ball_point(positions, _SAME_PLACE_M)):
        for j in sorted(near):
            if j < i and owner[j] == j:
                owner[i] = j
                break
    for frame, j in zip(frames, owner, strict=True):
        frame.pose = Pose(positions[j], frame.pose.R_w_c)


def _of_layout(folder: Path, options: Options, layout: Layout, strict: bool = False) -> Sequence:
    """Return the frames of a layout that is data; ``strict``: each mode must have files."""
    reader = _LayoutReader(folder, options, layout)
    if strict:
        _check_idle_keys(layout)
        _check_time(reader.pattern, reader.names)
    frames = reader.frames()
    says = [layout.says] if layout.says else []
    if layout.level and any(np.array_equal(frame.pose.R_w_c, R_LEVEL) for frame in frames):
        says.append(layout.level)
    others = len(list(folder.glob(layout.unused))) if layout.unused else 0
    if others:
        says.append(f"{others} {Path(layout.unused).name} are not taken: masks are the instances")
    if reader.unposed:
        says.append(f"{reader.unposed} frames left out: their poses are not finite")
    if strict and frames:
        says += _lacking_modes(frames, reader.forms)
    return Sequence(frames, reader.objects(frames), tuple(says), words=reader.words())


def _check_idle_keys(layout: Layout) -> None:
    """Raise ArgumentError for keys of the user's layout that act on nothing."""
    idle = {"found": layout.found, "faces": layout.faces and layout.pictures != "faces"}
    for key, value in idle.items():
        if value:
            raise ArgumentError(f"{key}: expected no key that acts on nothing, got {shown(value)}")


def _lacking_modes(frames: Collection[Frame], forms: Mapping[str, Files]) -> Iterator[str]:
    """Yield a line for each mode that frames lack; ArgumentError for one that none has."""
    for mode, form in forms.items():
        lacking = sum(mode not in frame.files for frame in frames)
        if lacking == len(frames):
            raise ArgumentError(f"{mode}: expected files {form.file}, got none")
        if lacking:
            yield f"{mode}: {lacking} of {len(frames)} frames have none"


class _LayoutReader:
    """Reads the frames of a folder by a layout.

    Args:
        folder: of the frames.
        options: of the import; its intrinsics take the place of the layout's.
        layout: where files, poses and intrinsics are.

    Attributes:
        forms: by mode, the names of its files and what they hold.
        pattern: of the names of pictures, with groups that say which frame they are of.
        names: of all files in the folder.
        unposed: how many frames were left out, because their poses are not finite.

    Raises:
        ArgumentError: the layout's keys do not fit together, or with the user's options.
    """

    def __init__(self, folder: Path, options: Options, layout: Layout) -> None:
        if layout.poses:
            layout.poses.check()
        has_position = layout.position is not None
        is_posed_once = bool(layout.poses) != has_position
        is_pinhole = layout.pictures == "pinhole"
        has_intrinsics = bool(layout.intrinsics or options.intrinsics)
        if not is_posed_once or is_pinhole != has_intrinsics:
            expected = "expected poses or a position, and intrinsics of pinhole pictures only"
            raise ArgumentError(f"{expected}; got none, or too many")
        self._folder = folder
        self._options = options
        self._layout = layout
        self._table_name = layout.object_mask.names if layout.object_mask else ""
        self._lens: Pinhole | Wide | None = lenses.FACE if layout.pictures == "faces" else None
        self._center = np.zeros(3)  # of the lens in the frame that poses move, metres
        self.forms: dict[str, Files] = {}
        form_of = {"lit": layout.lit, "depth": layout.depth, "object_mask": layout.object_mask}
        for mode, form in form_of.items():
            if form:
                self.forms[mode] = form
        self.pattern = f"(?:.*/)??(?:{layout.place})"
        self.names = [file.relative_to(folder).as_posix() for file in files_in(folder, options)]
        self.unposed = 0

    def frames(self) -> list[Frame]:
        """Return the frames, in the order of their first files."""
        frames: dict[tuple[str, ...], Frame] = {}
        for match in map(re.compile(self.pattern).fullmatch, self.names):
            if match is None or match.groups() in frames:
                continue
            frame = self._frame(match)
            if frame is not None:
                frames[match.groups()] = frame
        return list(frames.values())

    def _frame(self, match: re.Match[str]) -> Frame | None:
        """Return the frame that a file belongs to; None without pictures, or a pose."""
        paths = {}
        for mode, form in self.forms.items():
            path = _filled(self._folder, form.file, match)
            if path.exists():
                paths[mode] = path
        if not paths:
            return None
        pose = _pose(self._folder, self._layout, match)
        if pose is None:
            self.unposed += 1
            return None
        if self._layout.pictures == "pinhole" and self._lens is None:
            self._read_lens(paths)
        pose = Pose(pose.position + pose.R_w_c @ self._center, pose.R_w_c)
        listed = _filled(self._folder, self._table_name, match) if "{" in self._table_name else None
        if listed and "object_mask" in paths and not listed.exists():
            raise ArgumentError(f"names: expected a list of objects for each mask, got no {listed.name}")
        return Frame(paths, pose, self._lens, self.forms, names=listed)

    def _read_lens(self, paths: Mapping[str, Path]) -> None:
        """Read the lens of all frames, for pictures of the size of the first."""
        mode, file = next(iter(paths.items()))
        size = size_of(file, mode)
        if self._options.intrinsics:
            self._lens = lenses.of_file(self._options.intrinsics, size)
        else:
            self._lens, self._center = lenses.of_layout(self._layout.intrinsics, self._folder, size)

    def objects(self, frames: Iterable[Frame]) -> ObjectTable:
        """Return the objects that masks show: those of the lists of frames, or of a file near the folder."""
        if "{" in self._table_name:
            return _all_objects(frames)
        if self._table_name:
            for place in (self._folder, *self._folder.absolute().parents[:2]):
                for file in (place / self._table_name, place / "assets" / self._table_name):
                    if file.exists():
                        return objects_of(file)
        return ObjectTable({})

    def words(self) -> Words:
        """Return what the layout says of its poses."""
        poses = self._layout.poses
        if poses is None or self._layout.pictures == "faces":
            return Words(fixed=True)
        columns = {"m0"}
        if not poses.position:
            match = next(filter(None, map(re.compile(self.pattern).fullmatch, self.names)))
            file = _filled(self._folder, poses.file, match)
            keyed = not ("{" in poses.file or poses.row)
            columns = {*read_rows(file, keyed, not (keyed or poses.row))[1].columns}
        words = words_of(columns, poses.axes, poses.unit, poses.inverse)
        return replace(words, asks=self._layout.asks)


def _all_objects(frames: Iterable[Frame]) -> ObjectTable:
    """Return the objects of the lists of all frames, with ids in the order of their names."""
    names: set[str] = set()
    for frame in frames:
        if frame.names is not None:
            names.update(objects_of(frame.names).names())
    return numbered(names)


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
            pose = _pose_in_json(file, poses)
        elif "{" in poses.file or poses.row:
            rows = poses_in(file, False, whole=not poses.row, lossy=True, **options)
            row = int(match[poses.row]) if poses.row else 0
            if str(row) not in rows:
                raise ArgumentError(f"expected a pose in row {row + 1}, got {len(rows)} rows")
            pose = rows[str(row)]
        else:
            names = list(filter(None, (*match.groups(), match[0], Path(match[0]).name)))
            pose = named_pose(file, names, lossy=True, **options)
    if pose is None or not poses.yaw_deg:
        return pose
    return Pose(pose.position, turn_about_z(poses.yaw_deg) @ pose.R_w_c)


def _pose_in_json(file: Path, poses: _Poses) -> Pose | None:
    """Return the pose that JSON has at the layout's keys; a matrix must agree with the position."""
    data = parse_json(read_bytes(file, MOST_JSON_BYTES))
    position = _at(data, poses.position)
    entry = {"position": position}
    if poses.rotation:
        entry["rotation"] = _at(data, poses.rotation)
    is_matrix = bool(poses.matrix and poses.matrix in data)
    if is_matrix:
        entry = {"transform_matrix": data[poses.matrix]}
    inverse = poses.inverse and (is_matrix or not poses.matrix)
    rows = Rows.of_entries([("pose", entry)])
    pose = rows.listed(frame=poses.axes, unit=poses.unit, inverse=inverse)["0"]
    if is_matrix and (pose is None or not np.allclose(pose.position, position, rtol=0, atol=_CLOSE_M)):
        expected = f"expected a {poses.matrix} that has its camera at {poses.position}"
        actual = None if pose is None else shown(pose.position.tolist())
        raise ArgumentError(f"{expected}, {shown(position)}; got {actual}")
    return pose


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
        angle_deg = np.degrees(Rotation.from_matrix(own.R_w_c.T @ pose.R_w_c).magnitude())
        line = f"{file.name} line {int(match[layout.poses.row]) + 1}"
        raise ArgumentError(f"{line}: expected the front's turned {face}, off by {angle_deg:.3g} degrees")
    return pose


def _at(data: Any, path: str) -> Any:
    """Return the value at keys and indices with dots between them."""
    for key in path.split("."):
        data = data[int(key) if isinstance(data, list) else key]
    return data
