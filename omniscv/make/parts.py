"""Parts of a job: runs of consecutive poses, which any process makes into the same bytes, and their markers.

``parts/INDEX-of-COUNT.json`` is the last file of a part: its frames with their checksums. A dataset is
finished by joining the markers of all its parts into ``frames.jsonl``. Then they are removed, so that a
dataset has the same files however it was made.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from omniscv.arguments import whole_number
from omniscv.dataset.manifest import Manifest
from omniscv.errors import DamagedFileError, MissingFileError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.job import Job
from omniscv.sources.recording import part_file
from omniscv.storage import Folder
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json

_FOLDER = "parts"
_FRAMES = 16
"""Frames of a part, about, unless the number of parts is given: a minute of a worker."""


@dataclass(frozen=True)
class Part:
    """Part ``index`` of ``count``, from 0.

    Consecutive poses at one position are in one part if a part can hold them, as they share captures in a
    recording. All cameras of a pose are in its part.

    Raises:
        ArgumentError: a count below 1, or an index that is not below it.
    """

    index: int = 0
    count: int = 1

    def __post_init__(self) -> None:
        whole_number("part.count", self.count, least=1)
        whole_number("part.index", self.index, least=0, most=self.count - 1)

    @property
    def marker(self) -> str:
        """The name of its marker in the dataset."""
        return f"{_FOLDER}/{self.index:0{len(str(self.count - 1))}d}-of-{self.count}.json"

    def poses(self, poses: Sequence[Pose]) -> range:
        """Return the poses of the part, by index."""
        return range(self._first(poses, self.index), self._first(poses, self.index + 1))

    def of(self, job: Job) -> Job:
        """Return a job that records into a file of the part; ``recording merge`` joins these files."""
        if job.record is None or self.count == 1:
            return job
        return replace(job, record=part_file(job.record, self.index, self.count))

    def _first(self, poses: Sequence[Pose], index: int) -> int:
        """Return the first pose of a part: of an even division, or the start of a run of one position."""
        even, before = (len(poses) * i // self.count for i in (index, index - 1))
        first = even
        while 0 < first < len(poses) and np.array_equal(poses[first].position, poses[first - 1].position):
            first -= 1
            if first <= before:
                return even  # the run is longer than a part
        return first


def parts(count: int) -> Iterator[Part]:
    """Yield all parts of a job, of so many."""
    return (Part(index, count) for index in range(count))


def parts_of(job: Job) -> list[Part]:
    """Return the parts of a job with about 16 frames each: the same ones every time."""
    poses_each = max(1, _FRAMES // max(1, len(job.cameras)))
    return list(parts(max(1, -(-len(job.poses) // poses_each))))


# -- markers ---------------------------------------------------------------------------------------------


def write_marker(folder: Folder, part: Part, frames: Sequence[Frame]) -> None:
    """Write the marker of a part, whole or not at all."""
    lines = [frame.to_dict() for frame in frames]
    content = json.dumps({"sha256": _checksum(lines), "frames": lines}, allow_nan=False)
    folder.put(part.marker, content.encode())


def read_marker(folder: Folder, manifest: Manifest, part: Part) -> list[Frame] | None:
    """Return the frames of a finished part; None if its marker is missing or damaged."""
    try:
        content = parse_json(folder.read(part.marker, MOST_JSON_BYTES))
        if content["sha256"] != _checksum(content["frames"]):
            return None
        return [manifest.frame(line, folder) for line in content["frames"]]
    except (MissingFileError, DamagedFileError, ValueError, TypeError, KeyError):
        return None


def read_markers(folder: Folder, manifest: Manifest, count: int) -> list[list[Frame] | None]:
    """Return what :func:`read_marker` returns for each part, of so many."""
    return folder.each(partial(read_marker, folder, manifest), list(parts(count)))


def marker_names(folder: Folder) -> list[str]:
    """Return the names of all markers, of any number of parts."""
    return folder.names(f"{_FOLDER}/")


def unfinished(folder: Folder, count: int) -> list[Part]:
    """Return the parts, of so many, that have no marker."""
    names = set(marker_names(folder))
    return [part for part in parts(count) if part.marker not in names]


def remove_markers(folder: Folder, names: Sequence[str]) -> None:
    """Remove markers by name, and their local folder if it is empty then."""
    folder.each(folder.remove, names)
    if folder.local is not None and not marker_names(folder):
        shutil.rmtree(folder.local / _FOLDER, ignore_errors=True)


def _checksum(lines: list[Any]) -> str:
    return hashlib.sha256(json.dumps(lines, sort_keys=True).encode()).hexdigest()
