"""A form of lens files as a row: how it is recognised, where its numbers stand, its models by ours.

Reader and writer follow from it. :data:`omniscv.calibration.files.FORMS` has them all, in the order in which
they are tried; their models are lines as :func:`omniscv.calibration.nodes.row_of` reads them.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, shown, within, wrong
from omniscv.calibration import intrinsics
from omniscv.calibration.documents import SYNTAXES, Content
from omniscv.calibration.intrinsics import HALF_PIXEL
from omniscv.calibration.nodes import (
    Node,
    Row,
    Values,
    canonical,
    check_order,
    floats,
    keys_of,
    marked,
    plain,
    put,
    row_of,
    whole,
)
from omniscv.cameras import Camera, RollingShutter
from omniscv.cameras.lens_parameters import Numbers
from omniscv.cameras.rig import ORIGIN, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose

_SIZES = (
    "image_size|img_size|resolution|size|dim|image_resolution|frame_size|imgsize|dims|"
    "calibration_resolution|camera_resolution"
)


def _names(part: object) -> TypeGuard[str]:
    """Return whether a part of a path names a camera."""
    return isinstance(part, str) and not part.lower().startswith("intrinsic")


class Entry(NamedTuple):
    """A camera of a file: its pose in the file's frame if it has one, and the keys that were ignored."""

    camera: Camera
    pose: Pose | None = None
    time_offset: float = 0.0
    ignored: tuple[str, ...] = ()

    @property
    def mounted(self) -> RigCamera:
        """The camera of a rig."""
        return RigCamera(self.camera, self.pose or ORIGIN, self.time_offset)


@dataclass(frozen=True)
class Form:
    """A form of lens files.

    Attributes:
        name: as ``--format`` takes it.
        programs: that write it, for people.
        mark: paths that a camera of this form has, and no camera of the forms before it.
        models: the lines of the models.
        word: the path of the model's word; several are joined by "-". "" where there is none.
        size: the paths of width and height, or of a list of both.
        shift: added to a principal point to make it ours, px.
        syntax: of the text that is written.
        poses: pairs of a path and what stands there: ``T_b_c`` or ``T_c_b``, a matrix to or from the frame of
            the file's body b; or the keys of x, y, z, qx, qy, qz, qw. The first is written.
        time: path of the time offset, and its unit in seconds.
        readout: paths of a rolling shutter's time, each with its unit in seconds, and whether it is that of
            one line; the first is written.
        split: returns the cameras of a file by name; those that have the marks, if not given.
        join: returns the values to write from those of cameras by name; of the only one, if not given.
        dump: returns their text; by the syntax, if not given.
        label: what cameras are called where the form has names of its own; {0} counts from 0, {1} from 1.
        harmless: a pattern of plain keys that look like geometry and are none.
        constant: values that every file of the form has, by path.
        finish: changes the numbers after they are read; raises for what is not modelled.
        stereo: adds the second camera of a rectified pair to those of a rig.
        from_first: whether poses are relative to the first camera.
        sparse: whether the program leaves out coefficients that are 0.
        refused: what the form can hold and we do not, for people.
    """

    name: str
    programs: str
    mark: str
    models: str
    word: str = ""
    size: str = "image_width image_height"
    shift: float = HALF_PIXEL
    syntax: str = "yaml"
    poses: tuple[tuple[str, str], ...] = ()
    time: tuple[str, float] | None = None
    readout: tuple[tuple[str, float, bool], ...] = ()
    split: Callable[[Content], Mapping[str, Any]] | None = None
    join: Callable[[dict[str, Values]], Any] | None = None
    dump: Callable[[Any], str] | None = None
    label: str = "{name}"
    harmless: str = "$^"
    constant: Mapping[str, Any] = field(default_factory=dict)
    finish: Callable[[Node, str, Numbers, int, int], tuple[Numbers, tuple[int, int]]] | None = None
    stereo: Callable[[Node, dict[str, Entry]], dict[str, Entry]] | None = None
    from_first: bool = False
    sparse: bool = False
    refused: str = ""

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The models."""
        return tuple(row_of(line) for line in self.models.strip().splitlines())

    @cached_property
    def written(self) -> tuple[str, ...]:
        """The models that can be written."""
        return tuple(dict.fromkeys(row.model for row in self.rows if row.written))

    # -- reading -------------------------------------------------------------------------------

    def is_of(self, content: Content) -> bool:
        """Return whether a file is of this form."""
        return bool(self.nodes(content))

    def nodes(self, content: Content) -> dict[str, Node]:
        """Return the cameras of a file by name; none where it is of another form."""
        if self.split is not None:
            parts = self.split(content)
            return {name: part if isinstance(part, Node) else Node(part) for name, part in parts.items()}
        found: dict[str, Node] = {}
        for document in content.documents:
            for path, node in marked(document, self.mark.split()):
                name = next((part for part in reversed(path) if _names(part)), "cam0")
                name = f"cam{path[-1]}" if path and isinstance(path[-1], int) else name
                stem = name
                numbers = count(len(found))
                while name in found:
                    name = f"cam{next(numbers)}" if stem.startswith("cam") else f"{stem}-{next(numbers)}"
                found[name] = node
        return found

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras of a file by name; ``size`` is that of images whose file does not hold it.

        Raises ArgumentError for another form, or what we do not model.
        """
        nodes = self.nodes(content)
        if not nodes:
            expected = f"{self.name}: expected keys {', '.join(self.mark.split())}, got others"
            raise content.error or ArgumentError(expected)
        entries: dict[str, Entry] = {}
        for name, node in nodes.items():
            with within(name):
                entries[name] = self.entry(node, size)
        return entries

    def on_body(self, content: Content) -> dict[str, Entry]:
        """Return the cameras of a file by name, with their poses on the body that carries them, as an IMU."""
        return self.read(content)

    def entry(self, node: Node, size: tuple[int, int] | None) -> Entry:
        """Return a camera of a file; ArgumentError for what we do not model."""
        word = "+".join(str(node.take(path, "none", outer=True)) for path in self.word.split())
        width, height = self._size(node, size)
        row, values = self.row(node, word)
        if self.finish is not None:
            values, (width, height) = self.finish(node, word, values, width, height)
        camera = self.camera(row, width, height, values)
        for path, unit, of_line in self.readout:
            seconds = unit * number(path, node.take(path, 0) or 0, least=0) * (height if of_line else 1)
            if seconds:
                camera = RollingShutter(width, height, camera, seconds)
        pose = self._pose(node)
        late = 0.0
        if self.time is not None:
            late = self.time[1] * number(self.time[0], node.take(self.time[0], 0.0, outer=True) or 0.0)
        return Entry(camera, pose, late, node.check_rest(self.harmless))

    def camera(self, row: Row, width: int, height: int, values: Numbers) -> Camera:
        """Return the camera of numbers as the form names them."""
        values = intrinsics.complete(values, width, height, self.shift)
        return intrinsics.camera_of(row.model, width, height, values)

    def row(self, node: Node, word: str) -> tuple[Row, Numbers]:
        """Return the model of a camera and its numbers: that of most numbers of those that fit."""
        given = _canonical(word)
        fitting = [row for row in self.rows if not row.words or given in map(_canonical, row.words)]
        if not fitting:
            known = ", ".join(dict.fromkeys(row.words[0] for row in self.rows if row.words))
            got = f"expected one of {known}; got {shown(word)}".replace("+", "-")
            raise ArgumentError(f"{self.word.partition('|')[0].replace(' ', '-')}: {got}")
        read = []
        errors = []
        before = set(node.used)
        node.modelled = {plain(path) for row in fitting for key in row.keys for path in key.paths.split("|")}
        for row in fitting:
            node.used = set(before)
            try:
                values: Numbers = {}
                for key in row.keys:
                    values |= key.read(node)
                if not self.sparse:
                    check_order(row, values)
                read.append((row, values, node.used))
            except ArgumentError as cause:
                errors.append(cause)
        if not read:
            raise errors[0]
        row, values, node.used = max(read, key=lambda one: len(one[1]))
        node.absent -= {used.rpartition(".")[2] for used in node.used}
        return row, values

    def _size(self, node: Node, size: tuple[int, int] | None) -> tuple[int, int]:
        names = [path.partition("|")[0] for path in self.size.split()]
        held = [node.take(path, None, outer=True) for path in self.size.split()]
        if held == [None] * len(held):
            held = [node.take(_SIZES, None, outer=True)]
        given = [side for value in held if value is not None for side in floats(names[0], value)]
        lost = [name for name, value in zip(names, held, strict=False) if value is None]
        if lost and (size is None or given):
            raise ArgumentError(f"missing key {lost[0]!r}: add it, or give the size (--size)")
        if not lost and len(given) != 2:
            raise ArgumentError(f"{names[0]}: expected [width, height], got {shown(held)}")
        width, height = map(whole, (names * 2)[:2], given or size or ())
        if size is not None and (width, height) != tuple(size):
            raise ArgumentError(f"size: expected {width} x {height}, got {size[0]} x {size[1]}")
        return width, height

    def _pose(self, node: Node) -> Pose | None:
        for paths, kind in self.poses:
            if not node.has(paths):
                continue
            with within(paths.partition("|")[0]):
                value = node.take(paths)
                if kind in ("T_b_c", "T_c_b"):
                    pose = pose_of_matrix(value)
                    return pose if kind == "T_b_c" else pose.inverse()
                turn = {name: value for key in keys_of(kind) for name, value in key.read(node).items()}
                x, y, z, *q = (turn[name] for name in _POSE)
                if not abs(math.hypot(*q) - 1) < 1e-3:
                    raise ArgumentError(f"quaternion: expected one of length 1, got {shown(q)}")
                return Pose.from_quaternion((x, y, z), q)
        return None

    # -- writing -------------------------------------------------------------------------------

    def values_of(self, camera: Camera) -> Values:
        """Return the mapping of a camera; ArgumentError where the form cannot carry it."""
        values: Values = {}
        if self.readout and isinstance(camera, RollingShutter) and not camera.has_velocity:
            path, unit, of_line = self.readout[0]
            put(values, path, camera.readout / unit / (camera.height if of_line else 1))
            camera = camera.base
        row, held = self.held(camera)
        for path, word in zip(self.word.split(), row.words[0].split("+") if row.words else (), strict=False):
            put(values, path.partition("|")[0], word)
        paths = [path.partition("|")[0] for path in self.size.split()]
        sizes = [camera.width, camera.height]
        for path, size in zip(paths, [sizes] if len(paths) == 1 else sizes, strict=True):
            put(values, path, size)
        for key in row.keys:
            put(values, key.path, key.write(held))
        for path, value in self.constant.items():
            put(values, path, value)
        return values

    def held(self, camera: Camera) -> tuple[Row, Numbers]:
        """Return the form's model of a camera and its numbers; ArgumentError where there is none."""
        why = ""
        for model, ours in intrinsics.intrinsics(camera):
            for row in self.rows:
                if row.written and row.model == model:
                    try:
                        held = intrinsics.held(row.names, ours, camera.width, camera.height, self.shift)
                    except ArgumentError as cause:
                        why = f" ({cause.message})"
                        continue
                    intrinsics.refuse_limit(camera)
                    return row, held
        known = ", ".join(self.written).replace("-inverse", " from pixel to angle")
        raise ArgumentError(f"{self.name}: expected {known} that the format can hold, got {camera.name}{why}")

    def write(self, cameras: Mapping[str, RigCamera], *, rig: bool = False, suffix: str = "") -> str:
        """Return the text of a file of cameras by name; of a rig with their poses and times.

        The suffix of the file's name decides the syntax of some forms. Raises ArgumentError where the form
        cannot carry a camera, a name, or that there are several.
        """
        if not self.written:
            raise ArgumentError(f"format: expected one that is written; {self.name} is only read")
        if rig and not self.poses:
            raise ArgumentError(f"{self.name}: expected a form that carries poses, got one that does not")
        if self.join is None and len(cameras) != 1:
            got = f"{len(cameras)}: {shown(list(cameras))}"
            raise ArgumentError(f"cameras: {self.name} holds one camera, got {got}")
        every: dict[str, Values] = {}
        for name, mounted in cameras.items():
            with within(name):
                every[name] = self.values_of(mounted.camera)
                if rig:
                    self._put_pose(every[name], mounted)
        if self.join is not None:
            return self.text(self.join(every), suffix)
        ((name, values),) = every.items()
        with within(name):
            return self.text(values, suffix)

    def text(self, document: Any, suffix: str) -> str:
        """Return the text of what is written."""
        return self.dump(document) if self.dump is not None else SYNTAXES[self.syntax](document)

    def _put_pose(self, values: Values, mounted: RigCamera) -> None:
        path = self.poses[0][0].partition("|")[0]
        kind = self.poses[0][1]
        if kind in ("T_b_c", "T_c_b"):
            put(values, path, matrix_of_pose(mounted.pose if kind == "T_b_c" else mounted.pose.inverse()))
        else:
            numbers = *mounted.pose.position.tolist(), *mounted.pose.quaternion()
            pose = dict(zip(_POSE, numbers, strict=True))
            for key in keys_of(kind):
                put(values, key.path, key.write(pose))
        if mounted.time_offset and self.time is None:
            raise wrong("time_offset", f"0, as {self.name} carries none", mounted.time_offset)
        if mounted.time_offset and self.time is not None:
            put(values, self.time[0], mounted.time_offset / self.time[1])


_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


def _canonical(words: str) -> tuple[str, ...]:
    return tuple(map(canonical, words.split("+")))


def pose_of_matrix(value: object) -> Pose:
    """Return the pose of a 4 x 4 matrix, also of its first three rows."""
    rows = floats("matrix", value)
    if len(rows) == 12:
        rows += [0.0, 0.0, 0.0, 1.0]
    if len(rows) != 16 or rows[12:] != [0, 0, 0, 1]:
        raise ArgumentError(f"expected 4 x 4 numbers with a last row [0, 0, 0, 1], got {shown(value)}")
    matrix = np.array(rows).reshape(4, 4)
    return Pose(matrix[:3, 3], rotation_of(matrix[:3, :3]))


def matrix_3x4(name: str, R: object, T: object) -> Array:
    """Return [R | T] of nine numbers and three."""
    rows = floats(name, R)
    ends = floats(name.replace("R", "T"), T)
    if (len(rows), len(ends)) != (9, 3):
        raise ArgumentError(f"{name}: expected a 3 x 3 matrix and T of three, got {shown(R)}, {shown(T)}")
    return np.column_stack([np.reshape(rows, (3, 3)), ends])


def rotation_of(rows: ArrayLike) -> Array:
    """Return a rotation matrix: the nearest one, where the file has few digits (0.1 %)."""
    matrix = np.reshape(np.asarray(rows, dtype=np.float64), (3, 3))
    u, lengths, v = np.linalg.svd(matrix)
    return u @ v if 1e-9 < np.abs(lengths - 1).max() < 1e-3 else matrix


def matrix_of_pose(pose: Pose) -> list[list[float]]:
    """Return the 4 x 4 matrix of a pose."""
    return [*np.column_stack([pose.rotation, pose.position]).tolist(), [0.0, 0.0, 0.0, 1.0]]
