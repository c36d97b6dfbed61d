"""Parts of a job: runs of poses, one after the other, which any process makes into the same bytes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from omniscv.arguments import whole_number
from omniscv.geometry import Pose
from omniscv.jobs.job import Job
from omniscv.sources.recording import part_file


@dataclass(frozen=True)
class Part:
    """Part ``index`` of ``count``, from 0.

    Poses at one position, one after the other, are in one part where a part can hold them: a recording
    shows them the same captures. All cameras of a pose are in its part.

    Raises:
        ArgumentError: a count below 1, or an index that is not below it.
    """

    index: int = 0
    count: int = 1

    def __post_init__(self) -> None:
        whole_number("part.count", self.count, least=1)
        whole_number("part.index", self.index, least=0, most=self.count - 1)

    def poses(self, poses: Sequence[Pose]) -> range:
        """Return the poses of the part, by index."""
        return range(self._first(poses, self.index), self._first(poses, self.index + 1))

    def of(self, job: Job) -> Job:
        """Return a job that records into a file of the part's own, where it records.

        Several processes, or machines, do not write one recording: ``captures merge`` joins them.
        """
        if job.record is None or self.count == 1:
            return job
        return replace(job, record=part_file(job.record, self.index, self.count))

    def _first(self, poses: Sequence[Pose], index: int) -> int:
        """The first pose of a part, where all are shared evenly, or of the run of one position around it."""
        even, before = (len(poses) * i // self.count for i in (index, index - 1))
        first = even
        while 0 < first < len(poses) and np.array_equal(poses[first].position, poses[first - 1].position):
            first -= 1
            if first <= before:
                return even  # the run is longer than a part
        return first


def parts(count: int) -> Iterator[Part]:
    """Yield all parts, of so many."""
    return (Part(index, count) for index in range(count))


FRAMES = 16
"""Frames of a part, about, where nobody says how many parts there are: a minute's work of a worker."""


def parts_of(job: Job) -> list[Part]:
    """Return the parts of a job that make about ``FRAMES`` frames each: the same ones every time."""
    poses_each = max(1, FRAMES // max(1, len(job.cameras)))
    return list(parts(max(1, -(-len(job.poses) // poses_each))))
