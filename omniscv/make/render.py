"""Run a job: render its images, or capture what they need."""

from collections import ChainMap, Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from omniscv import planning, storage
from omniscv.arguments import wrong
from omniscv.compose.cache import HeldCaptures
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.compose.saved import check_free, is_image
from omniscv.dataset.manifest import is_dataset
from omniscv.errors import ArgumentError
from omniscv.job import Job
from omniscv.make.contents import Contents, check, check_faults, check_source
from omniscv.make.instants import (
    InstantViews,
    SharedFrames,
    frames_by_instant,
    images_of,
    keys_of,
    renderer_at,
)
from omniscv.make.source import MOSTLY_NOTHING, opened
from omniscv.parallel import ahead
from omniscv.planning import Captures, Plan, RenderOptions, Round, drive
from omniscv.planning.views import FACE_BORDER_PX
from omniscv.progress import Meter, Progress, Report, phase, without_images
from omniscv.sources.base import Capture, Color, Request, Source, SourceWrapper, View
from omniscv.sources.labels import labels_of
from omniscv.sources.recording.rows import Row, key_of, view_from_json
from omniscv.sources.recording.store import Store
from omniscv.sources.requests import exposures_of
from omniscv.sources.stillness import verify_still
from omniscv.storage import is_url, was_url

_FACE_PER_OVERSCAN = 16  # the edge of a face by how much wider it is on each side
_SAME_PITCH = 1e-6  # relative difference of two focal lengths of one face


def run(
    job: Job,
    progress: Report | None = None,
    warn: Callable[[str], None] | None = None,
    done: Callable[[OmniImage], object] | None = None,
) -> list[Path]:
    """Render a job's images and write them; one is written while the next is composed.

    Args:
        job: what to render.
        progress: called as images progress.
        warn: called with a line for each image that has unsure or occluded pixels.
        done: called with each image before it is written.

    Returns:
        The files written.

    Raises:
        ArgumentError: the job's ``out`` is a URL, which only datasets have, a dataset, or a folder with files
            of others that have names of the job's images.
        OmniscvError: as :func:`omniscv.render`; images before it are written.
    """
    if is_url(job.out) or was_url(job.out):
        raise wrong("out", "a folder for images; 'omniscv dataset make' writes to a URL", str(job.out))
    out = Path(job.out)
    if is_dataset(storage.folder(out)):
        raise ArgumentError(f"{out}: expected a folder for images, got a dataset; write elsewhere")
    check(job)
    if warn is None:
        warn = _ignore
    with opened(job) as (job, source):
        with phase("listing frames"):
            planned = list(frames_by_instant(job))
        for key in keys_of(job):
            check_free(out, key)
        renderer = Renderer(source)
        meter = Meter(len(job), progress)
        check_source(job, Contents(), renderer, planned)
        check_faults(job, planned)
        for line in job_warnings(job, source):
            warn(line)

        def save(named: tuple[str, OmniImage]) -> list[Path]:
            key, image = named
            return image.save(out, key, job.image_format, job.store, job.depth_format)

        images = _compose(job, planned, renderer, meter, warn, done)
        files = list(chain.from_iterable(ahead(save, images, 1)))
    beside = {*out.glob("*.json")} - set(files)
    if others := sum(map(is_image, beside)):
        warn(f"{job.out}: {others} older images, which this job did not write, are beside the new ones")
    return files


def _ignore(line: str) -> None:
    """Take a warning of a caller that wants none."""


def _compose(
    job: Job,
    planned: Iterable[SharedFrames],
    renderer: Renderer,
    meter: Meter,
    warn: Callable[[str], None],
    done: Callable[[OmniImage], object] | None,
) -> Iterator[tuple[str, OmniImage]]:
    """Yield the keys and images of planned frames; ``warn`` and ``done`` are those of :func:`run`."""
    for shared in planned:
        images = images_of(renderer, shared, job, progress=meter.part())
        for frame, image in zip(shared.frames, images, strict=True):
            for line in warnings_of(frame.key, image):
                warn(line)
            if done:
                done(image)
            yield frame.key, image


_WARNINGS = {
    "unsure": "not verified by any capture",
    "occluded": "their optical centres are not visible from the camera position",
}
"""By layer, what its marks mean."""

_KNOBS = ("viewpoints", "face_size", "truth_scale")
"""Options that win against ``accuracy``."""


def job_warnings(job: Job, source: Source) -> Iterator[str]:
    """Yield a line for each rule of a ``job`` that skips objects, and one for colours of unknown meaning.

    The latter if the job averages colours, and its ``source`` does not say what their codes mean.
    """
    if job.draws:
        for rule, count in job.draws.skipped.items():
            if count:
                yield f"vary.{rule}: skips {count} objects that the source cannot set so, such as static ones"
    averages = job.exposure.seconds > 0 or job.options.filter == "area"
    if "lit" in job.captured and source.capabilities.transfer == "unknown" and (averages or job.sensor):
        how = "a sensor takes them as sRGB" if job.sensor else "the mean of codes is no mean of light"
        yield f"transfer: the source does not say what its colours are; {how}; set source_options.transfer"


def warnings_of(stem: str, image: OmniImage) -> Iterator[str]:
    """Yield a line if an ``image`` misses its accuracy, and for each layer that marks pixels.

    Lines begin with ``stem``, the start of the names of the image's files.
    """
    aim = image.options.accuracy
    effort = image.effort
    if effort.strategy not in ("", image.options.strategy):
        yield f"{stem}: strategy {effort.strategy} instead of {image.options.strategy}: {effort.stopped}"
    if aim is not None and image.doubtful > aim:
        missed = f"{image.doubtful:.3%} of the pixels are doubtful, {aim:.3%} asked"
        yield f"{stem}: {missed}: {effort.stopped}{_limiting(image.options)}"
    if image.unknown_colors:
        yield f"{stem}: {_of_no_object(image.unknown_colors)}"
    if image.depth is not None and (nothing := np.isinf(image.depth[image.valid]).mean()) >= MOSTLY_NOTHING:
        yield f"{stem}: {100 * nothing:.3g} % of the rays meet nothing; positions are metres"
    if "labels" in image.layers and not image["labels"].any():
        yield f"{stem}: all {image.valid.sum()} labels are 0: no pixel shows an object"
    for layer, what in _WARNINGS.items():
        if layer in image.layers and (count := np.count_nonzero(image[layer])):
            whole = np.count_nonzero(image.valid)
            yield f"{stem}: {count} of {whole} pixels are {layer}: {what} (see {stem}.{layer}.png)"


def _limiting(options: RenderOptions) -> str:
    """Return the end of a sentence that names options that limit the accuracy; empty if there are none."""
    defaults = RenderOptions()
    limits = []
    for name in _KNOBS:
        value = getattr(options, name)
        if value != getattr(defaults, name):
            limits.append(f"{name}={value}")
    return f"; {', '.join(limits)} may make it impossible" if limits else ""


def _of_no_object(unknown: Mapping[Color, int]) -> str:
    """Return a line on colours that no object has, and the number of their pixels."""
    pixels = sum(unknown.values())
    return f"{pixels} pixels of masks show {len(unknown)} colours or ids that no object has: label 0"


class Captured(NamedTuple):
    """The number of captures that a job needs, and of those that its recording did not hold before."""

    needed: int
    new: int


class _CountedMasks(SourceWrapper):
    """Counts the colours of masks that no object has, once for each request.

    Args:
        source: whose captures are counted.
        unknown: colour to pixels so far; they are added to it.
        seen: requests that are counted.
    """

    def __init__(self, source: Source, unknown: Counter[Color], seen: set[Request]) -> None:
        super().__init__(source)
        self._unknown = unknown
        self._seen = seen

    def around(self, source: Source) -> Source:
        return _CountedMasks(source, self._unknown, self._seen)

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for capture in self._source.capture(requests):
            is_colored = capture.mode == "object_mask" and capture.pixels.ndim == 3
            if is_colored and not capture.request.again and capture.request not in self._seen:
                self._seen.add(capture.request)
                self._unknown += Counter(labels_of(capture.pixels, self._source.objects())[1])
            yield capture


def capture(
    job: Job,
    path: Path,
    progress: Report | None = None,
    warn: Callable[[str], None] | None = None,
    *,
    border_px: int | Literal["overscan"] | None = None,
) -> Captured:
    """Capture all that a job's images need into a file, without composing them.

    Args:
        job: what the captures are for.
        path: the file; made if it does not exist.
        progress: called as captures progress; an image counts when all its captures are made.
        warn: called with a line if masks show colours that no object has.
        border_px: how much wider views are on every side; what the widest filter needs, if not given.
            ``overscan``: for the faces of cube maps, if the source can set their size and field of view, that
            of the faces in the file, else 1/16 of a face.
    """
    check(job)
    needed = dict[Request, None]()
    unknown = Counter[Color]()
    rows = _recorded(path)
    meter = Meter(len(job), progress)
    with opened(replace(job, record=path)) as (job, recording):
        source = _CountedMasks(recording, unknown, set())
        if border_px == "overscan":
            recorded = {view_from_json(row.asked) for row in rows}
            border_px = _overscan_px(job, source, recorded)
        renderer = Renderer(source)
        planned = list(frames_by_instant(job))
        check_source(job, Contents(), renderer, ())  # of a recording, other views are captured, with a border
        source.objects()
        check_faults(job, planned)
        for shared in planned:
            last = len(shared.captured) - 1
            for number, moment in enumerate(shared.captured):
                report = meter.part() if number == last else without_images(meter.part())
                needed |= _capture_moment(job, renderer, moment, border_px, needed, report)
    if unknown and warn is not None:
        warn(f"{path}: {_of_no_object(unknown)}")
    captured: set[str] = set()
    count = 0
    for request in needed:
        exposures = exposures_of(request, job.brackets) if job.brackets else [request]
        count += len(exposures)
        captured.update(map(key_of, exposures))
    return Captured(count, len(captured - {row.key for row in rows}))


def _capture_moment(
    job: Job,
    renderer: Renderer,
    moment: InstantViews,
    border_px: int | None,
    before: dict[Request, None],
    report: Report,
) -> dict[Request, None]:
    """Capture all that images of one instant need, but for requests before; return the requests in order.

    Args:
        job: whose options the images have.
        renderer: of the job's source.
        moment: the instant, its views, and the modes that are captured of it.
        border_px: how much wider views are on every side; None for what the widest filter needs.
        before: requests that are captured already.
        report: called as captures progress.
    """
    instant, views, shown = moment
    with renderer_at(renderer, instant) as renderer_then:
        plans = []
        for camera, pose in views:
            plans.append(renderer_then.plan(camera, pose, options=job.options, border_px=border_px))
        if job.options.checks == "light" or any(plan.doubt_share is not None for plan in plans):
            # Which captures are needed depends on their pixels: the images are composed.
            counting = HeldCaptures(renderer_then.source, {})
            list(renderer.of(counting).render_together(views, shown, job.options))
            report(Progress(images=len(views)))
            return dict.fromkeys(counting.requests)
        modes = job.options.sampled(shown)
        plans = planning.share_captures(plans, modes)
        take = partial(_capture_plans, plans=plans, modes=modes, before=before, report=report)
        return verify_still(renderer_then.source, modes, take)


def _recorded(path: Path) -> list[Row]:
    """Return the captures of a recording; none if there is no recording."""
    if not path.exists() or not path.stat().st_size:
        return []
    with closing(Store(path)) as store:
        return store.listing()


def _overscan_px(job: Job, source: Source, recorded: Collection[View]) -> int | None:
    """Return how much wider the faces of a job's cube maps are on every side; None for other views."""
    edge = job.options.face_size
    can = source.capabilities
    fixed = not (can.can_set_size and can.can_set_fov) or source.recorded_views() is not None
    if job.options.strategy != "cube" or edge == "auto" or fixed:
        return None
    wider_px = [view.width - edge for view in recorded if abs(2 * view.focal_px / edge - 1) < _SAME_PITCH]
    if wider_px:
        return min(wider_px) // 2
    return max(FACE_BORDER_PX, edge // _FACE_PER_OVERSCAN)


def _capture_plans(
    source: Source,
    plans: Sequence[Plan],
    modes: tuple[str, ...],
    before: dict[Request, None],
    report: Report,
) -> dict[Request, None]:
    """Capture what plans of one instant need, but for requests before; return the new ones in their order.
    ``report`` is called after each viewpoint and plan."""
    new: dict[Request, None] = {}
    known = ChainMap(new, before)
    progress = Progress()

    def capture_round(round_: Round) -> Captures:
        nonlocal progress
        missing = {request for request in round_.requests(modes) if request not in known}
        progress += Progress(of_captures=len(missing))
        kept: Captures = []
        for viewpoint, captures in planning.captured(round_, source, modes, skip=known):
            requests = dict.fromkeys(request for request in viewpoint.requests(modes) if request not in known)
            new.update(requests)
            if viewpoint.keep:
                kept.append(captures)
            progress += replace(planning.captured_progress(captures), captures=len(requests))
            report(progress)
        return kept

    for plan in plans:
        drive(plan.rounds(), capture_round)
        progress += Progress(images=1)
        report(progress)
    return new
