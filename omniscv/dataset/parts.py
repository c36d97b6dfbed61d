"""Markers of finished parts of a dataset: which frames each has made, with their checksums.

``parts/INDEX-of-COUNT.json`` is the last file of a part. A dataset is finished by joining the markers of all
its parts into ``frames.jsonl``; they are removed then, so that it has the same files as one made at once.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from typing import Any

from omniscv.dataset.manifest import FrameEntry
from omniscv.errors import ArgumentError, MissingFileError
from omniscv.parallel import side_by_side
from omniscv.storage import Folder

PARTS = "parts"


def write(folder: Folder, index: int, count: int, frames: Sequence[FrameEntry]) -> None:
    """Write the marker of a part, whole or not at all."""
    said = [each.to_dict() for each in frames]
    content = json.dumps({"sha256": _checksum(said), "frames": said}, allow_nan=False)
    folder.put(_name(index, count), content.encode())


def read(folder: Folder, index: int, count: int) -> list[FrameEntry] | None:
    """Return the frames of a finished part; None where its marker is missing or damaged."""
    try:
        said = json.loads(folder.read(_name(index, count)))
        if said["sha256"] != _checksum(said["frames"]):
            return None
        return [FrameEntry.from_dict(each) for each in said["frames"]]
    except (MissingFileError, ArgumentError, ValueError, TypeError, KeyError):
        return None


def read_all(folder: Folder, count: int) -> list[list[FrameEntry] | None]:
    """Return what :func:`read` returns of each part."""
    return side_by_side(lambda index: read(folder, index, count), range(count))


def names(folder: Folder) -> list[str]:
    """Return the names of all markers, of any number of parts."""
    return folder.names(f"{PARTS}/")


def finished(folder: Folder, count: int) -> set[int]:
    """Return the parts, of so many, that have a marker."""
    there = set(names(folder))
    return {index for index in range(count) if _name(index, count) in there}


def remove(folder: Folder, index: int, count: int) -> None:
    """Remove the marker of a part."""
    folder.remove(_name(index, count))
    _tidy(folder)


def remove_all(folder: Folder) -> None:
    """Remove all markers."""
    for name in names(folder):
        folder.remove(name)
    _tidy(folder)


def _tidy(folder: Folder) -> None:
    """Remove the folder of markers on this machine, where it holds none."""
    if folder.local is not None and not names(folder):
        shutil.rmtree(folder.local / PARTS, ignore_errors=True)


def _name(index: int, count: int) -> str:
    return f"{PARTS}/{index:0{len(str(count - 1))}d}-of-{count}.json"


def _checksum(frames: list[Any]) -> str:
    return hashlib.sha256(json.dumps(frames, sort_keys=True).encode()).hexdigest()
