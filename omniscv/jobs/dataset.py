"""Make the dataset that a job describes."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, astuple, dataclass, replace
from functools import partial
from itertools import chain
from threading import Lock
from typing import Any, TypeVar

from omniscv import modalities
from omniscv.arguments import whole_number
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.dataset import exporting, manifest, reading, truths
from omniscv.dataset.manifest import Manifest
from omniscv.dataset.observing import derive
from omniscv.dataset.truths import Observation
from omniscv.dataset.writer import Shot, Writer
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.jobs.job import Job
from omniscv.jobs.moments import Exposure, Moment, images_of, renderer_at
from omniscv.jobs.running import warnings_of
from omniscv.progress import Meter, Report
from omniscv.sources.base import Source

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Made:
    """What :func:`make` did.

    Attributes:
        written: frames that were made.
        kept: frames that were there.
        missing: frames of the job that other shards have still to make; exports wait for them.
    """

    written: int
    kept: int
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
        shard: (i, n): only the frames whose key's hash is i modulo n, into a dataset that may be there. The
            folders of shards are joined by copying them into one, and are finished by ``resume``.
        workers: images that are composed at a time.
        progress: called with how far the frames that are made have come.
        warn: called with a line for what is worth a look.

    Raises:
        ArgumentError: the dataset cannot be made of this job, or another one is there.
        UnmatchedNamesError: no rule of the classes matches some objects.
        OmniscvError: as :func:`omniscv.render`, a truth or a format; frames that were made stay.
    """
    index, count = (0, 1) if shard is None else shard
    whole_number("workers", workers, most=256)
    whole_number("shard", count, least=1)
    whole_number("shard", index, least=0, most=count - 1)
    job.recipe.check(job.cameras, job.modes)
    with job.opened() as (job, source):
        moments = list(job.shots(_scene(source)))
        shots = [shot for _, mine in moments for shot in mine]
        mine = [shot for shot in shots if _hash(shot.key) % count == index]
        begun = Manifest(job.cameras, _names(job, source), job.recipe.classes, _settings(job))
        writer = Writer(
            job.out,
            resume=resume or shard is not None,
            image_format=job.image_format,
            begun=begun,
            closed=count > 1,
            media=job.recipe.media,
        )
        wanted = [shot for shot in mine if not writer.has(shot)]
        _Making(job, source, writer, workers, warn).run(moments, wanted, progress)
    if any(not writer.has(shot) for shot in shots):
        writer.take_up()  # what other shards wrote meanwhile
    missing = sum(not writer.has(shot) for shot in shots)
    if not missing:
        _finish(job, writer, warn)
    return Made(len(wanted), len(mine) - len(wanted), missing)


def _finish(job: Job, writer: Writer, warn: Callable[[str], None] | None) -> None:
    """Write the list of frames, and the exports."""
    entries = writer.finish()
    found = {entry.split for entry in entries}
    for split, share in job.recipe.split.shares.items() if job.recipe.split else ():
        if warn and share > 0 and split not in found:
            places = len({entry.place for entry in entries})
            warn(f"split: {split} has no frames: they are of {places} places, and places are not divided")
    frames = reading.open(job.out)
    with manifest.locked(job.out):
        for each in job.recipe.exports:
            exporting.write(each, frames, job.out)


@dataclass(frozen=True)
class _World:
    """What is known of the world at a frame's instant: shapes, and the poses of objects that move."""

    geometry: SceneGeometry
    poses: Mapping[str, Pose]


class _Making:
    """Composes and writes frames: one is composed while the one before is derived from and written."""

    def __init__(
        self,
        job: Job,
        source: Source,
        writer: Writer,
        workers: int,
        warn: Callable[[str], None] | None,
    ) -> None:
        self._job, self._writer, self._workers, self._warn = job, writer, workers, warn
        self._renderer, self._geometry = Renderer(source), source.geometry()
        # A truth that captures may hide objects: no image is captured beside it.
        wanted = job.recipe.truth
        names = {each for each in wanted if truths.get(each).may_capture(self._geometry, wanted[each])}
        self._alone = {name: options for name, options in wanted.items() if name in names}
        self._beside = {name: options for name, options in wanted.items() if name not in names}
        # Nor one of another instant, where the source sets the world for each.
        self._turn = Lock() if names or job.moves else nullcontext()

    def run(
        self,
        moments: Sequence[tuple[Moment, Sequence[Shot]]],
        wanted: Sequence[Shot],
        progress: Report | None,
    ) -> None:
        """Make those frames that are wanted, written in their order: so objects that come late get the same
        ids every time."""
        keys = {shot.key for shot in wanted}
        some = [each for each in moments if any(shot.key in keys for shot in each[1])]
        compose = partial(self._compose, keys=keys, meter=Meter(len(wanted), progress))
        with ThreadPoolExecutor(1, thread_name_prefix="save") as saver:
            saving: Future[None] | None = None
            for shot, image, world in chain.from_iterable(_ahead(compose, some, self._workers)):
                if saving:
                    saving.result()
                saving = saver.submit(self._save, shot, image, world)
            if saving:
                saving.result()

    def _compose(
        self,
        moment: tuple[Moment, Sequence[Shot]],
        keys: Collection[str],
        meter: Meter,
    ) -> list[tuple[Shot, OmniImage, _World]]:
        """The frames of a moment, of captures that its cameras share."""
        what, shots = moment
        only = [i for i, shot in enumerate(shots) if shot.key in keys]
        seen: list[_World] = []

        def look(source: Source) -> None:
            geometry = source.geometry() if self._job.moves else self._geometry
            seen.append(_World(geometry, source.object_poses()))

        with self._turn:
            part, options = meter.part(), self._job.options
            images = images_of(self._renderer, what, options, only=only, progress=part, look=look)
            return [(shots[i], image, seen[0]) for i, image in zip(only, images, strict=True)]

    def _save(self, shot: Shot, composed: OmniImage, world: _World) -> None:
        image = self._writer.frozen(shot, composed)
        if self._warn:
            for line in warnings_of(shot.key, image):
                self._warn(line)
        held = self._writer.manifest
        observation = Observation(
            key=shot.key,
            image=image,
            labels=image.labels,
            instances=held.names,
            classes=held.classes,
            geometry=world.geometry,
            object_poses=world.poses,
            time=shot.time,
        )
        records: dict[str, Any] = {}
        if self._alone:
            with self._turn, renderer_at(self._renderer, shot.instant) as renderer:
                records = derive(replace(observation, renderer=renderer), self._alone)
        self._writer.write(shot, image, derive(observation, self._beside, records))


def _ahead(function: Callable[[T], R], items: Sequence[T], workers: int) -> Iterator[R]:
    """Results of a function, in order, as many computed at a time as there are workers."""
    if workers == 1:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(workers, thread_name_prefix="compose") as pool:
        pending: deque[Future[R]] = deque()
        try:
            for item in items:
                pending.append(pool.submit(function, item))
                if len(pending) > workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


def _hash(key: str) -> int:
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "big")


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
