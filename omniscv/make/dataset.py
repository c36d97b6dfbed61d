"""Make the dataset that a job describes, at once or part by part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import chain
from typing import NamedTuple

from omniscv import modalities, storage
from omniscv.arguments import whole_number
from omniscv.dataset import exporting, manifest
from omniscv.dataset.folder import lock, make_room, tidy
from omniscv.dataset.manifest import Manifest
from omniscv.dataset.writer import Writer
from omniscv.errors import ArgumentError, DatasetError
from omniscv.frame import Frame
from omniscv.job import Job
from omniscv.make.contents import Contents, check_dataset, check_source
from omniscv.make.frames import FrameMaker
from omniscv.make.moments import moments
from omniscv.make.parts import (
    Part,
    marker_names,
    read_marker,
    read_markers,
    remove_markers,
    unfinished,
    write_marker,
)
from omniscv.make.source import opened
from omniscv.progress import Report
from omniscv.sources.base import Source
from omniscv.storage import Folder


@dataclass(frozen=True)
class Made:
    """Counts of frames.

    Attributes:
        written: that were made.
        kept: that existed.
        missing: of parts that are not finished; the dataset is not complete without them.
        failed: that were left out, because the job keeps going.
    """

    written: int
    kept: int
    missing: int = 0
    failed: int = 0


def make(
    job: Job,
    *,
    resume: bool = False,
    overwrite: bool = False,
    keep_going: bool = False,
    shard: tuple[int, int] | None = None,
    workers: int = 1,
    progress: Report | None = None,
    warn: Callable[[str], None] | None = None,
) -> Made:
    """Make the dataset of a job in its ``out``: the same bytes, however often it was interrupted.

    Args:
        job: what to make.
        resume: continue a dataset; frames whose files have their checksums are kept.
        overwrite: remove a dataset that is there.
        keep_going: report frames that fail, and leave them out; ``resume`` tries them again.
        shard: (i, n): only part i of n (:class:`omniscv.jobs.Part`), into a dataset that may exist. The last
            one finishes the dataset. The folders of shards are joined by copying them into one, and are
            finished by ``resume``.
        workers: images that are composed at a time.
        progress: called as frames progress.
        warn: called with lines about doubtful pixels and empty splits.

    Raises:
        ArgumentError: the dataset cannot be made of this job, or another one exists.
        UnmatchedNamesError: no rule of the classes matches some objects.
        OmniscvError: as :func:`omniscv.render`, a truth or a format; frames that were made stay.
    """
    whole_number("workers", workers, most=256)
    part = Part() if shard is None else Part(*shard)
    folder = storage.folder(job.out)
    if overwrite and (resume or shard):
        raise ArgumentError("overwrite: expected it without resume and shard, got several of them")
    if not (resume or shard or overwrite):
        make_room(folder)
    complete = folder.exists(manifest.FRAMES) and not marker_names(folder)
    made, job, frames = _run(job, part, None, workers, progress, warn, keep_going, overwrite)
    if shard and complete and not made.written:
        keys = {frame.key for frame in _listed(folder)}
        if all(frame.key in keys for frame in frames):
            remove_markers(folder, [part.marker])
            return Made(0, made.kept)
    missing = sum(len(each.poses(job.poses)) for each in unfinished(folder, part.count)) * len(job.cameras)
    if not missing:
        finish(job, part.count, warn)
    return replace(made, missing=missing)


def run_part(
    job: Job,
    part: Part,
    *,
    source: Source | None = None,
    workers: int = 1,
    progress: Report | None = None,
    warn: Callable[[str], None] | None = None,
) -> Made:
    """Make the frames of a part of a job in its ``out``, and then the part's marker.

    The same job and part give the same bytes in every process. A part that has its marker is not made again;
    of one that was interrupted, whole frames are kept.

    Args:
        job: what to make.
        part: of its poses.
        source: of the job, without its recording, which stays open; opened for this part if not given.
        workers, progress, warn: as :func:`make`.

    Raises:
        OmniscvError: as :func:`make`.
    """
    return _run(job, part, source, workers, progress, warn).made


class _Run(NamedTuple):
    """The result of a part, the job with its poses, and the part's frames."""

    made: Made
    job: Job
    frames: list[Frame]


def _run(
    job: Job,
    part: Part,
    source: Source | None,
    workers: int,
    progress: Report | None,
    warn: Callable[[str], None] | None,
    keep_going: bool = False,
    overwrite: bool = False,
) -> _Run:
    """Make a part; as :func:`run_part`."""
    contents = check_dataset(job)
    with opened(part.of(job), source) as (job, live):
        scene = "/".join(name for name in astuple(live.scene_identity) if name)
        planned = list(moments(job, part.poses(job.poses), scene))
        frames = [frame for moment in planned for frame in moment.frames]
        check_source(job, contents, live, planned)
        if overwrite:
            make_room(storage.folder(job.out), overwrite)
        begun = Manifest(job.cameras, _names(job, live), contents.classes, contents.settings(job))
        writer = Writer(
            job.out,
            resume=True,
            image_format=job.image_format,
            begun=begun,
            closed=part.count > 1,
            media=job.recipe.media,
        )
        folder = storage.folder(job.out)
        writer.keep_marked(read_marker(folder, writer.manifest, part) or ())
        missing = writer.missing(frames)
        maker = FrameMaker(job, contents, live, writer, workers, warn, keep_going)
        maker.run(planned, missing, progress)
        failed = set(maker.failed)
        written = writer.frames(frame.key for frame in frames if frame.key not in failed)
        write_marker(folder, part, written)
    kept = len(frames) - len(missing)
    return _Run(Made(len(missing) - len(failed), kept, failed=len(failed)), job, written)


def _names(job: Job, source: Source) -> dict[str, int]:
    """Return the ids of the objects that the source has now, if labels show them."""
    labelled = any("labels" in modalities.get(mode).derives for mode in job.modes)
    return {name: i for i, name in enumerate(source.objects().names(), start=1)} if labelled else {}


def finish(job: Job, count: int, warn: Callable[[str], None] | None = None) -> None:
    """Join the markers of all parts, of so many, into ``frames.jsonl``; export; remove the markers.

    What killed processes have left is removed too. The source is not opened. If another process has just
    finished the dataset, nothing is left to do.

    Raises:
        DatasetError: the marker of a part is missing or damaged.
        OmniscvError: as an export.
    """
    folder = storage.folder(job.out)
    with lock(folder):
        if folder.exists(manifest.FRAMES) and len(unfinished(folder, count)) == count:
            return
        whole = manifest.read(folder)
        marked = read_markers(folder, whole, count)
        if None in marked:
            index = marked.index(None)
            wanted = f"expected markers of {count} finished parts, part {index} has none"
            raise DatasetError(f"{folder}: {wanted}; make it again with --shard {index}/{count}")
        frames = {frame.key: frame for frame in _listed(folder)}  # also frames that are not of this job
        frames |= {frame.key: frame for frame in chain.from_iterable(each or () for each in marked)}
        manifest.write_frames(folder, frames.values())
        if warn:
            _warn_of_splits(job, list(frames.values()), warn)
        if exports := Contents.of(job).exports:
            written = manifest.open(job.out)
            for export in exports:  # each replaces the one that exists
                shown = [set(frame.files) for frame in written if export.shows(frame.camera_name)]
                if shown:  # truths may have been left out
                    export.check(job.cameras, set.intersection(*shown))
                exporting.write(export, written, folder)
        remove_markers(folder, marker_names(folder))
        tidy(folder)


def _listed(folder: Folder) -> list[Frame]:
    """Return the frames of ``frames.jsonl``; none without the file."""
    return manifest.read_frames(folder) if folder.exists(manifest.FRAMES) else []


def _warn_of_splits(job: Job, frames: Sequence[Frame], warn: Callable[[str], None]) -> None:
    splits = {frame.split for frame in frames}
    for split, share in job.recipe.split.shares.items() if job.recipe.split else ():
        if share > 0 and split not in splits:
            places = len({frame.place for frame in frames})
            warn(f"split: {split} has no frames: they are of {places} places, and places are not divided")
