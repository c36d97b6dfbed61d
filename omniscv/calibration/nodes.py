"""The mapping of a camera in a file: its keys in any spelling, its numbers, and what was not read."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import accumulate, chain
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import number, numbers, shown, wrong
from omniscv.arguments import whole_number as checked_whole
from omniscv.calibration.documents import Content
from omniscv.cameras.lens_parameters import Numbers
from omniscv.errors import ArgumentError

Values = dict[str, Any]

_SYNONYMS = {
    "radtan": "plumbbob radialtangential radialtangential4 radialtangential5 brownconrady brown opencv "
    "radtan4 radtan5 radtan8 rational rationalpolynomial opencvstandard standard opencvpinhole rectilinear",
    "equidistant": "equi kannalabrandt kannalabrandt4 kannalabrandt8 kb kb4 kb8 fisheye "
    "opencvfisheye fisheyeopencv fisheyekb4",
    "none": "undistorted nodistortion null no ideal rectified",
}
_CANONICAL = {word: canon for canon, words in _SYNONYMS.items() for word in words.split()}

_GEOMETRY = re.compile(
    r"skew|tilt|shear|^dist(?!anc|ribut)|distort|tangential|prism|radial|windshield|binning|^roi|crop|rectif|"
    r"mirror|linedelay|readout|shutter(?!us$|speed)|stretch|aspect|decenter|affine|^poly|^coef|^([kps]\W?\d.*|xi|alpha|beta|omega|fov)$"
)
"""Plain keys that may change the geometry: refused unless a row models them or they are neutral."""

MISSING = object()


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
        self.values = values
        self.outer = outer
        self.used: set[str] = set()
        self.absent: set[str] = set()  # what models have and the file has not
        self.modelled: set[str] = set()  # what another model of the form has

    def take(self, paths: str, default: Any = MISSING, outer: bool = False) -> Any:
        """Return the value at one of several paths, ``a|b``; ArgumentError where there is none and no
        default, or two with different values."""
        found: list[tuple[str, Any]] = []
        for values in (self.values, *(self.outer if outer else ())):
            found = found or [(path, value) for path in paths.split("|") for value in _at(values, path)]
        self.used |= {plain(path) for path, _ in found}
        if any(not _agree(value, found[0][1]) for _, value in found):
            both = " and ".join(path for path, _ in found)
            raise ArgumentError(f"{both}: expected one of them, got both with different values")
        if not found and default is MISSING:
            raise ArgumentError(f"missing key {paths.partition('|')[0]!r}")
        return found[0][1] if found else default

    def has(self, paths: str) -> bool:
        """Return whether one of several paths is there."""
        return any(True for path in paths.split("|") for _ in _at(self.values, path))

    def unread(self) -> Iterator[tuple[str, Any]]:
        """Yield the keys that were not taken, and their values; of those beside it only what is geometry."""
        beside = {
            key: value  # but for other cameras
            for key, value in (self.outer[0] if self.outer else {}).items()
            if not (isinstance(value, Mapping) and value.keys() & self.values.keys())
        }
        for values in (self.values, beside):
            for path, value in leaves(values):
                key = plain(path)
                if any(key == used or key.startswith(f"{used}.") for used in self.used):
                    continue
                if values is self.values or any(map(_GEOMETRY.search, key.split("."))):
                    yield path, value

    def check_rest(self, harmless: str = "$^") -> tuple[str, ...]:
        """Return the keys that are ignored; ArgumentError for one that may change the geometry and is not
        neutral, but for those that match the pattern ``harmless``."""
        ignored = []
        for path, value in self.unread():
            parts = plain(path).split(".")
            acting = [*filter(_GEOMETRY.search, parts), *({plain(path)} & self.modelled)]
            odd = any(not _is_neutral(value, part) for part in acting) or (
                re.search(r"[^\w.]\d", path) is not None and any(map(_GEOMETRY.search, parts))
            )
            is_zero = re.fullmatch(r"[kps]\d", parts[-1]) and _is_neutral(value, parts[-1])
            if (odd or (not is_zero and self._misspells(parts[-1]))) and not re.search(harmless, plain(path)):
                raise wrong(path, "no such key, which may change the geometry", value)
            ignored.append(path)
        return tuple(ignored)

    def _misspells(self, key: str) -> bool:
        """Return whether a key that nobody knows is like one that is not there."""
        words = [other for other in self.absent if len(other) > 1 < len(key)]
        near = get_close_matches(key, words, 1, 0.8 if len(key) > 4 else 0.5)
        return bool(near) or sorted(key) in map(sorted, self.absent)


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


def leaves(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield paths and values of nested mappings; matrices with ``data`` are values."""
    for key, value in values.items():
        if isinstance(value, Mapping) and value and "data" not in value:
            yield from leaves(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def _agree(one: object, other: object) -> bool:
    """Return whether two values are the same, also of numbers in other brackets."""
    try:
        return one == other or floats("", one) == floats("", other)
    except ArgumentError:
        return False


def _is_neutral(value: object, key: str) -> bool:
    """Return whether a value changes nothing: none, zero, a word for it, an identity, a ratio of 1."""
    is_one = str(value) in ("1", "1.", "1.0") and re.search("aspect|stretch", key)
    if is_one or key.startswith(("fix", "zero")):  # flags of OpenCV's calibration
        return True
    if value in (None, "") and re.match(r"[kps]\d", key):
        return False
    if value is None or (isinstance(value, str) and canonical(value) in ("none", "", "false", "global", "0")):
        return True
    try:
        values = floats("", value)
    except ArgumentError:
        return False
    if len(values) == 12 and re.fullmatch(r"p\d", key):  # a projection of cv2.stereoRectify
        return True
    side = int(len(values) ** 0.5)
    return not any(values) or (side > 1 and values == np.eye(side).ravel().tolist())


# -- numbers -------------------------------------------------------------------------------------------


def floats(name: str, value: object) -> list[float]:
    """Return the numbers of a scalar, a text of them, nested lists, or a matrix with its ``data``."""
    if isinstance(value, Mapping) and value.keys() == {"x", "y"}:
        value = [value["x"], value["y"]]
    if isinstance(value, Mapping):
        if "data" not in value:
            raise ArgumentError(f"{name}: missing key 'data'")
        name = f"{name}: data"
        value = value["data"]
    if isinstance(value, str):
        text = re.sub(r"^\s*[\[(](.*)[\])]\s*$", r"\1", value.strip())
        value = re.split(r"[\s,;]+", text.strip()) if text.strip() else []
    if not isinstance(value, list):
        return [number(name, value)]
    while any(isinstance(row, list) for row in value):
        if len(value) > 64 or not all(isinstance(row, list) for row in value):
            raise ArgumentError(f"{name}: expected numbers, got {shown(value)}")
        value = [item for row in value for item in row]
    return numbers(name, value, (len(value),)).tolist() if value else []


def whole(name: str, value: object) -> int:
    """Return a number of pixels: a whole number, which may be given as a float or in digits."""
    size = number(name, value[0] if isinstance(value, list) and len(value) == 1 else value)
    return checked_whole(name, int(size) if size.is_integer() else value, most=1_000_000)


# -- where cameras stand -------------------------------------------------------------------------------


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


def mappings(content: Content, marks: str) -> list[Node]:
    """Return the documents that have all marks."""
    nodes = [Node(value) for value in content.documents if isinstance(value, Mapping)]
    return [node for node in nodes if all(node.has(mark) for mark in marks.split())]


def families(values: Mapping[str, Any], pattern: str) -> tuple[dict[str, Values], Values]:
    """Return the mappings of cameras whose keys stand side by side, such as K1 and D1, and the other keys;
    the pattern of plain keys has groups ``key``, ``name`` and ``after``, which may be the name as well."""
    cameras: dict[str, Values] = {}
    others: Values = {}
    for key, value in values.items():
        match = re.fullmatch(pattern, plain(key))
        if match and (name := match["name"] or match["after"]) and isinstance(value, Mapping | list | str):
            cameras.setdefault(name, {})[match["key"]] = value
        else:
            others[key] = value
    return cameras, others


def put(values: Values, path: str, value: Any) -> None:
    """Set a value at a path; keys that a dot belongs to start with ``Camera``, ``Stereo`` or ``File``."""
    *above, last = [path] if _DOTTED.match(path) else path.split(".")
    for key in above:
        values = values.setdefault(key, {})
    values[last] = value


_DOTTED = re.compile(r"Camera1\.|Camera\.(?:type|width|height)$|Stereo\.|File\.")


class Key(NamedTuple):
    """Where numbers of a model stand.

    Attributes:
        paths: the first is written.
        names: of the numbers, or literals.
        counts: how many of them may be there.
        optional: whether all may be missing.
    """

    paths: str
    names: tuple[str, ...]
    counts: tuple[int, ...]
    optional: bool

    @property
    def path(self) -> str:
        """The path that is written, and named in messages."""
        return self.paths.partition("|")[0]

    def read(self, node: Node) -> Numbers:
        """Return the numbers that a camera has here; ArgumentError for another count or value."""
        if not node.has(self.paths):
            node.absent |= {plain(path.rpartition(".")[2]) for path in self.paths.split("|")}
        value = node.take(self.paths, None if self.optional else MISSING, outer=True)
        values = [] if value is None else floats(self.path, value)
        if not values and self.optional:
            return {}
        if len(values) not in self.counts:
            wanted = f"{' or '.join(map(str, self.counts))} finite numbers ({','.join(self.names)})"
            raise ArgumentError(f"{self.path}: expected {wanted}, got {len(values)}: {shown(value)}")
        for name, got in zip(self.names, values, strict=False):
            if _is_literal(name) and abs(got - float(name)) > 1e-12:
                raise wrong(self.path, f"{name} (other values are not modelled)", got)
        return dict(zip(self.names, values, strict=False))

    def write(self, values: Numbers) -> Any:
        """Return the value to write: a number or a list up to the first end beyond its last number."""
        every = [float(name) if _is_literal(name) else values.get(name, 0.0) for name in self.names]
        if self.counts == (1,):
            return every[0]
        last = max((i + 1 for i, value in enumerate(every) if value), default=0)
        return every[: next(count for count in self.counts if count >= last)]


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


def row_of(line: str) -> Row:
    """Return the model of a line ``WORDS MODEL KEYS``, such as ``PINHOLE|pinhole pinhole fx fy cx cy``: the
    file's words for it, ``-`` for none, ours, and its keys; ``<`` before them: it is read, not written."""
    words = line.split()
    written = words[0] != "<"
    name, model, *fields = words if written else words[1:]
    return Row(tuple(name.split("|")) if name != "-" else (), model, keys_of(" ".join(fields)), written)


def keys_of(text: str) -> tuple[Key, ...]:
    """Return the keys of ``PATH=NAMES ...``, such as ``K=fx,0,cx,0,fy,cy D?=k1,k2,k3,k4;0``.

    Of paths ``a|b`` the first is written; ``.x`` is beside the key before; ``?``: all numbers may be missing.
    Names are ours, the path's last word by default; ``;`` is where a list may end, too; a digit is a value
    that must be there, ``_`` one that does not matter.
    """
    keys = []
    before = ""
    for word in text.split():
        paths, equals, names = word.partition("=")
        optional = paths.endswith("?")
        paths = paths.removesuffix("?")
        paths = "|".join(before + path[1:] if path.startswith(".") else path for path in paths.split("|"))
        head, dot, last = paths.partition("|")[0].rpartition(".")
        before = head + dot
        groups = [list(filter(None, group.split(","))) for group in (names if equals else last).split(";")]
        keys.append(Key(paths, tuple(chain(*groups)), tuple(accumulate(map(len, groups))), optional))
    return tuple(keys)


_TOGETHER = {("p2", "p1"), ("k2", "p1"), ("k1", "p1")}


def check_order(row: Row, values: Numbers) -> None:
    """Raise ArgumentError where a coefficient is missing before or beside one that is there: k1 of k2."""
    for key in row.keys:
        name = key.names[-1] if key.optional and len(key.names) == 1 else ""
        if name and name not in values and name[-1].isdigit():
            later = [other for other in values if other[:-1] == name[:-1] and other[-1] > name[-1]]
            beside = [other for other in values if (name, other) in _TOGETHER]
            if later or beside:
                raise ArgumentError(f"missing key {key.path!r}, as {(later or beside)[0]} is there")
