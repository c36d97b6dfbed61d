"""A form of lens files: how it is recognised, where its numbers stand, its models by ours.

Reader and writer follow from it. :data:`omniscv.calibration.files.FORMS` has them all, in the order in which
they are tried; :mod:`omniscv.calibration.keys` says how their models are written down.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from typing import Any, Literal, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, shown, within, wrong
from omniscv.calibration import intrinsics
from omniscv.calibration.documents import SYNTAXES, Content
from omniscv.calibration.intrinsics import HALF_PIXEL
from omniscv.calibration.keys import Key, Model, check_order, parts
from omniscv.calibration.nodes import (
    Node,
    Paths,
    Values,
    alternatives,
    canonical,
    first_path,
    floats,
    marked,
    plain,
    put,
    whole,
)
from omniscv.cameras import Camera, RollingShutter
from omniscv.cameras.lens_parameters import Numbers
from omniscv.cameras.rig import ORIGIN, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose

_SIZES = (
    "image_size", "img_size", "resolution", "size", "dim", "image_resolution", "frame_size", "imgsize",
    "dims", "calibration_resolution", "camera_resolution",
)  # fmt: skip
"""Keys of [width, height] in files of people, tried where a form's own keys are missing."""

SAME_QUANTITY = 1e-3
"""Share of a quantity by which two statements of it may differ."""
_LEAST_REACH_M = 0.01  # metres, of which positions may differ by that share


def _names(part: object) -> TypeGuard[str]:
    """Return whether a part of a path names a camera."""
    return isinstance(part, str) and not part.lower().startswith("intrinsic")


class Entry(NamedTuple):
    """A camera of a file.

    Attributes:
        camera: its lens and size.
        pose: in the file's frame; None if it has none.
        time_offset: the time at which an image was taken minus its stamp, seconds.
        ignored: paths of keys that were not read.
    """

    camera: Camera
    pose: Pose | None = None
    time_offset: float = 0.0
    ignored: tuple[str, ...] = ()

    @property
    def mounted(self) -> RigCamera:
        """The camera of a rig."""
        return RigCamera(self.camera, self.pose or ORIGIN, self.time_offset)


class LensNumbers(NamedTuple):
    """The numbers of a camera as its file has them.

    Attributes:
        values: by the names of :mod:`omniscv.calibration.keys`.
        width: of the image, px.
        height: of the image, px.
        word: the file's word for the model; "" where the form has none.
    """

    values: Numbers
    width: int
    height: int
    word: str = ""


# -- where things stand in the mapping of a camera ------------------------------------------------------


@dataclass(frozen=True)
class PoseMatrix:
    """A pose as a 4 x 4 matrix, or its first three rows.

    Attributes:
        paths: where it stands.
        maps: ``T_b_c`` from the camera to the body b of the file, ``T_c_b`` from the body to the camera.
    """

    paths: Paths
    maps: Literal["T_b_c", "T_c_b"]

    def read(self, node: Node) -> Pose:
        """Return the pose of a camera on the body."""
        pose = pose_of_matrix(node.take(self.paths))
        return pose if self.maps == "T_b_c" else pose.inverse()

    def write(self, values: Values, pose: Pose) -> None:
        """Put a pose into the mapping of a camera.

        Args:
            values: the mapping.
            pose: of the camera on the body.
        """
        matrix = matrix_of_pose(pose if self.maps == "T_b_c" else pose.inverse())
        put(values, first_path(self.paths), matrix)


@dataclass(frozen=True)
class PoseKeys:
    """A pose of the camera on the body as a position and a quaternion.

    Attributes:
        paths: what is there where the camera has a pose.
        keys: of x, y, z, qx, qy, qz and qw.
    """

    paths: Paths
    keys: tuple[Key, ...]

    def read(self, node: Node) -> Pose:
        """Return the pose of a camera on the body; ArgumentError where its quaternion is not of length 1."""
        node.take(self.paths)
        numbers: Numbers = {}
        for key in self.keys:
            numbers |= key.named(key.read(node))
        position = [numbers[name] for name in _POSITION]
        quaternion = [numbers[name] for name in _QUATERNION]
        if not abs(math.hypot(*quaternion) - 1) < 1e-3:
            raise ArgumentError(f"quaternion: expected one of length 1, got {shown(quaternion)}")
        return Pose.from_quaternion(position, quaternion)

    def write(self, values: Values, pose: Pose) -> None:
        """Put a pose into the mapping of a camera.

        Args:
            values: the mapping.
            pose: of the camera on the body.
        """
        numbers = dict(zip(_POSITION, pose.position.tolist(), strict=True))
        numbers |= zip(_QUATERNION, pose.quaternion(), strict=True)
        for key in self.keys:
            put(values, key.path, key.write(numbers))


_POSITION = ("x", "y", "z")
_QUATERNION = ("qx", "qy", "qz", "qw")


class TimeOffset(NamedTuple):
    """The time at which an image was taken minus its stamp.

    Attributes:
        path: where it stands.
        unit_s: of the value, seconds.
    """

    path: str
    unit_s: float = 1.0


class Readout(NamedTuple):
    """The time of a rolling shutter.

    Attributes:
        path: where it stands.
        unit_s: of the value, seconds.
        is_of_line: whether it is the time from one row to the next; else that of the whole image.
    """

    path: str
    unit_s: float = 1.0
    is_of_line: bool = False

    def rows(self, height: int) -> int:
        """Return how many rows the value is for, of an image so high, px."""
        return height if self.is_of_line else 1


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a camera stand in its mapping.

    Attributes:
        models: of which a camera is one.
        word: the places of the model's word; none where the form has no word.
        size: the places of width and height, or of a list of both.
        shift_px: what is added to a principal point to make it ours.
        poses: of which a camera has one at most; the first is written.
        time: of the time offset; None where the form has none.
        readouts: of the rolling shutter; the first is written.
        harmless: a pattern of plain paths that look like geometry and are none.
    """

    models: tuple[Model, ...] = ()
    word: tuple[Paths, ...] = ()
    size: tuple[Paths, ...] = ("image_width", "image_height")
    shift_px: float = HALF_PIXEL
    poses: tuple[PoseMatrix | PoseKeys, ...] = ()
    time: TimeOffset | None = None
    readouts: tuple[Readout, ...] = ()
    harmless: str = "$^"


@dataclass(frozen=True)
class Reading:
    """Steps of reading that a layout does not describe.

    Attributes:
        split: returns the cameras of a file by name: mappings or nodes; None: those that have the marks.
        finish: changes the numbers after they are read; raises ArgumentError for what is not modelled.
        stereo: adds the second camera of a rectified pair to the cameras of a file.
        sparse: whether the program leaves out coefficients that are 0.
    """

    split: Callable[[Content], Mapping[str, Any]] | None = None
    finish: Callable[[Node, LensNumbers], LensNumbers] | None = None
    stereo: Callable[[Node, dict[str, Entry]], dict[str, Entry]] | None = None
    sparse: bool = False


@dataclass(frozen=True)
class Writing:
    """How values become text, and what every file of the form has.

    Attributes:
        syntax: of the text, of :data:`omniscv.calibration.documents.SYNTAXES`.
        constant: values that every file of the form has, by path.
        join: returns the values to write from those of cameras by name; None: the form holds one camera.
        dump: returns their text; None: that of the syntax.
        label: what cameras are called where the form has names of its own; {0} counts from 0, {1} from 1.
        from_first: whether poses are relative to the first camera.
    """

    syntax: str = "yaml"
    constant: Mapping[str, Any] = field(default_factory=dict)
    join: Callable[[dict[str, Values]], Any] | None = None
    dump: Callable[[Any], str] | None = None
    label: str = "{name}"
    from_first: bool = False

    def name_of(self, name: str, index: int = 0) -> str:
        """Return what a camera is called in a file.

        Args:
            name: its name elsewhere.
            index: its place among the cameras of the file, from 0.
        """
        return self.label.format(index, index + 1, name=name)


@dataclass(frozen=True)
class Form:
    """A form of lens files.

    Attributes:
        name: as ``--format`` takes it.
        programs: that write it, for people.
        marks: places that a camera of this form has, and no camera of the forms before it.
        layout: where the numbers of a camera stand.
        reading: what else reading does.
        writing: what else writing does.
        refused: what the form can hold and we do not, for people.
    """

    name: str
    programs: str
    marks: tuple[Paths, ...]
    layout: Layout
    reading: Reading = Reading()
    writing: Writing = Writing()
    refused: str = ""

    @cached_property
    def written(self) -> tuple[str, ...]:
        """Our models that can be written."""
        names = {model.name: None for model in self.layout.models if not model.read_only}
        return tuple(names)

    # -- reading -------------------------------------------------------------------------------

    def is_of(self, content: Content) -> bool:
        """Return whether a file is of this form."""
        return bool(self.nodes(content))

    def nodes(self, content: Content) -> dict[str, Node]:
        """Return the cameras of a file by name; none where it is of another form."""
        nodes: dict[str, Node] = {}
        if self.reading.split is not None:
            for name, camera in self.reading.split(content).items():
                nodes[name] = camera if isinstance(camera, Node) else Node(camera)
            return nodes
        for document in content.documents:
            for path, node in marked(document, self.marks):
                nodes[_new_name(path, nodes)] = node
        return nodes

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras of a file by name.

        Args:
            content: the file.
            size: width and height of the images, px, where the file does not hold them.

        Raises:
            ArgumentError: another form, or what we do not model.
        """
        nodes = self.nodes(content)
        if not nodes:
            if content.error is not None:
                raise content.error
            marks = ", ".join("|".join(alternatives(mark)) for mark in self.marks)
            raise ArgumentError(f"{self.name}: expected keys {marks}, got others")
        entries: dict[str, Entry] = {}
        for name, node in nodes.items():
            with within(name):
                entries[name] = self.entry(node, size)
        return entries

    def on_body(self, content: Content) -> dict[str, Entry]:
        """Return the cameras of a file by name, with their poses on the body that carries them, as an IMU."""
        return self.read(content)

    def entry(self, node: Node, size: tuple[int, int] | None) -> Entry:
        """Return a camera of a file.

        Args:
            node: its mapping, whose used keys are marked.
            size: width and height of the image, px, where the file does not hold them.

        Raises:
            ArgumentError: what we do not model.
        """
        words = [str(node.take(paths, "none", outer=True)) for paths in self.layout.word]
        width, height = self._size(node, size)
        model, values = self.model(node, tuple(words))
        lens = LensNumbers(values, width, height, "-".join(words))
        if self.reading.finish is not None:
            lens = self.reading.finish(node, lens)
        camera = self._with_shutter(node, self.camera(model, lens))
        pose = self._pose(node)
        time = self.layout.time
        time_offset = 0.0
        if time is not None:
            time_offset = time.unit_s * number(time.path, node.take(time.path, 0.0, outer=True) or 0.0)
        return Entry(camera, pose, time_offset, node.check_rest(self.layout.harmless, self.name))

    def camera(self, model: Model, lens: LensNumbers) -> Camera:
        """Return the camera of numbers.

        Args:
            model: of the form.
            lens: its numbers, as the form has them.
        """
        values = intrinsics.complete(lens.values, lens.width, lens.height, self.layout.shift_px)
        return intrinsics.camera_of(model.name, lens.width, lens.height, values)

    def model(self, node: Node, word: tuple[str, ...]) -> tuple[Model, Numbers]:
        """Return the model of a camera and its numbers: that of most values of those that fit.

        Args:
            node: the camera's mapping, in which the keys of the model count as used.
            word: for the model, one for each place of :attr:`Layout.word`.

        Raises:
            ArgumentError: another word, or no model whose numbers are all there.
        """
        candidates = self._candidates(word)
        node.modelled = set()
        for model in candidates:
            for key in model.keys:
                node.modelled.update(map(plain, key.paths))
        used_before = set(node.used)
        best: tuple[Model, Numbers, set[str]] | None = None
        most_values = -1
        error: ArgumentError | None = None
        for model in candidates:
            node.used = set(used_before)
            try:
                values, value_count = self._numbers(node, model)
            except ArgumentError as cause:
                if error is None:
                    error = cause
                continue
            if value_count > most_values:
                most_values = value_count
                best = (model, values, node.used)
        if best is None:
            assert error is not None
            raise error
        model, values, node.used = best
        node.absent -= {used.rpartition(".")[2] for used in node.used}
        return model, values

    def _candidates(self, word: tuple[str, ...]) -> list[Model]:
        """Return the models that a file's word may mean; ArgumentError where there are none."""
        meaning = _canonical(word)
        models = []
        known: dict[str, None] = {}
        for model in self.layout.models:
            if not model.words or any(_canonical(parts(other)) == meaning for other in model.words):
                models.append(model)
            if model.words:
                known["-".join(parts(model.words[0]))] = None
        if not models:
            key = "-".join(first_path(paths) for paths in self.layout.word)
            raise ArgumentError(f"{key}: expected one of {', '.join(known)}; got {shown('-'.join(word))}")
        return models

    def _numbers(self, node: Node, model: Model) -> tuple[Numbers, int]:
        """Return a camera's numbers by a model, and of how many values they are; ArgumentError if it is
        none."""
        numbers: Numbers = {}
        value_count = 0
        for key in model.keys:
            values = key.read(node)
            numbers |= key.named(values)
            value_count += len(values)
        if not self.reading.sparse:
            check_order(model, numbers)
        return numbers, value_count

    def _size(self, node: Node, size: tuple[int, int] | None) -> tuple[int, int]:
        """Return width and height of a camera's image, px: those of the file, else those given."""
        names = [first_path(paths) for paths in self.layout.size]
        values = [node.take(paths, None, outer=True) for paths in self.layout.size]
        if all(value is None for value in values):
            values = [node.take(_SIZES, None, outer=True)]
        sides: list[float] = []
        missing: list[str] = []
        for name, value in zip(names, values, strict=False):
            if value is None:
                missing.append(name)
            else:
                sides += floats(names[0], value)
        if missing:
            if sides or size is None:
                raise ArgumentError(f"missing key {missing[0]!r}: add it, or give the size (--size)")
            sides = [*size]
        elif len(sides) != 2:
            raise ArgumentError(f"{names[0]}: expected [width, height], got {shown(values)}")
        width = whole(names[0], sides[0])
        height = whole(names[-1], sides[1])
        if size is not None and (width, height) != tuple(size):
            raise ArgumentError(f"size: expected {width} x {height}, got {size[0]} x {size[1]}")
        return width, height

    def _with_shutter(self, node: Node, camera: Camera) -> Camera:
        """Return a camera with the rolling shutter that the file gives it, if any."""
        width = camera.width
        height = camera.height
        for readout in self.layout.readouts:
            value = number(readout.path, node.take(readout.path, 0) or 0, least=0)
            seconds = readout.unit_s * value * readout.rows(height)
            if seconds:
                camera = RollingShutter(width, height, camera, seconds)
        return camera

    def _pose(self, node: Node) -> Pose | None:
        """Return the pose of a camera; None if it has none, ArgumentError if two places have others."""
        pose: Pose | None = None
        for place in self.layout.poses:
            if not node.has(place.paths):
                continue
            with within(first_path(place.paths)):
                other = place.read(node)
                if pose is not None and not _agree(pose, other):
                    raise ArgumentError("expected one pose of the camera, got two that differ; remove one")
            if pose is None:
                pose = other
        return pose

    # -- writing -------------------------------------------------------------------------------

    def values_of(self, camera: Camera) -> Values:
        """Return the mapping of a camera; ArgumentError where the form cannot carry it."""
        values: Values = {}
        if self.layout.readouts and isinstance(camera, RollingShutter) and not camera.has_velocity:
            readout = self.layout.readouts[0]
            put(values, readout.path, camera.readout / readout.unit_s / readout.rows(camera.height))
            camera = camera.base
        model, numbers = self.numbers_of(camera)
        if model.words:
            for paths, word in zip(self.layout.word, parts(model.words[0]), strict=True):
                put(values, first_path(paths), word)
        self._put_size(values, camera)
        for key in model.keys:
            put(values, key.path, key.write(numbers))
        for path, value in self.writing.constant.items():
            put(values, path, value)
        return values

    def _put_size(self, values: Values, camera: Camera) -> None:
        """Put the size of a camera's image into its mapping."""
        if len(self.layout.size) == 1:
            put(values, first_path(self.layout.size[0]), [camera.width, camera.height])
            return
        for paths, side in zip(self.layout.size, (camera.width, camera.height), strict=True):
            put(values, first_path(paths), side)

    def numbers_of(self, camera: Camera) -> tuple[Model, Numbers]:
        """Return the form's model of a camera and its numbers; ArgumentError where there is none."""
        why = ""
        for name, ours in intrinsics.intrinsics(camera):
            for model in self.layout.models:
                if model.read_only or model.name != name:
                    continue
                try:
                    numbers = intrinsics.file_numbers(
                        model.numbers, ours, camera.width, camera.height, self.layout.shift_px
                    )
                except ArgumentError as cause:
                    why = f" ({cause.message})"
                    continue
                intrinsics.refuse_limit(camera)
                return model, numbers
        known = ", ".join(self.written).replace("-inverse", " from pixel to angle")
        raise ArgumentError(f"{self.name}: expected {known} that the format can hold, got {camera.name}{why}")

    def write(self, cameras: Mapping[str, RigCamera], *, rig: bool = False, suffix: str = "") -> str:
        """Return the text of a file.

        Args:
            cameras: by name.
            rig: whether their poses and time offsets are written.
            suffix: of the file's name, which decides the syntax of some forms.

        Raises:
            ArgumentError: the form cannot carry a camera, a name, or that there are several.
        """
        if not self.written:
            raise ArgumentError(f"format: expected one that is written; {self.name} is only read")
        if rig and not self.layout.poses:
            raise ArgumentError(f"{self.name}: expected a form that carries poses, got one that does not")
        if self.writing.join is None and len(cameras) != 1:
            names = f"{len(cameras)}: {shown(list(cameras))}"
            raise ArgumentError(f"cameras: {self.name} holds one camera, got {names}")
        values_by_name: dict[str, Values] = {}
        for name, mounted in cameras.items():
            with within(name):
                values = self.values_of(mounted.camera)
                if rig:
                    self._put_pose(values, mounted)
                values_by_name[name] = values
        if self.writing.join is not None:
            return self.text(self.writing.join(values_by_name), suffix)
        ((name, values),) = values_by_name.items()
        with within(name):
            return self.text(values, suffix)

    def text(self, document: Any, suffix: str) -> str:
        """Return the text of what is written.

        Args:
            document: plain values.
            suffix: of the file's name, for forms of several syntaxes.
        """
        if self.writing.dump is not None:
            return self.writing.dump(document)
        return SYNTAXES[self.writing.syntax](document)

    def _put_pose(self, values: Values, mounted: RigCamera) -> None:
        """Put the pose and the time offset of a rig's camera into its mapping."""
        self.layout.poses[0].write(values, mounted.pose)
        if not mounted.time_offset:
            return
        time = self.layout.time
        if time is None:
            raise wrong("time_offset", f"0, as {self.name} carries none", mounted.time_offset)
        put(values, time.path, mounted.time_offset / time.unit_s)


def _agree(pose: Pose, other: Pose) -> bool:
    """Return whether two statements of a pose differ by no more than their digits."""
    reach_m = max(float(np.linalg.norm(pose.position)), _LEAST_REACH_M)
    is_turned = np.abs(pose.R_w_c - other.R_w_c).max() > SAME_QUANTITY
    return not is_turned and np.abs(pose.position - other.position).max() <= SAME_QUANTITY * reach_m


def _new_name(path: tuple[str | int, ...], names: Mapping[str, object]) -> str:
    """Return the name of a camera by where it stands: an index as ``cam0``, the nearest key, or ``cam0``.

    A name that is among ``names`` already gets the next free number.
    """
    if path and isinstance(path[-1], int):
        name = f"cam{path[-1]}"
    else:
        name = next((part for part in reversed(path) if _names(part)), "cam0")
    stem = name
    numbers = count(len(names))
    while name in names:
        name = f"cam{next(numbers)}" if stem.startswith("cam") else f"{stem}-{next(numbers)}"
    return name


def _canonical(words: tuple[str, ...]) -> tuple[str, ...]:
    """Return the canonical words of a model."""
    return tuple(map(canonical, words))


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
    """Return [R | T], (3, 4).

    Args:
        name: of the key of R, for messages; that of T has a T in its place.
        R: nine numbers, row by row.
        T: three numbers.

    Raises:
        ArgumentError: other counts of numbers.
    """
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
