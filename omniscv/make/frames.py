"""Compose the frames of a dataset, derive their truths, and write them."""

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from itertools import chain
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import within
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.dataset.writer import Writer
from omniscv.errors import ArgumentError, OmniscvError, SourceError
from omniscv.frame import Frame
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import ObjectBox, SceneGeometry
from omniscv.job import Job
from omniscv.make.contents import Contents
from omniscv.make.instants import SharedFrames, images_of, renderer_at
from omniscv.make.render import job_warnings, warnings_of
from omniscv.parallel import ahead
from omniscv.progress import Meter, Report
from omniscv.sources.base import Source
from omniscv.truth import registry as truths
from omniscv.truth.object_boxes import surface_w, visible_ids
from omniscv.truth.registry import file_contents

Composed = tuple[Frame, Instant]
"""A frame with its image and the world that it shows, before it has the dataset's ids, and its instant."""


class Failures:
    """The frames that failed and were left out.

    Args:
        most: how many may fail; the next one's error is raised.
        warn: called with a line for each.

    Attributes:
        lines: of ``failed.jsonl``, by key.
    """

    def __init__(self, most: float, warn: Callable[[str], None]) -> None:
        self.lines: dict[str, dict[str, Any]] = {}
        self._most = most
        self._warn = warn

    @contextmanager
    def leaving_out(self, frames: Sequence[Frame], world: str) -> Iterator[None]:
        """Leave ``frames`` of a ``world`` out if an error ends the context, unless they are too many."""
        try:
            yield
        except OmniscvError as cause:
            self.add({frame.key: frame.varied for frame in frames}, world, cause)

    def add(self, keys: Mapping[str, Mapping[str, Any]], world: str, cause: OmniscvError) -> None:
        """Leave frames out.

        Args:
            keys: of the frames, and what was drawn for each.
            world: its name; empty if the job has only one.
            cause: why they failed. It is raised if they are too many.
        """
        if len(self.lines) + len(keys) > self._most:
            raise cause
        for key, varied in keys.items():
            line: dict[str, Any] = {"key": key}
            if world:
                line["world"] = world
            if varied:
                line["varied"] = varied
            if cause.message:
                line["error"] = cause.message
            self.lines[key] = line
        self._warn(f"{', '.join(keys)}: {cause.message}; left out")


class FrameMaker:
    """Composes and writes frames: one is composed while truths of the one before are derived and written.

    Args:
        job: whose frames are made, of one world.
        contents: of its dataset.
        renderer: of its open source.
        writer: of its dataset.
        workers: images that are composed at a time.
        warn: called with lines about images.
        failures: takes the frames that are left out.
        begins: called before captures are made, with the key of the first frame that shares them.
        carefully: whether a frame is written before the next one is begun.
    """

    def __init__(
        self,
        job: Job,
        contents: Contents,
        renderer: Renderer,
        writer: Writer,
        workers: int,
        warn: Callable[[str], None],
        failures: Failures,
        begins: Callable[[str], None] | None = None,
        carefully: bool = False,
    ) -> None:
        self._begins = begins
        self._carefully = carefully
        self._job = job
        self._contents = contents
        self._renderer = renderer
        self._writer = writer
        self._workers = workers
        self._failures = failures
        self._warn = warn
        self._skipped = set[tuple[str, str]]()
        source = renderer.source
        # Shapes take a game one request per object: read them for truths and recordings only.
        self._shapes = bool(contents.truth or job.recipe.watch) or job.record is not None
        self._geometry = source.geometry() if self._shapes else SceneGeometry()
        for line in job_warnings(job, source):
            self._warn(line)
        # Truths that capture may hide objects, so no image is captured meanwhile.
        self._capturing: set[str] = set()
        for name, options in contents.truth.items():
            if truths.get(name).may_capture(self._geometry, options):
                self._capturing.add(name)
        # Images of a world that moves take turns, too: the source shows one instant at a time.
        self._capture_lock = Lock() if self._capturing or job.changes or job.recipe.watch else nullcontext()

    def run(self, planned: Sequence[SharedFrames], missing: Collection[str], progress: Report | None) -> None:
        """Make those of ``planned`` frames whose keys are ``missing``, and report the ``progress``.

        They are written in their order, so that objects that appear late get the same ids every time.
        """
        unfinished = []
        for shared in planned:
            if any(frame.key in missing for frame in shared.frames):
                unfinished.append(shared)
        compose = partial(self._compose, keys=missing, meter=Meter(len(missing), progress))
        threads = self._workers if self._workers > 1 else 0
        composed = chain.from_iterable(ahead(compose, unfinished, threads))
        deque(ahead(self._save, composed, 0 if self._carefully else 1), maxlen=0)

    def _compose(self, shared: SharedFrames, keys: Collection[str], meter: Meter) -> list[Composed]:
        """Return the images of some frames, of the captures that they share."""
        only = []
        frames = []
        for index, frame in enumerate(shared.frames):
            if frame.key in keys:
                only.append(index)
                frames.append(frame)
        if self._begins is not None:
            self._begins(frames[0].key)
        world: dict[str, Any] = {}

        def look(source: Source) -> None:
            moved = self._job.changes and self._shapes
            world.update(geometry=source.geometry() if moved else self._geometry, object_poses=source.poses())

        with self._capture_lock, self._failures.leaving_out(frames, self._job.world):
            report = meter.part()
            images = list(images_of(self._renderer, shared, self._job, only=only, progress=report, look=look))
            composed = []
            for frame, image in zip(frames, images, strict=True):
                composed.append((replace(frame, image=image, **world), shared.instant))
            return composed
        return []  # they were left out

    def _save(self, composed: Composed) -> None:
        """Derive the truths of a frame, and write it."""
        frame, instant = composed
        with self._failures.leaving_out([frame], self._job.world):
            frame, image = self._writer.with_ids(frame, frame.rendered())
            for line in warnings_of(frame.key, image):
                self._warn(line)
            frame = replace(frame, image=image)
            if self._job.recipe.watch:
                frame = replace(frame, watch=self._left_out(frame, instant))
            records: dict[str, Any] = {}
            if self._capturing:
                with self._capture_lock, renderer_at(self._renderer, instant) as renderer:
                    records = self._records(replace(frame, renderer=renderer), self._capturing)
            records |= self._records(frame, self._contents.truth.keys() - self._capturing)
            contents = file_contents(records)
            if frame.varied:
                contents["truth"] = {**contents.get("truth", {}), "varied": frame.varied}
            self._writer.write(frame, image, contents)

    def _left_out(self, frame: Frame, instant: Instant) -> tuple[str, ...]:
        """Return the objects that the world has left out of an image; SourceError if that is a failure."""
        image = frame.rendered()
        options = self._job.options

        def look() -> OmniImage:
            with self._capture_lock, renderer_at(self._renderer, instant) as renderer:
                return renderer.render(image.camera, image.pose, ("object_mask", "depth"), options)

        names = left_out(frame, self._renderer.source.objects().names(), look)
        if names and self._job.recipe.watch == "fail":
            raise SourceError(f"watch: expected {', '.join(names)} in {frame.key}, got none")
        return names

    def _records(self, frame: Frame, names: Collection[str]) -> dict[str, Any]:
        """Return the records of truths that an image can have, in the job's order.

        A truth that fails is left out, once with a line for each camera, unless the job names its cameras.
        """
        records: dict[str, Any] = {}
        camera = frame.camera_name
        for name, options in self._contents.truth.items():
            cameras = self._contents.truth_cameras.get(name)
            if name not in names or (cameras is not None and camera not in cameras):
                continue
            try:
                with within(f"{frame.key}: truth.{name}"):
                    records[name] = truths.get(name).apply(frame, options)
            except ArgumentError as cause:
                if cameras is not None:
                    raise
                if (name, camera) not in self._skipped:
                    advice = f"left out; to make it an error, name cameras in truth.{name}.cameras"
                    self._warn(f"{cause.message}; {advice}")
                self._skipped.add((name, camera))
        return records


# -- objects that the world has left out ---------------------------------------------------------------------

_TOUCHING = 0.01  # of its distance: by how much an object may be seen before its box
_SAME = 1e-3  # of its distance: by how much depth may differ from capture to capture
_LOOKS = 3  # an object may be left out of the second captures, too


def left_out(seen: Frame, names: Sequence[str], look: Callable[[], OmniImage]) -> tuple[str, ...]:
    """Return the names of objects that an image should show, but a live world has left out, as games do.

    An object is suspected if no pixel shows it, although a part of its box is in the image, and nothing is
    seen before that part. It may be thin, or fill its box in part. So masks and depth are captured again, and
    only an object that is seen then, where nothing was before it at first, was left out. Where the two are
    equally far away, the object that the image showed must still be there: else it hid the other one, and is
    itself left out of the second captures.

    Args:
        seen: the frame with its image, and the geometry of the scene.
        names: of the source's labels 1, 2, 3, ...
        look: captures labels and depth again.
    """
    depth = seen.layer("depth")
    labels = seen.layer("labels")
    shown = visible_ids(labels)
    found = set[str]()
    suspects = set()
    for name, box in seen.geometry.boxes.items():
        if seen.instances.get(name, 0) not in shown and _unhidden(seen.rendered(), box):
            suspects.add(name)
    for _ in range(_LOOKS):
        if suspects - found:
            again = look()
            assert again.labels is not None
            assert again.depth is not None
            ids = [0]
            for name in _shown(again.labels, names):
                ids.append(seen.instances.get(name, 0))
            still = np.isin(labels, ids)
            clear = (depth > (1 + _SAME) * again.depth) | ((depth >= (1 - _SAME) * again.depth) & still)
            found |= suspects & _shown(again.labels * clear, names)
    return tuple(sorted(found))


def _shown(labels: NDArray[Any], names: Sequence[str]) -> set[str]:
    """Return the names of the objects that labels of the source show."""
    return {names[label - 1] for label in visible_ids(labels) - {0}}


def _unhidden(image: OmniImage, box: ObjectBox) -> bool:
    """Return whether the image shows nothing before some part of a box."""
    assert image.depth is not None
    points_c = image.pose.to_camera(surface_w(box))
    pixels, valid = image.camera.project(points_c)
    columns, rows = np.where(valid[:, None], pixels, 0).astype(int).T
    met = image.depth[rows.clip(max=image.camera.height - 1), columns.clip(max=image.camera.width - 1)]
    return bool((valid & (met > 0) & (met >= (1 - _TOUCHING) * np.linalg.norm(points_c, axis=1))).any())
