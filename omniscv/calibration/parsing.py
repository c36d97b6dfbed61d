"""What the readers share: numbers out of untrusted text, and errors that say where."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import yaml

from omniscv.errors import ArgumentError

_SHORT = reprlib.Repr()
_SHORT.maxlevel = 2


@contextmanager
def within(where: str) -> Iterator[None]:
    """Errors raised inside say ``where`` first."""
    try:
        yield
    except ArgumentError as cause:
        raise ArgumentError(f"{where}: {cause}") from cause


def shown(value: object) -> str:
    """``repr``, cut short: a few bytes of YAML can stand for a value of gigabytes."""
    return _SHORT.repr(value)


def mapping(text: str) -> dict[Any, Any]:
    """The mapping that a YAML (or JSON) document is.

    Raises:
        ArgumentError: not YAML, or not a mapping.
    """
    try:
        data = yaml.safe_load(text)
    # Dates and whole numbers that Python cannot hold are ValueErrors, deep nesting a RecursionError.
    except (yaml.YAMLError, ValueError, RecursionError) as cause:
        summary = " ".join(str(cause).split())
        raise ArgumentError(f"expected YAML, got {type(cause).__name__}: {summary}") from cause
    if not isinstance(data, dict):
        raise ArgumentError(f"expected a YAML mapping, got {shown(data)}")
    return data


def field(data: object, key: str) -> Any:
    """``data[key]``.

    Raises:
        ArgumentError: ``data`` is no mapping, or has no such key.
    """
    if not isinstance(data, dict):
        raise ArgumentError(f"expected a mapping with {key!r} in it, got {shown(data)}")
    if key not in data:
        raise ArgumentError(f"expected the key {key!r}, got {shown(sorted(map(str, data)))}")
    return data[key]


def numbers(key: str, values: object, count: int) -> list[float]:
    """``count`` finite numbers; text that is a number counts (YAML 1.1 takes 1e-3 for text).

    Raises:
        ArgumentError: not a sequence of that many finite numbers.
    """
    if isinstance(values, list | tuple) and len(values) == count and bool not in map(type, values):
        try:
            result = [float(value) for value in values]
        except (TypeError, ValueError, OverflowError):
            result = [math.nan]
        if all(map(math.isfinite, result)):
            return result
    raise ArgumentError(f"{key}: expected {count} finite numbers, got {shown(values)}")


def whole_number(key: str, value: object) -> int:
    """A whole number >= 1.

    Raises:
        ArgumentError: it is something else.
    """
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 10:
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ArgumentError(f"{key}: expected a whole number >= 1, got {shown(value)}")
    return value
