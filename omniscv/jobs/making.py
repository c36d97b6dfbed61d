"""Composes the frames of a dataset, derives their truths, and writes them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from threading import Lock
from typing import Any, TypeVar

from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.dataset.writer import Shot, Writer
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.jobs.job import Job
from omniscv.jobs.moments import Moment, images_of, renderer_at
from omniscv.jobs.running import warnings_of
from omniscv.progress import Meter, Report
from omniscv.sources.base import Source
from omniscv.truth import registry as truths
from omniscv.truth.registry import Observation, derive

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class World:
    """What is known of the world at a frame's instant: shapes, and the poses of objects that move."""

    geometry: SceneGeometry
    poses: Mapping[str, Pose]


class Making:
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
        wanted = job.recipe.truth
        # A live source is asked for the shape of each object, at every part: for truths, and for recordings.
        self._shapes = bool(wanted) or job.record is not None
        self._geometry = source.geometry() if self._shapes else SceneGeometry()
        self._renderer = Renderer(source)
        # A truth that captures may hide objects: no image is captured beside it.
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
    ) -> list[tuple[Shot, OmniImage, World]]:
        """The frames of a moment, of captures that its cameras share."""
        what, shots = moment
        only = [i for i, shot in enumerate(shots) if shot.key in keys]
        seen: list[World] = []

        def look(source: Source) -> None:
            geometry = source.geometry() if self._job.moves and self._shapes else self._geometry
            seen.append(World(geometry, source.object_poses()))

        with self._turn:
            part, options = meter.part(), self._job.options
            images = images_of(self._renderer, what, options, only=only, progress=part, look=look)
            return [(shots[i], image, seen[0]) for i, image in zip(only, images, strict=True)]

    def _save(self, shot: Shot, composed: OmniImage, world: World) -> None:
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
