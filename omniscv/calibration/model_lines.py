"""The models of a form, as text: where their numbers stand in a file, and how they are read and written.

The models of a form are lines ``WORD MODEL PATH=NAMES ...``: the form's word (``A|B`` are synonyms, the
first is written), our model, and where the numbers stand. A path is ``a.b``, in one key or nested, ``a|b``
for alternatives, ``.c`` beside the last one, and ends with ``?`` where it may be missing (its numbers are 0
then). Names are those of :mod:`omniscv.calibration.intrinsics`; ``a,b;c`` is a list that may end at the
semicolon; a literal is a value that must stand there, ``_`` one that does not matter. A line after ``<`` is
read, not written.
"""

from itertools import accumulate, chain
from typing import Any, NamedTuple

from omniscv.arguments import shown
from omniscv.calibration.nodes import MISSING, Node, floats, plain
from omniscv.cameras.lens_parameters import Numbers
from omniscv.errors import ArgumentError


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
            wanted = " or ".join(map(str, self.counts))
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
    """Return the model of a line."""
    words = line.split()
    written = words[0] != "<"
    name, model, *fields = words if written else words[1:]
    return Row(tuple(name.split("|")) if name != "-" else (), model, keys_of(" ".join(fields)), written)


def keys_of(text: str) -> tuple[Key, ...]:
    """Return the keys of ``PATH=NAMES ...``."""
    keys, before = [], ""
    for word in text.split():
        paths, equals, names = word.partition("=")
        optional, paths = paths.endswith("?"), paths.removesuffix("?")
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
