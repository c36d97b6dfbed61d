"""The mapping of a camera in a file: its keys in any spelling, its numbers, and what was not read."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np

from omniscv.arguments import number, numbers, shown, wrong
from omniscv.arguments import whole_number as checked_whole
from omniscv.calibration import acting_keys
from omniscv.calibration.documents import Content
from omniscv.errors import ArgumentError

Values = dict[str, Any]

Paths = str | tuple[str, ...]
"""A place in a mapping: keys joined by dots, as ``a.b``. Several are alternatives; the first is the one that
we write and that messages name."""

_SYNONYMS = {
    "radtan": "plumbbob radialtangential radialtangential4 radialtangential5 brownconrady brown opencv "
    "radtan4 radtan5 radtan8 rational rationalpolynomial opencvstandard standard opencvpinhole rectilinear",
    "equidistant": "equi kannalabrandt kannalabrandt4 kannalabrandt8 kb kb4 kb8 fisheye "
    "opencvfisheye fisheyeopencv fisheyekb4",
    "none": "undistorted nodistortion null no ideal rectified",
}
_CANONICAL: dict[str, str] = {}
for _word, _synonyms in _SYNONYMS.items():
    _CANONICAL.update(dict.fromkeys(_synonyms.split(), _word))

MISSING = object()
_DEEPEST = 8  # levels of mappings and lists in which cameras are looked for
_MOST_ROWS = 64  # of a list of lists of numbers
_MOST_PX = 1_000_000  # of a side of an image


def alternatives(paths: Paths) -> tuple[str, ...]:
    """Return the paths of a place."""
    return (paths,) if isinstance(paths, str) else paths


def first_path(paths: Paths) -> str:
    """Return the path of a place that is written, and named in messages."""
    return alternatives(paths)[0]


def plain(key: str) -> str:
    """Return a key in lower case without signs between its words."""
    return re.sub(r"[-_ ]", "", key).lower()


def canonical(word: object) -> str:
    """Return the canonical word of a model: synonyms that are certain, in any case."""
    text = "none" if word is None else str(word).lower()
    text = re.sub(r"[^a-z0-9]|^distortion\.", "", text)
    return _CANONICAL.get(text, text)


class Node:
    """The mapping of a camera, and which of its keys were read.

    Args:
        values: the mapping.
        outer: mappings around it, which may hold the size.

    Attributes:
        used: plain paths that were read.
        absent: plain keys that models of the form have and the file has not.
        modelled: plain paths of all models of the form that the camera may be.
    """

    def __init__(self, values: Mapping[str, Any], outer: Sequence[Mapping[str, Any]] = ()) -> None:
        self.values = values
        self.outer = outer

        self.used: set[str] = set()
        self.absent: set[str] = set()
        self.modelled: set[str] = set()

    def take(self, paths: Paths, default: Any = MISSING, outer: bool = False) -> Any:
        """Return the value at a place, which counts as read from then on.

        Args:
            paths: the place; in any spelling of its keys.
            default: what is returned where there is no value.
            outer: whether the mappings around the camera's own are tried after it.

        Raises:
            ArgumentError: there is no value and no default, or two alternatives have different values.
        """
        found = self._matches(paths, self.values)
        for values in self.outer if outer else ():
            if not found:
                found = self._matches(paths, values)
        if not found:
            if default is MISSING:
                raise ArgumentError(f"missing key {first_path(paths)!r}")
            return default
        self.used |= {plain(path) for path, _ in found}
        first = found[0][1]
        if any(not _agree(value, first) for _, value in found):
            both = " and ".join(path for path, _ in found)
            raise ArgumentError(f"{both}: expected one of them, got both with different values")
        return first

    @staticmethod
    def _matches(paths: Paths, values: Mapping[str, Any]) -> list[tuple[str, Any]]:
        """Return the paths of a place that a mapping has, and their values."""
        matches = []
        for path in alternatives(paths):
            for value in _at(values, path):
                matches.append((path, value))
        return matches

    def has(self, paths: Paths) -> bool:
        """Return whether the camera's own mapping has a value at a place."""
        return bool(self._matches(paths, self.values))

    def unread(self) -> Iterator[tuple[str, Any]]:
        """Yield paths and values that were not taken; of the mapping around the camera only geometry."""
        for path, value in leaves(self.values):
            if not self._is_used(path):
                yield path, value
        for path, value in leaves(self._beside()):
            if not self._is_used(path) and any(map(acting_keys.GEOMETRY.search, plain(path).split("."))):
                yield path, value

    def _is_used(self, path: str) -> bool:
        """Return whether a path, or a mapping above it, was taken."""
        key = plain(path)
        return any(key == used or key.startswith(f"{used}.") for used in self.used)

    def _beside(self) -> Values:
        """Return what stands beside the camera in the mapping around it, other cameras aside."""
        beside: Values = {}
        for key, value in self.outer[0].items() if self.outer else ():
            is_camera = isinstance(value, Mapping) and value.keys() & self.values.keys()
            if not is_camera:
                beside[key] = value
        return beside

    def check_rest(self, harmless: str = "$^", form: str = "") -> tuple[str, ...]:
        """Return the paths of keys that are ignored.

        Args:
            harmless: a pattern of plain paths that look like geometry and are none.
            form: name of the form, for :func:`omniscv.calibration.acting_keys.is_acting`.

        Raises:
            ArgumentError: a key that may change the geometry and is not neutral, or a misspelt one.
        """
        self.check_acting(form)
        ignored = []
        for path, value in self.unread():
            if self._may_act(path, value) and not re.search(harmless, plain(path)):
                raise wrong(path, "no such key, which may change the geometry", value)
            ignored.append(path)
        return tuple(ignored)

    def check_acting(self, form: str, topics: Collection[str] = tuple(acting_keys.TOPICS)) -> None:
        """Raise ArgumentError for a key that was not read, is not neutral and may change what is seen.

        Args:
            form: name of the form.
            topics: of :data:`omniscv.calibration.acting_keys.TOPICS`.
        """
        for path, value in leaves(self.values):
            key = plain(path)
            if self._is_used(path) or not acting_keys.is_acting(key, form, topics):
                continue
            if not _is_neutral(value, key):
                raise wrong(path, "no such key, which may change what is seen", value)

    def _may_act(self, path: str, value: object) -> bool:
        """Return whether a key that was not read may change the geometry: by its name, or as a misspelt
        one."""
        key = plain(path)
        words = key.split(".")
        geometric = [word for word in words if acting_keys.GEOMETRY.search(word)]
        acting = [*geometric, key] if key in self.modelled else geometric
        if any(not _is_neutral(value, word) for word in acting):
            return True
        if geometric and re.search(r"[^\w.]\d", path):
            return True
        is_zero = re.fullmatch(r"[kps]\d", words[-1]) and _is_neutral(value, words[-1])
        return not is_zero and self._misspells(words[-1])

    def _misspells(self, key: str) -> bool:
        """Return whether a key that nobody knows is like one that is not there."""
        if any(sorted(key) == sorted(other) for other in self.absent):
            return True
        if len(key) < 2:
            return False
        words = [other for other in self.absent if len(other) > 1]
        return bool(get_close_matches(key, words, 1, 0.8 if len(key) > 4 else 0.5))


def _at(values: Any, path: str) -> Iterator[Any]:
    """Yield the values at a path, whose dots may stand in keys or between mappings."""
    if not isinstance(values, Mapping):
        return
    for key, value in values.items():
        if plain(key) == plain(path):
            yield value
    words = path.split(".")
    for i in range(1, len(words)):
        head = plain(".".join(words[:i]))
        for key, below in values.items():
            if plain(key) == head:
                yield from _at(below, ".".join(words[i:]))


def leaves(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield paths and values of nested mappings; matrices with ``data`` are values.

    Args:
        values: the outermost mapping.
        before: what each path starts with, as ``a.``.
    """
    for key, value in values.items():
        if isinstance(value, Mapping) and value and "data" not in value:
            yield from leaves(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def _agree(value: object, other: object) -> bool:
    """Return whether two values are the same, also of numbers in other brackets."""
    try:
        return value == other or floats("", value) == floats("", other)
    except ArgumentError:
        return False


def _is_neutral(value: object, key: str) -> bool:
    """Return whether a value changes nothing: none, zero, a word for it, an identity, a ratio of 1."""
    if key.startswith(("fix", "zero")):  # flags of OpenCV's calibration
        return True
    if str(value) in ("1", "1.", "1.0") and re.search("aspect|stretch", key):
        return True
    if value in (None, "") and re.match(r"[kps]\d", key):
        return False
    if value is None or value is False:
        return True
    if isinstance(value, str) and canonical(value) in ("none", "", "false", "global", "0"):
        return True
    return _has_neutral_numbers(value, key)


def _has_neutral_numbers(value: object, key: str) -> bool:
    """Return whether a value's numbers are 0, an identity, or a projection of ``cv2.stereoRectify``."""
    try:
        values = floats("", value)
    except ArgumentError:
        return False
    if len(values) == 12 and re.fullmatch(r"p\d", key):
        return True
    side = int(len(values) ** 0.5)
    is_identity = side > 1 and values == np.eye(side).ravel().tolist()
    return is_identity or not any(values)


# -- numbers -------------------------------------------------------------------------------------------


def floats(name: str, value: object) -> list[float]:
    """Return the numbers of a scalar, a text of them, nested lists, or a matrix with its ``data``.

    Args:
        name: what messages call the value.
        value: as a file has it.

    Raises:
        ArgumentError: anything else.
    """
    if isinstance(value, Mapping):
        if value.keys() == {"x", "y"}:
            value = [value["x"], value["y"]]
        elif "data" in value:
            name = f"{name}: data"
            value = value["data"]
        else:
            raise ArgumentError(f"{name}: missing key 'data'")
    if isinstance(value, str):
        value = _words(value)
    if not isinstance(value, list):
        return [number(name, value)]
    flat = _flat(name, value)
    return numbers(name, flat, (len(flat),)).tolist() if flat else []


def _words(text: str) -> list[str]:
    """Return the words of a list in brackets or without."""
    inside = re.sub(r"^\s*[\[(](.*)[\])]\s*$", r"\1", text.strip()).strip()
    return re.split(r"[\s,;]+", inside) if inside else []


def _flat(name: str, value: list[Any]) -> list[Any]:
    """Return the items of nested lists, row by row; ArgumentError for rows beside items, or too many."""
    while any(isinstance(row, list) for row in value):
        if len(value) > _MOST_ROWS or not all(isinstance(row, list) for row in value):
            raise ArgumentError(f"{name}: expected numbers, got {shown(value)}")
        rows = value
        value = []
        for row in rows:
            value += row
    return value


def whole(name: str, value: object) -> int:
    """Return a number of pixels: a whole number, which may be given as a float or in digits.

    Args:
        name: what messages call the value.
        value: as a file has it, or a list of it alone.

    Raises:
        ArgumentError: no number, none that is whole, or one that is no side of an image.
    """
    item = value[0] if isinstance(value, list) and len(value) == 1 else value
    size = number(name, item)
    return checked_whole(name, int(size) if size.is_integer() else value, most=_MOST_PX)


# -- where cameras stand -------------------------------------------------------------------------------


def marked(
    value: Any,
    marks: Sequence[Paths],
    path: tuple[str | int, ...] = (),
    outer: tuple[Mapping[str, Any], ...] = (),
    accepts: Callable[[Node], bool] = lambda node: True,
) -> Iterator[tuple[tuple[str | int, ...], Node]]:
    """Yield the mappings that have all marks, outermost first, and where they stand.

    Args:
        value: a mapping or a list, in which it looks down to eight levels.
        marks: places that a camera's mapping has.
        path: keys and indices that led to the value.
        outer: mappings around the value, the nearest first.
        accepts: whether a mapping that has the marks is a camera.
    """
    if isinstance(value, Mapping):
        node = Node(value, outer)
        if all(node.has(mark) for mark in marks) and accepts(node):
            yield path, node
            return
        outer = (value, *outer)
    if not isinstance(value, Mapping | list) or len(path) >= _DEEPEST:
        return
    for key, below in value.items() if isinstance(value, Mapping) else enumerate(value):
        if isinstance(below, Mapping | list):
            yield from marked(below, marks, (*path, key), outer, accepts)


def mappings(content: Content, *marks: Paths) -> list[Node]:
    """Return the documents that have all marks.

    Args:
        content: the file.
        marks: places that a document has.
    """
    nodes = []
    for document in content.documents:
        if isinstance(document, Mapping):
            node = Node(document)
            if all(node.has(mark) for mark in marks):
                nodes.append(node)
    return nodes


def families(values: Mapping[str, Any], pattern: str) -> tuple[dict[str, Values], Values]:
    """Return the mappings of cameras whose keys stand side by side, such as K1 and D1, and the other keys.

    Args:
        values: a mapping that holds several cameras.
        pattern: of plain keys, with groups ``key``, ``name`` and ``after``, which may be the name as well.
    """
    cameras: dict[str, Values] = {}
    others: Values = {}
    for key, value in values.items():
        match = re.fullmatch(pattern, plain(key))
        name = (match["name"] or match["after"]) if match else ""
        if match and name and isinstance(value, Mapping | list | str):
            cameras.setdefault(name, {})[match["key"]] = value
        else:
            others[key] = value
    return cameras, others


def put(values: Values, path: str, value: Any) -> None:
    """Set a value at a path.

    Args:
        values: the mapping that gets it.
        path: keys joined by dots; keys that a dot belongs to start with ``Camera``, ``Stereo`` or ``File``.
        value: as it is written.
    """
    if _DOTTED.match(path):
        values[path] = value
        return
    *above, last = path.split(".")
    for key in above:
        values = values.setdefault(key, {})
    values[last] = value


_DOTTED = re.compile(r"Camera1\.|Camera\.(?:type|width|height)$|Stereo\.|File\.")
