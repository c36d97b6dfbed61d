"""Checks of arguments, for every layer. Errors are one line: "NAME: expected X, got Y"."""

import math
import re
import reprlib
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError

Reader = Callable[[str, Any], Any]
"""``reader(name, value)`` returns a value checked, or raises ArgumentError with the name in it."""

_SHORT = reprlib.Repr()
_SHORT.maxlevel = 2
_SHORT.maxstring = 80
_SHORT.maxother = 80
_LONGEST_SHOWN = 120  # characters
_LONGEST_NUMBER = 64  # characters; a float64 needs at most 25
_LONGEST_LABEL = 200  # characters
_NOT_PORTABLE = frozenset('<>:"/\\|?*')
_DEVICE = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9])(\..*)?", re.IGNORECASE)
"""Names that Windows keeps for devices, with any suffix."""
_LONGEST_STEM = 180  # bytes: a file name has 255, of which kind, suffix and a temporary one's token are left


@contextmanager
def within(where: object) -> Iterator[None]:
    """Prefix the messages of argument errors with ``where``."""
    try:
        yield
    except ArgumentError as cause:
        raise ArgumentError(f"{where}: {cause.message}") from cause


def shown(value: object) -> str:
    """Return the beginning of ``repr(value)`` in one line: a few bytes of YAML can stand for gigabytes."""
    if isinstance(value, np.ndarray):
        value = value.tolist() if value.size <= 100 else f"array of shape {value.shape}"
    try:
        text = " ".join(_SHORT.repr(value).split())
    except ValueError:  # an int of more digits than Python prints
        return f"a value of type {type(value).__name__}"
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def wrong(name: str, wanted: str, value: object) -> ArgumentError:
    """Return the error ``NAME: expected WANTED, got VALUE``.

    Args:
        name: of the argument.
        wanted: what was expected, in words.
        value: what came.
    """
    return ArgumentError(f"{name}: expected {wanted}{';' if ',' in wanted else ','} got {shown(value)}")


def number(
    name: str,
    value: object,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    most: float = math.inf,
) -> float:
    """Return a number, or the text of one, as a finite float within its limits, or raise ArgumentError.

    Args:
        name: of the argument, for messages.
        value: that is checked; a bool is not a number.
        above: it is more than this.
        least: it is this or more.
        below: it is less than this.
        most: it is this or less.
    """
    result = _as_float(value)
    if not (math.isfinite(result) and above < result < below and least <= result <= most):
        limits = []
        for sign, bound in ((">", above), (">=", least), ("<", below), ("<=", most)):
            if math.isfinite(bound):
                limits.append(f"{sign} {bound:.15g}")
        wanted = f"a finite number {' and '.join(limits)}".rstrip()
        raise ArgumentError(f"{name}: expected {wanted}, got {shown(value)}")
    return result + 0.0  # -0.0 becomes 0.0: equal numbers have equal texts


def optional_number(name: str, value: object, **limits: float) -> float | None:
    """Return None where ``value`` is None, and else what :func:`number` returns of it, ``name`` and
    ``limits``."""
    return None if value is None else number(name, value, **limits)


def numbers(name: str, value: object, shape: Sequence[int | None]) -> NDArray[np.float64]:
    """Return finite numbers as a read-only float64 copy; ArgumentError for anything else.

    Args:
        name: of the argument, for messages.
        value: a nested sequence of numbers or their texts, or an array.
        shape: that it has; None is any size >= 1.
    """
    if _fits(value, shape):  # without a loop over its numbers
        array = np.ascontiguousarray(value) + 0.0
        array.flags.writeable = False
        return array
    leaves = _leaves(value, tuple(shape))
    sizes = _sizes(value, shape) if all(map(math.isfinite, leaves)) else []
    if not sizes or math.prod(sizes) != len(leaves):  # also rows of different lengths
        count = f"{shape[0]} " if len(shape) == 1 else f"{tuple(shape)} "
        if shape == (None,):
            count = ""
        raise ArgumentError(f"{name}: expected {count}finite numbers, got {shown(value)}")
    array = np.array(leaves).reshape(sizes) + 0.0
    array.flags.writeable = False
    return array


def whole_number(name: str, value: object, unit: str = "", *, least: int = 1, most: int | None = None) -> int:
    """Return a whole number as an int within its limits, or raise ArgumentError.

    Args:
        name: of the argument, for messages.
        value: that is checked; a bool or a float is not a whole number.
        unit: of the number, in the plural, for messages.
        least: it is this or more.
        most: it is this or less; None: any.
    """
    wanted = f"{name}: expected a whole number{unit and ' of '}{unit}"
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ArgumentError(f"{wanted} >= {least}, got {shown(value)}")
    if most is not None and value > most:
        raise ArgumentError(f"{wanted} <= {most}, got {shown(value)}")
    return int(value)


def one_of(name: str, value: object, words: Iterable[str]) -> Any:
    """Return ``value``, one of a few ``words``, or raise ArgumentError with ``name``."""
    known = list(words)
    if isinstance(value, str) and value:  # what begins so comes first
        known.sort(key=lambda word: not word.startswith(value))
    if not isinstance(value, str) or value not in known:
        hint = did_you_mean(value, known)
        raise ArgumentError(f"{name}: expected one of {', '.join(known)}; got {shown(value)}{hint}")
    return value


_LEAST_LIKENESS = 0.65
"""The least ratio of difflib at which a known word is suggested."""
_RENAMED = {
    "faces": "exact", "strips": "exact", "adaptive": "auto", "reproject": "auto", "max_error_px": "accuracy",
}  # fmt: skip
"""Words of earlier versions, and those in their place."""


def did_you_mean(value: object, known: Iterable[object]) -> str:
    """Return ``; did you mean WORD?`` with the known word in whose place a value was, or that is most like
    it; else nothing."""
    if not isinstance(value, str) or not value:
        return ""
    words = [word for word in known if isinstance(word, str)]
    for word in words:
        if word == _RENAMED.get(value) or word.startswith(value):
            return f"; did you mean {word}?"
    for word in get_close_matches(value, words, n=1, cutoff=_LEAST_LIKENESS):
        return f"; did you mean {word}?"
    return ""


def flag(name: str, value: object) -> bool:
    """Return ``value``, True or False, or raise ArgumentError with ``name``."""
    if not isinstance(value, bool):
        raise ArgumentError(f"{name}: expected true or false, got {shown(value)}")
    return value


def text(name: str, value: object) -> str:
    """Return ``value``, a text that is not empty and has no NUL, or raise ArgumentError with ``name``."""
    if not isinstance(value, str) or not value or "\0" in value:
        raise ArgumentError(f"{name}: expected a text, got {shown(value)}")
    return value


def label(name: str, value: object) -> str:
    """Return ``value``, a name that other programs write into a line of a list: printable, short; else raise
    ArgumentError with ``name``."""
    is_text = isinstance(value, str) and value.strip() and value.isprintable()
    if not is_text or len(str(value)) > _LONGEST_LABEL:
        wanted = f"a name of at most {_LONGEST_LABEL} printable characters"
        raise ArgumentError(f"{name}: expected {wanted}, got {shown(value)}")
    return str(value)


def stem(name: str, value: object, *, dots: bool = False) -> str:
    """Return the start of a file name on any system: printable, short, no name of a device such as ``con``,
    no blank or dot at its ends; else raise ArgumentError.

    Args:
        name: of the argument, for messages.
        value: that is checked.
        dots: whether it may have dots within, which end it in WebDataset.
    """
    name_is = value if isinstance(value, str) and value.isprintable() else ""
    if not dots and "." in name_is.strip("."):
        raise ArgumentError(f"{name}: expected the start of a file name without a dot, got {shown(value)}")
    odd = _NOT_PORTABLE & {*name_is} or name_is.strip(" .") != name_is or _DEVICE.fullmatch(name_is)
    if odd or not 0 < len(name_is.encode()) <= _LONGEST_STEM:
        wanted = f"printable, of at most {_LONGEST_STEM} bytes, without {' '.join(sorted(_NOT_PORTABLE))}"
        more = "blanks or dots at its ends, and no device's name as con"
        raise wrong(name, f"the start of a file name: {wanted}, {more}", value)
    return name_is


def file_key(name: str) -> str:
    """Return what all names of one file have in common on systems that fold case and normalize Unicode.

    macOS takes é in one character and é in two for one name.
    """
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def stems(name: str, values: Iterable[object], *, dots: bool = False) -> None:
    """Raise ArgumentError unless all are as :func:`stem`, and name different files on every system.

    Args:
        name: of the argument, for messages.
        values: that are checked.
        dots: as of :func:`stem`.
    """
    folded: dict[str, str] = {}
    for value in values:
        same = folded.setdefault(file_key(stem(name, value, dots=dots)), str(value))
        if same == value:
            continue
        wanted = "the case of letters"
        pair = f"{same} and {value}"
        if same.casefold() != str(value).casefold():
            wanted = "how Unicode composes letters"
            pair = f"{same!a} and {value!a}"
        raise ArgumentError(f"{name}: expected names of files that differ in more than {wanted}, got {pair}")


def texts(name: str, value: object) -> tuple[str, ...]:
    """Return ``value``, a list of at least one text, as a tuple, or raise ArgumentError with ``name``."""
    if not isinstance(value, list | tuple) or not value:
        raise ArgumentError(f"{name}: expected a list of texts, got {shown(value)}")
    return tuple(text(f"{name}[{i}]", item) for i, item in enumerate(value))


def _as_float(value: Any) -> float:
    """Return the number of a scalar or a text; NaN for anything else."""
    if getattr(value, "ndim", 0) or isinstance(value, bool | np.bool_):
        return math.nan
    if isinstance(value, str | bytes) and len(value) > _LONGEST_NUMBER:
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _fits(value: object, shape: Sequence[int | None]) -> bool:
    """Return whether a value is an array of finite float64 numbers of a shape."""
    if type(value) is not np.ndarray or value.dtype != np.float64 or value.ndim != len(shape):
        return False
    for size, wanted in zip(value.shape, shape, strict=True):
        if size != (max(1, size) if wanted is None else wanted):
            return False
    return bool(np.isfinite(value).all())


def _sizes(value: Any, shape: Sequence[int | None]) -> list[int]:
    """Return the sizes of a nested sequence that has as many levels as a shape, by its first entries."""
    sizes = []
    for _ in shape:
        sizes.append(len(value))
        value = value[0]
    return sizes


def _leaves(value: Any, shape: tuple[int | None, ...]) -> list[float]:
    """Return the numbers of a nested sequence, row by row; NaN where it does not fit the shape.

    It reads no more than the shape holds: YAML's aliases can nest a short list into billions of numbers.
    """
    if not shape:
        return [_as_float(value)]
    if hasattr(value, "__array__"):
        value = np.asarray(value).tolist()
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        return [math.nan]
    fits = len(value) > 0 if shape[0] is None else len(value) == shape[0]
    if not fits:
        return [math.nan]
    if len(shape) == 1 and set(map(type, value)) == {float}:  # as of JSON: most numbers of recordings
        return list(value)
    leaves = []
    for row in value:
        leaves += _leaves(row, shape[1:])
    return leaves
