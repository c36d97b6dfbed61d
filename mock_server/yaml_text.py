"""YAML that others wrote: plain values within stated bounds, or one line that says what is wrong.

As omniscv reads YAML, of which this package imports nothing. What comes out is made of texts, numbers, truth
values, None, lists, and mappings whose keys are texts. What else YAML can express is plain text (dates,
``yes``, ``0x10``) or refused (tags, a key twice, a second document). Aliases are expanded, and count as
often as they are.
"""

import re
import reprlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

MOST_BYTES, MOST_VALUES, MOST_LEVELS, LONGEST_NUMBER = 1 << 20, 100_000, 32, 64
"""Of a file; in it, aliases expanded; of nesting; characters of a number."""

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _LONGEST_SHOWN = 2, 120
_WORDS = dict.fromkeys(("", "~", "null", "Null", "NULL")) | {
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_WHOLE = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)(e[-+]?[0-9]+)?|[-+]?\.inf|\.nan", re.IGNORECASE)
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # its parser; values are made here


def shown(value: object) -> str:
    """Return the beginning of ``repr(value)``: a few bytes of YAML can stand for gigabytes."""
    text = _SHORT.repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        ValueError: it cannot be read, is larger than ``MOST_BYTES``, or is no UTF-8.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise ValueError(f"expected a text file of at most {MOST_BYTES} bytes, got a larger one")
        return data.decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as cause:
        wrong = cause.strerror if isinstance(cause, OSError) else f"bytes that are no UTF-8: {cause.reason}"
        raise ValueError(f"expected a readable text file, got {wrong}") from cause


def parse(text: str) -> Any:
    """Return the value of a YAML (or JSON) document.

    Raises:
        ValueError: no YAML, or beyond the bounds; the message has the line.
    """
    try:
        return _Composer(text).document()
    except yaml.MarkedYAMLError as cause:
        mark = cause.problem_mark or cause.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise ValueError(f"{line}expected YAML, got: {cause.problem}") from cause
    except (yaml.YAMLError, UnicodeEncodeError) as cause:
        raise ValueError(f"expected YAML, got: {' '.join(str(cause).split())}") from cause


class _Composer:
    """Makes values of the parser's events, and stops where a bound is reached."""

    def __init__(self, text: str) -> None:
        self._events: Iterator[Any] = yaml.parse(text, Loader=_LOADER)
        self._anchors: dict[str, tuple[Any, int, int]] = {}  # value, how many values, how many levels
        self._count = 0

    def document(self) -> Any:
        value = None
        documents = 0
        for event in self._events:
            if isinstance(event, yaml.NodeEvent):
                documents += 1
                if documents > 1:
                    raise _refused(event, "one document", "another one")
                value, _ = self._node(event, 1)
        return value

    def _node(self, event: Any, level: int) -> tuple[Any, int]:
        """The value that an event starts, and its levels."""
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                raise _refused(event, "an alias of a value before it", f"'*{event.anchor}'")
            value, count, levels = self._anchors[event.anchor]
            self._counted(event, count, level + levels - 1)
            return value, levels
        if event.tag is not None:
            raise _refused(event, "no tags", repr(event.tag))
        before = self._count
        self._counted(event, 1, level)
        if isinstance(event, yaml.ScalarEvent):
            value, levels = _scalar(event), 1
        elif isinstance(event, yaml.SequenceStartEvent):
            value, levels = self._sequence(level)
        else:
            value, levels = self._mapping(level)
        if event.anchor is not None:
            self._anchors[event.anchor] = value, self._count - before, levels
        return value, levels

    def _sequence(self, level: int) -> tuple[list[Any], int]:
        values, levels = [], 1
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            value, below = self._node(event, level + 1)
            values.append(value)
            levels = max(levels, 1 + below)
        return values, levels

    def _mapping(self, level: int) -> tuple[dict[str, Any], int]:
        values: dict[str, Any] = {}
        levels = 1
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent) or event.tag is not None:
                raise _refused(event, "keys that are plain texts", "another one")
            if event.value in values:
                raise _refused(event, "every key once", f"{shown(event.value)} again")
            values[event.value], below = self._node(next(self._events), level + 1)
            levels = max(levels, 1 + below)
        return values, levels

    def _counted(self, event: Any, count: int, level: int) -> None:
        self._count += count
        if self._count > MOST_VALUES:
            raise _refused(event, f"at most {MOST_VALUES} values, aliases expanded", "more")
        if level > MOST_LEVELS:
            raise _refused(event, f"at most {MOST_LEVELS} levels of nesting", "more")


def _scalar(event: Any) -> Any:
    text = event.value
    if not event.implicit[0]:  # in quotes, or a block
        return text
    if text in _WORDS:
        return _WORDS[text]
    if not _NUMBER.fullmatch(text):
        return text
    if len(text) > LONGEST_NUMBER:
        raise _refused(event, f"numbers of at most {LONGEST_NUMBER} characters", shown(text))
    if _WHOLE.fullmatch(text):
        return int(text)
    return float(text.replace(".", "", 1) if text[-1] in "fFnN" else text)


def _refused(event: Any, wanted: str, got: str) -> ValueError:
    return ValueError(f"line {event.start_mark.line + 1}: expected {wanted}, got {got}")
