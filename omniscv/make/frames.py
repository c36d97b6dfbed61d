"""Compose the frames of a dataset, derive their truths, and write them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from itertools import chain
from threading import Lock
from typing import Any, NamedTuple, TypeVar

from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.dataset.writer import Writer
from omniscv.errors import ArgumentError, OmniscvError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.job import Job
from omniscv.make.contents import Contents
from omniscv.make.moments import Moment, images_of, renderer_at
from omniscv.make.render import transfer_warning, warnings_of
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
        keep_going: bool = False,
    ) -> None:
        self.failed: list[str] = []
        """Keys of the frames that failed, and were left out."""
        self._keep_going, self._skipped = keep_going, set[tuple[str, str]]()
        self._truth_cameras = contents.truth_cameras
        self._job, self._writer, self._workers, self._warn = job, writer, workers, warn
        # Shapes take a game one request per object: read them for truths and recordings only.
        self._shapes = bool(contents.truth) or job.record is not None
        self._geometry = source.geometry() if self._shapes else SceneGeometry()
        self._renderer = Renderer(source)
        if warn:
            for line in transfer_warning(job, source):
                warn(line)
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

        with self._capture_lock, self._kept_going([moment.frames[i].key for i in only]):
            report = meter.part()
            images = images_of(self._renderer, moment, self._job, only=only, progress=report, look=look)
            return [
                Composed(moment.frames[i], image, moment.instant, *world[0])
                for i, image in zip(only, images, strict=True)
            ]
        return []

    @contextmanager
    def _kept_going(self, keys: Sequence[str]) -> Iterator[None]:
        """Report an error of frames and leave them out, if the job keeps going."""
        try:
            yield
        except OmniscvError as cause:
            if not self._keep_going:
                raise
            self.failed += keys
            if self._warn:
                self._warn(f"{', '.join(keys)}: {cause.message}; left out")

    def _save(self, composed: Composed) -> None:
        with self._kept_going([composed.frame.key]):
            self._derive_and_write(composed)

    def _derive_and_write(self, composed: Composed) -> None:
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
                records = self._derived(replace(observation, renderer=renderer), self._capturing_truths)
        records |= self._derived(observation, self._other_truths)
        self._writer.write(frame, image, file_contents(records))

    def _derived(
        self, observation: Observation, wanted: Mapping[str, Mapping[str, Any]]
    ) -> dict[str, Record]:
        """Return the records of truths that an image can have.

        A truth that fails is left out, once with a line for each camera, unless the job names its cameras.
        """
        records: dict[str, Record] = {}
        camera = observation.frame.camera_name
        for name, options in wanted.items():
            named = self._truth_cameras.get(name)
            if named is not None and camera not in named:
                continue
            try:
                records |= derive(observation, {name: options})
            except ArgumentError as cause:
                if named is not None:
                    raise
                if self._warn and (name, camera) not in self._skipped:
                    advice = f"left out; to make it an error, name cameras in truth.{name}.cameras"
                    self._warn(f"{cause.message}; {advice}")
                self._skipped.add((name, camera))
        return records


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
