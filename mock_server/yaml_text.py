"""Untrusted YAML: plain values within stated bounds, or one line that says what is wrong.

The values are texts, numbers, truth values, None, lists, and mappings whose keys are texts. Other plain words
of YAML stay text (dates, ``yes``, ``0x10``). Tags, duplicate keys and a second document are refused. An alias
counts as often as it is used.
"""

import gc
import os
import re
import reprlib
import stat
from decimal import Decimal
from pathlib import Path
from typing import Any, NoReturn

import yaml

MOST_BYTES = 1 << 20
MOST_VALUES = 100_000
MOST_LEVELS = 32
LONGEST_NUMBER = 64
"""Bytes of a file; values, aliases expanded; levels of nesting; characters of a number."""
MOST_SCENE_BYTES = 1 << 22
MOST_SCENE_VALUES = 500_000
"""The same of the file of a scene, for 10,000 objects."""

# the tags of values without a tag
_PLAIN = "plain"
_TEXT = "text"
_WORDS = dict.fromkeys(("", "~", "null", "Null", "NULL")) | {
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_WHOLE = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)(e[-+]?[0-9]+)?|[-+]?\.inf|\.nan", re.IGNORECASE)
_EXACT_DIGITS = 15  # that every float has
_SHORT = reprlib.Repr()
_SHORT.maxlevel = 2
_LONGEST_SHOWN = 120


class Written(float):
    """A number that loses digits as a float, and the text that it was written as."""

    written: str


def shown(value: object) -> str:
    """Return the beginning of ``repr(value)``: a few bytes of YAML can stand for gigabytes."""
    text = _SHORT.repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """Return the text of the file ``path``.

    Raises:
        ValueError: it cannot be read, is larger than ``most_bytes``, or is not UTF-8.
    """
    try:
        with open(path, "rb", opener=_at_once) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ValueError("a device or a pipe")
            data = file.read(most_bytes + 1)
    except (OSError, ValueError) as cause:  # ValueError: a NUL in the name
        raise ValueError(f"expected a readable file, got {getattr(cause, 'strerror', cause)}") from cause
    if len(data) > most_bytes:
        raise ValueError(f"expected a file of at most {most_bytes} bytes, got a larger one")
    return decoded(data)


def encoding_of(start: bytes) -> str:
    """Return the encoding of a text by its first bytes: UTF-16 where a mark says it, as Excel saves it, else
    UTF-8, with a mark or without."""
    is_marked = start.startswith((b"\xff\xfe", b"\xfe\xff")) and len(start) > len(b"\xff\xfe")
    return "utf-16" if is_marked else "utf-8-sig"


def decoded(data: bytes, errors: str = "strict") -> str:
    """Return the text of ``data`` in UTF-8, or in UTF-16 with a mark.

    Raises:
        ValueError: ``data`` is in neither, and ``errors``, as of :meth:`bytes.decode`, is ``strict``.
    """
    encoding = encoding_of(data)
    try:
        return data.decode(encoding, errors)
    except UnicodeDecodeError as cause:
        name = encoding.removesuffix("-sig").upper()
        raise ValueError(f"expected a text file, got bytes that are not {name}: {cause.reason}") from cause


def _at_once(path: str, flags: int) -> int:
    """Open a file without waiting for the other end of a pipe."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def parse(text: str, most_values: int = MOST_VALUES) -> Any:
    """Return the value of ``text``, a YAML (or JSON) document.

    Raises:
        ValueError: invalid YAML, more than ``most_values``, or more levels than ``MOST_LEVELS``; the message
            has the line.
    """
    collects = gc.isenabled()
    gc.disable()  # nodes make no circles, and searching them for some takes twice as long as reading
    try:
        loader = _Loader(text)
        loader.most_values = most_values
        return loader.document()
    except yaml.MarkedYAMLError as cause:
        mark = cause.problem_mark or cause.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        wanted = "one document" if isinstance(cause, yaml.composer.ComposerError) else "YAML"
        raise ValueError(f"{line}expected {wanted}, got: {cause.problem}") from cause
    except (yaml.YAMLError, UnicodeEncodeError) as cause:
        raise ValueError(f"expected YAML, got: {' '.join(str(cause).split())}") from cause
    finally:
        if collects:
            gc.enable()


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """PyYAML's safe loader, restricted to plain values within the bounds."""

    _count = _level = 0
    most_values = MOST_VALUES

    def descend_resolver(self, parent: Any, index: Any) -> None:
        """Bound values and levels when the loader begins the value ``index`` of ``parent``.

        The whole tree is in memory only afterwards.
        """
        self._level += 1
        self._check_bounds(parent, self._level)

    def ascend_resolver(self) -> None:
        """Leave a level."""
        self._level -= 1

    def resolve(self, kind: Any, value: Any, implicit: Any) -> str:
        """Return the tag of a value without one: plain, or a text in quotes; no other tag is accepted.

        Args:
            kind: the class of the node.
            value: of the node.
            implicit: whether the tag of a scalar may be omitted without quotes, and with them.
        """
        return _PLAIN if kind is not yaml.ScalarNode or implicit[0] else _TEXT

    def document(self) -> Any:
        """Return the value of the only document, None of an empty one."""
        node = self.get_single_node()
        self._count = 0
        return None if node is None else self._value(node, 1)

    def _value(self, node: Any, level: int) -> Any:
        self._check_bounds(node, level)
        if node.tag not in (_PLAIN, _TEXT):
            _refuse(node, "no tags", repr(node.tag))
        if isinstance(node, yaml.ScalarNode):
            return _scalar(node)
        if isinstance(node, yaml.SequenceNode):
            return [self._value(item, level + 1) for item in node.value]
        values: dict[str, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag not in (_PLAIN, _TEXT):
                _refuse(key, "keys that are plain texts", "another one")
            if key.value in values:
                _refuse(key, "every key once", f"{shown(key.value)} again")
            values[key.value] = self._value(value, level + 1)
        return values

    def _check_bounds(self, node: Any, level: int) -> None:
        self._count += 1
        if self._count > self.most_values:
            _refuse(node, f"at most {self.most_values} values, aliases expanded", "more")
        if level > MOST_LEVELS:
            _refuse(node, f"at most {MOST_LEVELS} levels of nesting", "more")


def _scalar(node: Any) -> Any:
    text = node.value
    if node.tag == _TEXT:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if not _NUMBER.fullmatch(text):
        return text
    if len(text) > LONGEST_NUMBER:
        _refuse(node, f"numbers of at most {LONGEST_NUMBER} characters", shown(text))
    if _WHOLE.fullmatch(text):
        return int(text)
    if text[-1] in "fFnN":
        return float(text.replace(".", "", 1))
    value = float(text)
    if len(text) <= _EXACT_DIGITS or Decimal(text) == Decimal(repr(value)):
        return value
    written = Written(value)
    written.written = text
    return written


def _refuse(node: Any, expected: str, actual: str) -> NoReturn:
    raise ValueError(f"line {node.start_mark.line + 1}: expected {expected}, got {actual}")
