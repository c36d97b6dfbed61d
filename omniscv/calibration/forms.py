"""A form of lens files as a row: how it is recognised, where its numbers stand, its models by ours.

``forms.Form`` is the row; :mod:`omniscv.calibration.table` has them all. Reader and writer follow from it.
The models of a form are lines ``WORD MODEL PATH=NAMES ...``: the form's word (``A|B`` are synonyms, the
first is written), our model, and where the numbers stand. A path is ``a.b``, in one key or nested, ``a|b``
for alternatives, ``.c`` beside the last one, and ends with ``?`` where it may be missing (its numbers are 0
then). Names are those of :mod:`omniscv.calibration.intrinsics`; ``a,b;c`` is a list that may end at the
semicolon; a literal is a value that must stand there, ``_`` one that does not matter. A line after ``<`` is
read, not written.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import number, numbers, shown, within
from omniscv.calibration import intrinsics
from omniscv.calibration.documents import SYNTAXES, Content
from omniscv.calibration.intrinsics import HALF_PIXEL, Numbers
from omniscv.cameras import Camera, RollingShutter
from omniscv.cameras.rig import RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

Values = dict[str, Any]

_SYNONYMS = {
    "radtan": "plumbbob radialtangential radialtangential4 radialtangential5 brownconrady brown opencv "
    "radtan4 radtan5 radtan8 rational rationalpolynomial opencvstandard standard opencvpinhole",
    "equidistant": "equi kannalabrandt kannalabrandt4 kannalabrandt8 kb kb4 kb8 fisheye "
    "opencvfisheye fisheyeopencv fisheyekb4",
    "none": "undistorted nodistortion null no ideal rectified",
}
_CANONICAL = {word: canon for canon, words in _SYNONYMS.items() for word in words.split()}

_GEOMETRY = re.compile(
    r"skew|tilt|shear|^dist(?!anc|ribut)|distort|tangential|prism|radial|windshield|binning|^roi|crop|rectif|"
    r"mirror|linedelay|readout|shutter|stretch|aspect|decenter|affine|^poly|^coef|^([kps]\W?\d.*|xi|alpha|beta|omega|fov)$"
)
"""Plain keys that may change the geometry: refused unless a row models them or they are neutral."""

_DOTTED = re.compile(r"Camera1\.|Camera\.(?:type|width|height)$|Stereo\.|File\.")
_SIZES = (
    "image_size|img_size|resolution|size|dim|image_resolution|frame_size|imgsize|dims|calibration_resolution"
)
_MISSING = object()


def plain(key: str) -> str:
    """Return a key in lower case without signs between its words."""
    return re.sub(r"[-_ ]", "", key).lower()


def canonical(word: object) -> str:
    """Return the canonical word of a model: synonyms that are certain, in any case."""
    word = re.sub(r"[^a-z0-9]|^distortion\.", "", "none" if word is None else str(word).lower())
    return _CANONICAL.get(word, word)


class Node:
    """The mapping of a camera, and which of its keys were read.

    Args:
        values: the mapping.
        outer: mappings around it, which may hold the size.
    """

    def __init__(self, values: Mapping[str, Any], outer: Sequence[Mapping[str, Any]] = ()) -> None:
        self.values, self.outer = values, outer
        self.used: set[str] = set()
        self.absent: set[str] = set()

    def take(self, paths: str, default: Any = _MISSING, outer: bool = False) -> Any:
        """Return the value at one of several paths, ``a|b``.

        Raises:
            ArgumentError: none is there and there is no default, or two are, with different values.
        """
        found = [(path, value) for path in paths.split("|") for value in _at(self.values, path)]
        for around in self.outer if outer and not found else ():
            found = [(path, value) for path in paths.split("|") for value in _at(around, path)]
            if found:
                break
        self.used |= {plain(path) for path, _ in found}
        values = [value for _, value in found]
        if any(value != values[0] for value in values[1:]):
            both = " and ".join(path for path, _ in found)
            raise ArgumentError(f"{both}: expected one of them, got both with different values")
        if not values and default is _MISSING:
            raise ArgumentError(f"missing key {paths.partition('|')[0]!r}")
        return values[0] if values else default

    def has(self, paths: str) -> bool:
        """Return whether one of several paths is there."""
        return any(True for path in paths.split("|") for _ in _at(self.values, path))

    def unread(self) -> Iterator[tuple[str, Any]]:
        """Yield the keys that were not taken, and their values."""
        beside = self.outer[0] if self.outer else {}
        beside = {
            key: value  # but for other cameras
            for key, value in beside.items()
            if not (isinstance(value, Mapping) and value.keys() & self.values.keys())
        }
        for near, path, value in [
            *((True, *leaf) for leaf in _leaves(self.values)),
            *((False, *leaf) for leaf in _leaves(beside)),
        ]:
            key = plain(path)
            if not any(key == used or key.startswith(f"{used}.") for used in self.used) and (
                near or any(map(_GEOMETRY.search, key.split(".")))
            ):
                yield path, value


def _at(values: Any, path: str) -> Iterator[Any]:
    """Yield the values at a path, whose dots may stand in keys or between mappings."""
    if not isinstance(values, Mapping):
        return
    yield from (value for key, value in values.items() if plain(key) == plain(path))
    head, dot, rest = path.partition(".")
    while dot:
        for key in [key for key in values if plain(key) == plain(head)]:
            yield from _at(values[key], rest)
        more, dot, rest = rest.partition(".")
        head = f"{head}.{more}"


def _leaves(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping) and value and "data" not in value:
            yield from _leaves(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def floats(name: str, value: object) -> list[float]:
    """Return the numbers of a scalar, a text of them, nested lists, or a matrix with its ``data``."""
    if isinstance(value, Mapping):
        if "data" not in value:
            raise ArgumentError(f"{name}: missing key 'data'")
        name, value = f"{name}: data", value["data"]
    if isinstance(value, str):
        text = re.sub(r"^\s*[\[(](.*)[\])]\s*$", r"\1", value.strip())
        value = re.split(r"[\s,;]+", text.strip()) if text.strip() else []
    if isinstance(value, list):
        while any(isinstance(row, list) for row in value):
            if len(value) > 64 or not all(isinstance(row, list) for row in value):
                raise ArgumentError(f"{name}: expected numbers, got {shown(value)}")
            value = [item for row in value for item in row]
        return numbers(name, value, (len(value),)).tolist() if value else []
    return [number(name, value)]


class Key(NamedTuple):
    """Where numbers of a model stand: paths, of which the first is written, and names by groups."""

    paths: str
    groups: tuple[tuple[str, ...], ...]
    optional: bool

    @property
    def names(self) -> tuple[str, ...]:
        """All names."""
        return tuple(name for group in self.groups for name in group)

    @property
    def path(self) -> str:
        """The path that is written, and named in messages."""
        return self.paths.partition("|")[0]

    def read(self, node: Node) -> Numbers:
        """Return the numbers that a camera has here; ArgumentError for another count or value."""
        if not node.has(self.paths):
            node.absent |= {plain(path.rpartition(".")[2]) for path in self.paths.split("|")}
        value = node.take(self.paths, [] if self.optional else _MISSING, outer=True)
        values = [] if value is None else floats(self.path, value)
        if not values and self.optional:
            return {}
        counts = list(accumulate(map(len, self.groups)))
        if len(values) not in counts:
            wanted = " or ".join(map(str, counts))
            raise ArgumentError(
                f"{self.path}: expected {wanted} finite numbers ({','.join(self.names)}), got {len(values)}: "
                f"{shown(value)}"
            )
        for name, got in zip(self.names, values, strict=False):
            if _is_literal(name) and abs(got - float(name)) > 1e-12:
                raise ArgumentError(
                    f"{self.path}: expected {name} (other values are not modelled), got {got:.15g}"
                )
        return dict(zip(self.names, values, strict=False))

    def write(self, values: Numbers) -> Any:
        """Return the value to write: a number or a list up to the first end beyond its last number."""
        every = [float(name) if _is_literal(name) else values.get(name, 0.0) for name in self.names]
        if self.names == (self.names[0],) and len(self.groups) == 1:
            return every[0]
        counts = list(accumulate(map(len, self.groups)))
        last = max((i + 1 for i, value in enumerate(every) if value), default=0)
        return every[: next(count for count in counts if count >= last)]


def _is_literal(name: str) -> bool:
    return name.lstrip("-").isdigit()


class Row(NamedTuple):
    """A model of a form."""

    words: tuple[str, ...]
    model: str
    keys: tuple[Key, ...]
    written: bool

    @property
    def names(self) -> list[str]:
        """The numbers that it holds."""
        return [name for key in self.keys for name in key.names if not _is_literal(name) and name != "_"]


def rows_of(table: str) -> tuple[Row, ...]:
    """Return the models of a form; see the module."""
    return tuple(_row(line.split()) for line in table.strip().splitlines())


def _row(words: list[str]) -> Row:
    written = words[0] != "<"
    name, model, *fields = words if written else words[1:]
    keys = []
    before = ""
    for text in fields:
        paths, equals, names = text.partition("=")
        optional = paths.endswith("?")
        paths = paths.removesuffix("?")
        paths = "|".join(before + path[1:] if path.startswith(".") else path for path in paths.split("|"))
        before = paths.partition("|")[0].rpartition(".")[0] + "." if "." in paths.partition("|")[0] else ""
        names = names if equals else paths.partition("|")[0].rpartition(".")[2]
        groups = tuple(tuple(filter(None, group.split(","))) for group in names.split(";"))
        keys.append(Key(paths, groups, optional))
    return Row(tuple(name.split("|")) if name != "-" else (), model, tuple(keys), written)


class Entry(NamedTuple):
    """A camera of a file: its pose in the file's frame if it has one, and the keys that were ignored."""

    camera: Camera
    pose: Pose | None = None
    time_offset: float = 0.0
    ignored: tuple[str, ...] = ()

    @property
    def mounted(self) -> RigCamera:
        """The camera of a rig."""
        return RigCamera(self.camera, self.pose or Pose(np.zeros(3), np.eye(3)), self.time_offset)


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
        poses: pairs of a path and a kind of :data:`POSES`, the first of which is written.
        time: path of the time offset, and its unit in seconds.
        readout: path of a rolling shutter's time, its unit in seconds, and whether it is that of one line.
        split: returns the cameras of a file by name; those that have the marks, if not given.
        join: returns the values to write from those of cameras by name; of the only one, if not given.
        dump: returns their text; by the syntax, if not given.
        harmless: a pattern of plain keys that look like geometry and are none.
        constant: values that every file of the form has, by path.
        finish: changes the numbers after they are read; raises for what is not modelled.
        stereo: adds the second camera of a rectified pair to those of a rig.
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
    readout: tuple[str, float, bool] | None = None
    split: Callable[[Content], dict[str, Any]] | None = None
    join: Callable[[dict[str, Values]], Any] | None = None
    dump: Callable[[Any], str] | None = None
    harmless: str = "$^"
    constant: Mapping[str, Any] = field(default_factory=dict)
    finish: Callable[[Node, str, Numbers, int, int], tuple[Numbers, tuple[int, int]]] | None = None
    stereo: Callable[[Node, dict[str, Entry]], dict[str, Entry]] | None = None
    sparse: bool = False
    refused: str = ""

    def is_of(self, content: Content) -> bool:
        """Return whether a file is of this form."""
        return bool(self.nodes(content))

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The models."""
        return rows_of(self.models)

    # -- reading -------------------------------------------------------------------------------

    def nodes(self, content: Content) -> dict[str, Node]:
        """Return the cameras of a file by name; none where it is of another form."""
        if self.split is not None:
            parts = self.split(content)
            return {name: part if isinstance(part, Node) else Node(part) for name, part in parts.items()}
        found: dict[str, Node] = {}
        for document in content.documents:
            for path, node in marked(document, self.mark.split()):
                name = next((str(part) for part in reversed(path) if isinstance(part, str)), "cam0")
                name = f"cam{path[-1]}" if path and isinstance(path[-1], int) else name
                while name in found:
                    name = f"cam{len(found)}" if name.startswith("cam") else f"{name}-{len(found)}"
                found[name] = node
        return found

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras of a file by name.

        Args:
            content: of the file.
            size: of the images, px, for files that do not hold it.

        Raises:
            ArgumentError: it is not of this form, or holds what we do not model.
        """
        nodes = self.nodes(content)
        if not nodes:
            if content.error is not None:
                raise content.error
            raise ArgumentError(f"{self.name}: expected keys {', '.join(self.mark.split())}, got others")
        entries: dict[str, Entry] = {}
        for name, node in nodes.items():
            if len(nodes) == 1 and not node.outer and name == "cam0":
                entries[name] = self.entry(node, size)
                continue
            with within(name):
                entries[name] = self.entry(node, size)
        return entries

    def entry(self, node: Node, size: tuple[int, int] | None) -> Entry:
        word = "+".join(str(node.take(path, "none", outer=True)) for path in self.word.split())
        width, height = self._size(node, size)
        row, values = self.row(node, word)
        if self.finish is not None:
            values, (width, height) = self.finish(node, word, values, width, height)
        camera = self.camera(row, width, height, values)
        if self.readout is not None:
            path, unit, of_line = self.readout
            seconds = unit * number(path, node.take(path, 0) or 0, least=0) * (height if of_line else 1)
            if seconds:
                camera = RollingShutter(width, height, camera, seconds)
        pose = self._pose(node)
        shift = 0.0
        if self.time is not None:
            shift = self.time[1] * number(self.time[0], node.take(self.time[0], 0.0) or 0.0)
        return Entry(camera, pose, shift, unread_keys(node, self.harmless))

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
        read, errors = [], []
        before = set(node.used)
        for row in fitting:
            node.used = set(before)
            try:
                values: Numbers = {}
                for key in row.keys:
                    values |= key.read(node)
                if not self.sparse:
                    _check_order(row, values)
                read.append((row, values, node.used))
            except ArgumentError as cause:
                errors.append(cause)
        if not read:
            raise errors[0]
        row, values, node.used = max(read, key=lambda one: len(one[1]))
        node.absent -= {used.rpartition(".")[2] for used in node.used}
        return row, values

    def _size(self, node: Node, size: tuple[int, int] | None) -> tuple[int, int]:
        paths = self.size.split()
        if len(paths) == 1:
            held = node.take(paths[0], None, outer=True)
            given = [None, None] if held is None else floats(paths[0].partition("|")[0], held)
        else:
            given = [node.take(path, None, outer=True) for path in paths]
            if given == [None, None] and (both := node.take(_SIZES, None, outer=True)) is not None:
                given = floats("size", both)
        names = [path.partition("|")[0] for path in (paths * 2)[:2]]
        if size is None:
            for name, value in zip(names, given, strict=False):
                if value is None:
                    raise ArgumentError(f"missing key {name!r}: add it, or give the size (--size)")
        if len(given) != 2:
            raise ArgumentError(f"{names[0]}: expected [width, height], got {shown(given)}")
        known = tuple(
            other if value is None else whole(name, value)
            for name, value, other in zip(names, given, size or (0, 0), strict=True)
        )
        if size is not None and known != tuple(size):
            raise ArgumentError(f"size: expected {known[0]} x {known[1]}, got {size[0]} x {size[1]}")
        return known[0], known[1]

    def _pose(self, node: Node) -> Pose | None:
        for path, kind in self.poses:
            if node.has(path):
                with within(path.partition("|")[0]):
                    value = node.take(path)
                    return POSES[kind][0](node.values if kind in _BESIDE else value)
        return None

    # -- writing -------------------------------------------------------------------------------

    def values_of(self, camera: Camera) -> Values:
        """Return the mapping of a camera.

        Raises:
            ArgumentError: the form cannot carry it.
        """
        values: Values = {}
        if (
            self.readout
            and isinstance(camera, RollingShutter)
            and not (camera.velocity.any() or camera.angular_velocity_deg.any())
        ):
            path, unit, of_line = self.readout
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
        for model, ours in intrinsics.intrinsics(camera):
            for row in self.rows:
                if row.written and row.model == model:
                    held = intrinsics.held(row.names, ours, camera.width, camera.height, self.shift)
                    if held is not None:
                        intrinsics.refuse_limit(camera)
                        return row, held
        known = ", ".join(dict.fromkeys(row.model for row in self.rows if row.written))
        raise ArgumentError(f"{self.name}: expected {known} whose numbers the form has, got {camera.name}")

    def write(self, cameras: Mapping[str, RigCamera], *, rig: bool = False) -> str:
        """Return the text of a file of cameras; with their poses and times for a rig.

        Raises:
            ArgumentError: the form cannot carry a camera, a name, or that there are several.
        """
        if rig and not self.poses:
            raise ArgumentError(f"{self.name}: expected a form that carries poses, got one that does not")
        if self.join is None and len(cameras) != 1:
            got = f"{len(cameras)}: {shown(list(cameras))}"
            raise ArgumentError(f"cameras: {self.name} holds one camera, got {got}")
        every: dict[str, Values] = {}
        for name, mounted in cameras.items():
            with within(name):
                every[name] = values = self.values_of(mounted.camera)
                if rig:
                    path, kind = self.poses[0]
                    written = POSES[kind][1](mounted.pose)
                    if kind in _BESIDE:
                        values |= written
                    else:
                        put(values, path.partition("|")[0], written)
                if rig and mounted.time_offset:
                    if self.time is None:
                        got = f"{mounted.time_offset:.15g}"
                        raise ArgumentError(
                            f"time_offset: expected 0, as {self.name} carries none, got {got}"
                        )
                    put(values, self.time[0], mounted.time_offset / self.time[1])
        document = next(iter(every.values())) if self.join is None else self.join(every)
        return self.dump(document) if self.dump is not None else SYNTAXES[self.syntax](document)


def unread_keys(node: Node, harmless: str = "$^") -> tuple[str, ...]:
    """Return the keys of a camera that are ignored.

    Args:
        node: the camera, after it was read.
        harmless: a pattern of plain keys that look like geometry and are none.

    Raises:
        ArgumentError: a key may change the geometry, and its value is not neutral.
    """
    ignored = []
    for path, value in node.unread():
        parts = plain(path).split(".")
        odd = any(map(_GEOMETRY.search, parts))
        odd &= (
            not _is_neutral(value, next(filter(_GEOMETRY.search, parts), ""))
            or re.search(r"[^\w.]\d", path) is not None
        )
        if (odd or _misspells(parts[-1], node.absent)) and not re.search(harmless, plain(path)):
            raise ArgumentError(
                f"{path}: expected no such key, which may change the geometry, got {shown(value)}"
            )
        ignored.append(path)
    return tuple(ignored)


def whole(name: str, value: object) -> int:
    """Return a number of pixels: a whole number, which may be given as a float or in digits."""
    size = number(name, value[0] if isinstance(value, list) and len(value) == 1 else value)
    return intrinsics.whole_number(name, int(size) if size.is_integer() else value)


def put(values: Values, path: str, value: Any) -> None:
    """Set a value at a path; keys that a dot belongs to start with ``Camera``, ``Stereo`` or ``File``."""
    *above, last = [path] if _DOTTED.match(path) else path.split(".")
    for key in above:
        values = values.setdefault(key, {})
    values[last] = value


def _canonical(words: str) -> tuple[str, ...]:
    return tuple(map(canonical, words.split("+")))


def _check_order(row: Row, values: Numbers) -> None:
    """Raise ArgumentError where a coefficient is missing before or beside one that is there: k1 of k2."""
    for key in row.keys:
        name = key.names[-1] if key.optional and len(key.names) == 1 else ""
        if name and name not in values and name[-1].isdigit():
            later = [other for other in values if other[:-1] == name[:-1] and other[-1] > name[-1]]
            beside = [other for other in values if (name, other) == ("p2", "p1")]
            if later or beside:
                raise ArgumentError(f"missing key {key.path!r}, as {(later or beside)[0]} is there")


def _misspells(key: str, absent: set[str]) -> bool:
    """Return whether a key that nobody knows is like one that is not there."""
    near = get_close_matches(key, absent, 1, 0.8) if len(key) > 2 else []
    like = [
        other
        for other in absent
        if (1 < len(key) == len(other) and sum(map(str.__ne__, key, other)) <= 1)
        or (1 < len(other) < len(key) < 5 and other in key)
    ]
    return bool(near or like) or sorted(key) in [sorted(other) for other in absent]


def _is_neutral(value: object, key: str) -> bool:
    """Return whether a value changes nothing: none, zero, a word for it, an identity, a ratio of 1."""
    if key.startswith(("fix", "zero")) or (
        re.search("aspect|stretch", key) and str(value) in ("1", "1.", "1.0")
    ):
        return True  # flags of OpenCV's calibration
    if value in (None, "") and re.match(r"[kps]\d", key):
        return False
    if value is None or (isinstance(value, str) and canonical(value) in ("none", "", "false", "global", "0")):
        return True
    try:
        values = floats("", value)
    except ArgumentError:
        return False
    side = int(len(values) ** 0.5)
    return not any(values) or (
        side > 1 and side**2 == len(values) and values == np.eye(side).ravel().tolist()
    )


def marked(
    value: Any,
    marks: Sequence[str],
    path: tuple[str | int, ...] = (),
    outer: tuple[Mapping[str, Any], ...] = (),
    accepts: Callable[[Node], bool] = lambda node: True,
) -> Iterator[tuple[tuple[str | int, ...], Node]]:
    """Yield the mappings that have all marks, outermost first, and where they stand."""
    if isinstance(value, Mapping):
        node = Node(value, outer)
        if all(node.has(mark) for mark in marks) and accepts(node):
            yield path, node
            return
        outer = (value, *outer)
    if isinstance(value, Mapping | list) and len(path) < 8:
        for key, below in value.items() if isinstance(value, Mapping) else enumerate(value):
            if isinstance(below, Mapping | list):
                yield from marked(below, marks, (*path, key), outer, accepts)


# -- poses ---------------------------------------------------------------------------------------------


def pose_of_matrix(value: object) -> Pose:
    """Return the pose of a 4 x 4 matrix, also of its first three rows."""
    rows = floats("matrix", value)
    if len(rows) == 12:
        rows += [0.0, 0.0, 0.0, 1.0]
    if len(rows) != 16 or rows[12:] != [0, 0, 0, 1]:
        raise ArgumentError(f"expected 4 x 4 numbers with a last row [0, 0, 0, 1], got {shown(value)}")
    matrix = np.array(rows).reshape(4, 4)
    return Pose(matrix[:3, 3], matrix[:3, :3])


def matrix_of_pose(pose: Pose) -> list[list[float]]:
    """Return the 4 x 4 matrix of a pose."""
    rows = np.column_stack([pose.rotation, pose.position]).tolist()
    return [*rows, [0.0, 0.0, 0.0, 1.0]]


def _by_keys(position: str, rotation: str) -> tuple[Callable[[Any], Pose], Callable[[Pose], Any]]:
    """Return reader and writer of a mapping with a position and a quaternion, by keys in order.

    Args:
        position: three keys, or that of a list.
        rotation: four keys x, y, z, w; or that of a list and the order of its numbers.
    """

    def read(value: Any) -> Pose:
        node = Node(value if isinstance(value, Mapping) else {})
        t = [v for key in position.split() for v in floats(key, node.take(key))]
        key, *order = rotation.split()
        if len(order) == 1:
            q = dict(zip(order[0], floats(key, node.take(key)), strict=True))
        else:
            q = {axis: number(key, node.take(key)) for axis, key in zip("xyzw", (key, *order), strict=True)}
        return Pose.from_quaternion(t, (q["x"], q["y"], q["z"], q["w"]))

    def write(pose: Pose) -> Values:
        q = dict(zip("xyzw", pose.quaternion(), strict=True))
        t, (key, *order) = pose.position.tolist(), rotation.split()
        turn = (
            {key: [q[axis] for axis in order[0]]}
            if len(order) == 1
            else dict(zip((key, *order), q.values(), strict=True))
        )
        names = position.split()
        return ({names[0]: t} if len(names) == 1 else dict(zip(names, t, strict=True))) | turn

    return read, write


def _aria_pose(value: Any) -> Pose:
    node = Node(value if isinstance(value, Mapping) else {})
    t, turn = node.take("Translation"), node.take("UnitQuaternion")
    if not isinstance(turn, list) or len(turn) != 2:
        raise ArgumentError(f"UnitQuaternion: expected [w, [x, y, z]], got {shown(turn)}")
    x, y, z = numbers("UnitQuaternion: [x, y, z]", turn[1], (3,)).tolist()
    return Pose.from_quaternion(
        numbers("Translation", t, (3,)), (x, y, z, number("UnitQuaternion: w", turn[0]))
    )


def _to_aria(pose: Pose) -> Values:
    x, y, z, w = pose.quaternion()
    return {"Translation": pose.position.tolist(), "UnitQuaternion": [w, [x, y, z]]}


POSES: dict[str, tuple[Callable[[Any], Pose], Callable[[Pose], Any]]] = {
    "T_b_c": (pose_of_matrix, matrix_of_pose),
    "T_c_b": (lambda value: pose_of_matrix(value).inverse(), lambda pose: matrix_of_pose(pose.inverse())),
    "px..qw": _by_keys("px py pz", "qx qy qz qw"),
    "xyzw": _by_keys("translation", "quaternion xyzw"),
    "wxyz": _by_keys("translation", "rotation wxyz"),  # whose keys stand beside the lens
    "aria": (_aria_pose, _to_aria),
}
"""Readers and writers of a camera's pose in the file's frame, by kind."""
_BESIDE = ("wxyz",)
