"""Compose the frames of a dataset, derive their truths, and write them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import chain
from threading import Lock
from typing import NamedTuple, TypeVar

from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.dataset.writer import Writer
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.job import Job
from omniscv.make.contents import Contents
from omniscv.make.moments import Moment, images_of, renderer_at
from omniscv.make.render import warnings_of
from omniscv.progress import Meter, Report
from omniscv.sources.base import Source
from omniscv.truth import registry as truths
from omniscv.truth.registry import Observation, Record, derive, file_contents

T = TypeVar("T")
R = TypeVar("R")


class Composed(NamedTuple):
    """A frame's image, and the world that it shows: shapes, and the poses of objects that move."""

    frame: Frame
    image: OmniImage
    instant: Instant
    geometry: SceneGeometry
    object_poses: Mapping[str, Pose]


class FrameMaker:
    """Composes and writes frames: one is composed while truths of the one before are derived and written."""

    def __init__(
        self,
        job: Job,
        contents: Contents,
        source: Source,
        writer: Writer,
        workers: int,
        warn: Callable[[str], None] | None,
    ) -> None:
        self._job, self._writer, self._workers, self._warn = job, writer, workers, warn
        # Shapes take a game one request per object: read them for truths and recordings only.
        self._shapes = bool(contents.truth) or job.record is not None
        self._geometry = source.geometry() if self._shapes else SceneGeometry()
        self._renderer = Renderer(source)
        # Truths that capture may hide objects, so no image is captured meanwhile.
        capturing = {
            name
            for name, options in contents.truth.items()
            if truths.get(name).may_capture(self._geometry, options)
        }
        self._capturing_truths = {name: each for name, each in contents.truth.items() if name in capturing}
        self._other_truths = {name: each for name, each in contents.truth.items() if name not in capturing}
        # Images of a world that moves take turns, too: the source shows one instant at a time.
        self._capture_lock = Lock() if capturing or job.moves else nullcontext()

    def run(self, moments: Sequence[Moment], missing: Collection[str], progress: Report | None) -> None:
        """Make the frames with some keys.

        They are written in their order, so that objects that appear late get the same ids every time.
        """
        unfinished = [moment for moment in moments if any(frame.key in missing for frame in moment.frames)]
        compose = partial(self._compose, keys=missing, meter=Meter(len(missing), progress))
        with ThreadPoolExecutor(1, thread_name_prefix="save") as saver:
            saving: Future[None] | None = None
            for composed in chain.from_iterable(_ahead(compose, unfinished, self._workers)):
                if saving:
                    saving.result()
                saving = saver.submit(self._save, composed)
            if saving:
                saving.result()

    def _compose(self, moment: Moment, keys: Collection[str], meter: Meter) -> list[Composed]:
        """Return the images of a moment, of captures that its cameras share."""
        only = [i for i, frame in enumerate(moment.frames) if frame.key in keys]
        world: list[tuple[SceneGeometry, Mapping[str, Pose]]] = []

        def look(source: Source) -> None:
            geometry = source.geometry() if self._job.moves and self._shapes else self._geometry
            world.append((geometry, source.object_poses()))

        with self._capture_lock:
            report, options = meter.part(), self._job.options
            images = images_of(self._renderer, moment, options, only=only, progress=report, look=look)
            return [
                Composed(moment.frames[i], image, moment.instant, *world[0])
                for i, image in zip(only, images, strict=True)
            ]

    def _save(self, composed: Composed) -> None:
        frame, image = self._writer.with_ids(composed.frame, composed.image)
        if self._warn:
            for line in warnings_of(frame.key, image):
                self._warn(line)
        observation = Observation(
            frame=frame,
            image=image,
            labels=image.labels,
            geometry=composed.geometry,
            object_poses=composed.object_poses,
        )
        records: dict[str, Record] = {}
        if self._capturing_truths:
            with self._capture_lock, renderer_at(self._renderer, composed.instant) as renderer:
                records = derive(replace(observation, renderer=renderer), self._capturing_truths)
        records |= derive(observation, self._other_truths)
        self._writer.write(frame, image, file_contents(records))


def _ahead(function: Callable[[T], R], items: Sequence[T], workers: int) -> Iterator[R]:
    """Yield the results of a function in order; as many are computed at a time as there are workers."""
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
