"""Worlds by a pattern: one entry of a job's ``worlds`` for a folder of scans."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omniscv.arguments import shown, within
from omniscv.errors import ArgumentError

_MARK = "*"


def one_by_one(worlds: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the worlds of a job, those of patterns one by one, in the order of their files' names.

    Args:
        worlds: by name; a ``*`` in a name stands for what the ``*`` in its source stands for.
        folder: of the job, to which sources are relative; else to the working folder.

    Raises:
        ArgumentError: a pattern that no file matches, or a source without ``*``.
    """
    result: dict[str, Any] = {}
    for name, keys in worlds.items():
        if _MARK not in name or not isinstance(keys, Mapping):
            result[name] = keys
            continue
        with within(f"worlds.{name}"):
            for word in _matches(keys.get("source"), folder):
                result[name.replace(_MARK, word)] = _put(keys, word)
    return result


def _matches(source: object, folder: Path) -> list[str]:
    """Return what the ``*`` in a source stands for, sorted."""
    if not isinstance(source, str) or source.partition("?")[0].count(_MARK) != 1:
        raise ArgumentError(f"source: expected one {_MARK}, which stands for files, got {shown(source)}")
    rest = source.partition("?")[0].rpartition("://")[2]
    before, _, after = Path(rest).name.partition(_MARK)
    words = []
    for pattern in (folder / rest, Path(rest)):
        for path in pattern.parent.glob(pattern.name):
            words.append(path.name[len(before) : len(path.name) - len(after)])
        if words:
            break
    if not words:
        raise ArgumentError(f"source: expected files of {shown(source)}, got none")
    return sorted(words)


def _put(keys: Mapping[str, Any], word: str) -> dict[str, Any]:
    """Return the keys of a world with a word in the place of the mark."""
    filled = dict(keys)
    for key in ("source", "record", "poses"):
        value = filled.get(key)
        if isinstance(value, str):
            filled[key] = value.replace(_MARK, word)
    return filled
