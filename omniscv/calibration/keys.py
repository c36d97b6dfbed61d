"""What the keys of a lens file act on: numbers of our models, by name, and the models that they make up.

A form of :mod:`omniscv.calibration.table` is built of these values::

    Model(
        "kannala-brandt",
        words=("fisheye",),
        keys=(scalar("fl_x", "fx"), scalar("fl_y", "fy"), array("center", "cx", "cy"), *scalars("k1", "k2")),
    )

is the model that the file calls ``fisheye``: its key ``fl_x`` holds fx, its list ``center`` cx and cy, and
its keys ``k1`` and ``k2`` numbers of the same names.
"""

from dataclasses import dataclass
from typing import Any, Final, Literal

from omniscv.arguments import shown, wrong
from omniscv.calibration.nodes import MISSING, Node, Paths, alternatives, floats, plain
from omniscv.cameras.lens_parameters import Numbers
from omniscv.errors import ArgumentError

OurNumber = Literal[
    "fx", "fy", "cx", "cy",
    "k", "k0", "k1", "k2", "k3", "k4", "k5", "k6", "p0", "p1", "p2", "s0", "s1", "s2", "s3", "s4",
    "xi", "alpha", "beta", "omega",
    "a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7", "a8", "a9",
    "a10", "a11", "a12", "a13", "a14", "a15", "a16", "a17", "a18", "a19",
    "c", "d", "e", "c0", "c1", "c2", "c3", "c4", "c5", "lc", "ld", "le",
]  # fmt: skip
"""Numbers of our models: see :class:`omniscv.cameras.lens_parameters.Parameters`."""

FileNumber = Literal[
    "f", "s", "ratio", "du", "dv", "du0", "dv0", "f_y", "b1", "nf", "nfx", "nfy", "ncx", "ncy", "mm", "fov",
    "rad", "sensor", "angle", "angle_y", "_",
]  # fmt: skip
"""Numbers of files from which ours follow.

``sensor`` is the sensor's width, mm; ``angle`` and ``angle_y`` are the fields of view from side to side and
from top to bottom, radians; the others are those of :data:`omniscv.calibration.intrinsics.DERIVED`.
"""

SizeNumber = Literal["W", "H", "W/2", "H/2"]
"""Width and height of the image, px, and half of them."""

PoseNumber = Literal["x", "y", "z", "qx", "qy", "qz", "qw"]
"""Numbers of a pose: metres, and a quaternion of length 1."""

Number = OurNumber | FileNumber | SizeNumber | PoseNumber

ANY: Final = "_"
"""The number of a value that does not matter."""

MATRIX: tuple[Number, ...] = ("fx", "fy", "cx", "cy")
RADTAN4: tuple[Number, ...] = ("k1", "k2", "p1", "p2")
RADTAN5: tuple[Number, ...] = (*RADTAN4, "k3")
RADTAN8: tuple[Number, ...] = (*RADTAN4, "k3", "k4", "k5", "k6")
FISHEYE4: tuple[Number, ...] = ("k1", "k2", "k3", "k4")
"""Numbers that many forms hold in this order."""

ModelName = Literal[
    "division", "double-sphere", "equirectangular", "extended-unified", "field-of-view", "fisheye624",
    "ftheta", "ftheta-inverse", "kannala-brandt", "pinhole", "scaramuzza", "unified",
]  # fmt: skip
"""Our models that files hold; ``ftheta-inverse`` is ``ftheta`` with ``reference="pixel-to-angle"``."""


@dataclass(frozen=True)
class Key:
    """Numbers of a camera at one place of its mapping.

    Attributes:
        paths: alternatives of the place; the first is written, and named in messages.
        numbers: what the values there are, in order: names, or whole numbers, which must be there as they
            are.
        counts: how many values may be there, least first.
        optional: whether all may be missing.
        is_list: whether a list is written even where there is one number.
    """

    paths: tuple[str, ...]
    numbers: tuple[Number | int, ...]
    counts: tuple[int, ...]
    optional: bool = False
    is_list: bool = True

    @property
    def path(self) -> str:
        """The path that is written, and named in messages."""
        return self.paths[0]

    def read(self, node: Node) -> list[float]:
        """Return the values that a camera's mapping has at this key; empty if an optional key is missing.

        Args:
            node: the camera's mapping, which notes that the paths are used, or absent.

        Raises:
            ArgumentError: the key is missing, or has another count of values or another fixed value.
        """
        if not node.has(self.paths):
            node.absent |= {plain(path.rpartition(".")[2]) for path in self.paths}
        value = node.take(self.paths, None if self.optional else MISSING, outer=True)
        values = [] if value is None else floats(self.path, value)
        if not values and self.optional:
            return []
        if len(values) not in self.counts:
            raise ArgumentError(
                f"{self.path}: expected {self._expected()}, got {len(values)}: {shown(value)}"
            )
        for expected, number in zip(self.numbers, values, strict=False):
            if isinstance(expected, int) and abs(number - expected) > 1e-12:
                raise wrong(self.path, f"{expected} (other values are not modelled)", number)
        return values

    def named(self, values: list[float]) -> Numbers:
        """Return the numbers of values that :meth:`read` returned, by name."""
        numbers: Numbers = {}
        for name, number in zip(self.numbers, values, strict=False):
            if isinstance(name, str):
                numbers[name] = number
        return numbers

    def _expected(self) -> str:
        """Return what should be here, for a message."""
        counts = " or ".join(map(str, self.counts))
        names = ",".join(map(str, self.numbers))
        return f"{counts} finite numbers ({names})"

    def write(self, numbers: Numbers) -> Any:
        """Return the value to write: a number, or a list up to the least count that loses no number but 0.

        Args:
            numbers: by name; those missing are 0.
        """
        values: list[float] = []
        needed = 0
        for name in self.numbers:
            values.append(float(name) if isinstance(name, int) else numbers.get(name, 0.0))
            if values[-1]:
                needed = len(values)
        if not self.is_list:
            return values[0]
        return values[: next(count for count in self.counts if count >= needed)]


def scalar(paths: Paths, number: Number | int, *, optional: bool = False) -> Key:
    """Return the key of a place that holds one number.

    Args:
        paths: the place, as ``a.b``, or alternatives.
        number: what the value is.
        optional: whether it may be missing.
    """
    return Key(alternatives(paths), (number,), (1,), optional, is_list=False)


def scalars(*numbers: Number, below: str = "", optional: bool = False) -> tuple[Key, ...]:
    """Return the keys of numbers that a file calls as we do.

    Args:
        numbers: names of keys and of numbers.
        below: the path of the mapping that has them, if not the camera's own.
        optional: whether each of them may be missing.
    """
    keys = []
    for number in numbers:
        keys.append(scalar(f"{below}.{number}" if below else number, number, optional=optional))
    return tuple(keys)


def array(
    paths: Paths, *numbers: Number | int, counts: tuple[int, ...] | None = None, optional: bool = False
) -> Key:
    """Return the key of a place that holds a list of numbers, or a matrix row by row.

    Args:
        paths: the place, as ``a.b``, or alternatives.
        numbers: what the values are, in order.
        counts: how many of them may be there, least first; None: all.
        optional: whether the list may be missing.
    """
    return Key(alternatives(paths), numbers, (len(numbers),) if counts is None else counts, optional)


Word = str | tuple[str, ...]
"""A file's word for a model; several where a form splits it among several keys."""


@dataclass(frozen=True)
class Model:
    """One of our models in files of a form.

    Attributes:
        name: ours.
        words: the file's words for it, of which the first is written; none where the form has no word.
        keys: where its numbers stand.
        read_only: whether cameras are not written so.
    """

    name: ModelName
    keys: tuple[Key, ...] = ()
    words: tuple[Word, ...] = ()
    read_only: bool = False

    @property
    def numbers(self) -> list[str]:
        """Names of the numbers that it holds."""
        names: list[str] = []
        for key in self.keys:
            names += [name for name in key.numbers if isinstance(name, str) and name != ANY]
        return names


def parts(word: Word) -> tuple[str, ...]:
    """Return a word by the keys that hold it."""
    return (word,) if isinstance(word, str) else word


_TOGETHER = {("p2", "p1"), ("k2", "p1"), ("k1", "p1")}
"""Pairs of numbers of which the first is not left out where the second is there."""


def check_order(model: Model, numbers: Numbers) -> None:
    """Raise ArgumentError where a coefficient is missing before or beside one that is there: k1 of k2.

    Args:
        model: its keys that hold one number each and may be missing are checked.
        numbers: those that a file has, by name.
    """
    for key in model.keys:
        name = key.numbers[-1]
        if not key.optional or len(key.numbers) > 1 or isinstance(name, int):
            continue
        if name in numbers or not name[-1].isdigit():
            continue
        later = [other for other in numbers if other[:-1] == name[:-1] and other[-1] > name[-1]]
        beside = [other for other in numbers if (name, other) in _TOGETHER]
        for other in [*later, *beside]:
            raise ArgumentError(f"missing key {key.path!r}, as {other} is there")
