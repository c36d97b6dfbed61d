"""Make the dataset that a job describes, at once or part by part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass
from typing import Any, NamedTuple

from omniscv import modalities, storage
from omniscv.arguments import whole_number
from omniscv.dataset import manifest
from omniscv.dataset import parts as marked
from omniscv.dataset.manifest import FrameEntry, Manifest
from omniscv.dataset.writer import Writer, check_new
from omniscv.jobs.finishing import finish, listed, missing_frames
from omniscv.jobs.job import Job
from omniscv.jobs.making import Making
from omniscv.jobs.moments import Exposure
from omniscv.jobs.parts import Part
from omniscv.progress import Report
from omniscv.sources.base import Source


@dataclass(frozen=True)
class PartMade:
    """What :func:`run_part` did.

    Attributes:
        written: frames that were made.
        kept: frames that were there.
    """

    written: int
    kept: int


@dataclass(frozen=True)
class Made(PartMade):
    """What :func:`make` did.

    Attributes:
        missing: frames of parts that are not finished; the dataset waits for them.
    """

    missing: int


def make(
    job: Job,
    *,
    resume: bool = False,
    shard: tuple[int, int] | None = None,
    workers: int = 1,
    progress: Report | None = None,
    warn: Callable[[str], None] | None = None,
) -> Made:
    """Make the dataset of a job below its ``out``: the same bytes, however often it was interrupted.

    Args:
        job: what to make.
        resume: go on with a dataset that is there; frames whose files have their checksums are kept.
        shard: (i, n): only part i of n (:class:`omniscv.jobs.Part`), into a dataset that may be there. The
            last one finishes the dataset. The folders of shards are joined by copying them into one, and are
            finished by ``resume``.
        workers: images that are composed at a time.
        progress: called with how far the frames that are made have come.
        warn: called with a line for what is worth a look.

    Raises:
        ArgumentError: the dataset cannot be made of this job, or another one is there.
        UnmatchedNamesError: no rule of the classes matches some objects.
        OmniscvError: as :func:`omniscv.render`, a truth or a format; frames that were made stay.
    """
    whole_number("workers", workers, most=256)
    part = Part() if shard is None else Part(*shard)
    folder = storage.folder(job.out)
    if not (resume or shard):
        check_new(folder)
    complete = folder.exists(manifest.FRAMES) and not marked.names(folder)
    made, job, frames = _run(job, part, None, workers, progress, warn)
    if shard and complete and not made.written:
        keys = {entry.key for entry in listed(folder)}
        if all(entry.key in keys for entry in frames):
            marked.remove(folder, part.index, part.count)
            return Made(0, made.kept, 0)
    missing = missing_frames(job, part.count)
    if not missing:
        finish(job, part.count, warn)
    return Made(made.written, made.kept, missing)


def run_part(
    job: Job,
    part: Part,
    *,
    source: Source | None = None,
    workers: int = 1,
    progress: Report | None = None,
    warn: Callable[[str], None] | None = None,
) -> PartMade:
    """Make the frames of a part of a job, below its ``out``, and then the part's marker.

    The same job and part give the same bytes, whoever runs it. A part that has its marker is not made again;
    of one that was interrupted, the frames that are whole are kept.

    Args:
        job: what to make.
        part: of its poses.
        source: what ``job.open_live()`` returned, which stays open; opened for this part if not given.
        workers, progress, warn: as :func:`make`.

    Raises:
        OmniscvError: as :func:`make`.
    """
    return _run(job, part, source, workers, progress, warn).made


class _Ran(NamedTuple):
    """What a part did, the job with its poses, and the part's frames."""

    made: PartMade
    job: Job
    frames: list[FrameEntry]


def _run(
    job: Job,
    part: Part,
    source: Source | None,
    workers: int,
    progress: Report | None,
    warn: Callable[[str], None] | None,
) -> _Ran:
    """As :func:`run_part`."""
    job.recipe.check(job.cameras, job.modes)
    folder = storage.folder(job.out)
    with part.of(job).opened(source) as (job, opened):
        moments = list(job.shots(_scene(opened), part.poses(job.poses)))
        mine = [shot for _, each in moments for shot in each]
        writer = Writer(
            job.out,
            resume=True,
            image_format=job.image_format,
            begun=Manifest(job.cameras, _names(job, opened), job.recipe.classes, _settings(job)),
            closed=part.count > 1,
            media=job.recipe.media,
        )
        writer.take_up_marked(marked.read(folder, part.index, part.count) or ())
        writer.take_up(shot.key for shot in mine)
        wanted = [shot for shot in mine if not writer.has(shot)]
        Making(job, opened, writer, workers, warn).run(moments, wanted, progress)
        frames = writer.entries(mine)
        marked.write(folder, part.index, part.count, frames)
    return _Ran(PartMade(len(wanted), len(mine) - len(wanted)), job, frames)


def _scene(source: Source) -> str:
    """The identity of the source's scene, as text."""
    return "/".join(part for part in astuple(source.scene_identity) if part)


def _names(job: Job, source: Source) -> dict[str, int]:
    """The ids of the objects that the source has when the dataset is begun, where labels show them."""
    labelled = any("labels" in modalities.get(mode).derives for mode in job.modes)
    return {name: i for i, name in enumerate(source.objects().names(), start=1)} if labelled else {}


def _settings(job: Job) -> dict[str, Any]:
    """What the manifest holds of a job: all that its frames depend on, but addresses and paths."""
    found = job.recipe.settings()
    options = {"modes": list(job.modes), **asdict(job.options), "image_format": job.image_format}
    if job.exposure != Exposure():
        options["exposure"] = asdict(job.exposure)
    return {**found, "options": {**options, **found["options"]}}
