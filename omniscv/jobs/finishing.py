"""Finish a dataset whose parts are made: its list of frames, and its exports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain

from omniscv import storage
from omniscv.dataset import exporting, manifest, reading
from omniscv.dataset import parts as marked
from omniscv.dataset.manifest import FrameEntry
from omniscv.dataset.stored import alone, tidy
from omniscv.errors import DatasetError
from omniscv.jobs.job import Job
from omniscv.jobs.parts import parts
from omniscv.storage import Folder


def missing_frames(job: Job, count: int) -> int:
    """Return how many frames the parts have, of so many, that have no marker yet."""
    there = marked.finished(storage.folder(job.out), count)
    absent = [part for part in parts(count) if part.index not in there]
    return sum(len(part.poses(job.poses)) for part in absent) * len(job.cameras)


def finish(job: Job, count: int, warn: Callable[[str], None] | None = None) -> None:
    """Join the markers of all parts, of so many, into ``frames.jsonl``; export; remove the markers.

    What killed processes have left is removed too. The source is not opened. Where another process has just
    finished the dataset, nothing is left to do.

    Raises:
        DatasetError: the marker of a part is missing or damaged.
        OmniscvError: as an export.
    """
    folder = storage.folder(job.out)
    with alone(folder):
        found = marked.read_all(folder, count)
        if folder.exists(manifest.FRAMES) and not marked.finished(folder, count):
            return
        if absent := [index for index, each in enumerate(found) if each is None]:
            wanted = f"expected markers of {count} finished parts, part {absent[0]} has none"
            raise DatasetError(f"{folder}: {wanted}; make it again with --shard {absent[0]}/{count}")
        entries = {entry.key: entry for entry in listed(folder)}  # also frames that are not of this job
        entries |= {entry.key: entry for entry in chain.from_iterable(each or () for each in found)}
        manifest.write_frames(folder, entries.values())
        if warn:
            _warn_of_splits(job, list(entries.values()), warn)
        _export(job, folder)
        marked.remove_all(folder)
        tidy(folder)


def listed(folder: Folder) -> list[FrameEntry]:
    """Return the frames of ``frames.jsonl``; none where it is not there."""
    return manifest.read_frames(folder) if folder.exists(manifest.FRAMES) else []


def _warn_of_splits(job: Job, entries: Sequence[FrameEntry], warn: Callable[[str], None]) -> None:
    found = {entry.split for entry in entries}
    for split, share in job.recipe.split.shares.items() if job.recipe.split else ():
        if share > 0 and split not in found:
            places = len({entry.place for entry in entries})
            warn(f"split: {split} has no frames: they are of {places} places, and places are not divided")


def _export(job: Job, folder: Folder) -> None:
    """Write what a job exports; each replaces the one that is there."""
    if not job.recipe.exports:
        return
    frames = reading.open(job.out)
    for each in job.recipe.exports:
        exporting.write(each, frames, folder)
