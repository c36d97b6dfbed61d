"""What a job takes: its captures, counted by plans, and its time, measured by one image."""

import logging
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import pairwise
from operator import add
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from omniscv import planning
from omniscv.cameras import Camera
from omniscv.cameras.rolling_shutter import path_of, without_path
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.job import Job, Recipe
from omniscv.make.contents import check
from omniscv.make.dataset import Part, run_part
from omniscv.make.instants import InstantViews, SharedFrames, frames_by_instant, images_of, renderer_at
from omniscv.make.source import opened
from omniscv.parallel import ahead
from omniscv.planning import Plan
from omniscv.planning.sharing import Cost, cost
from omniscv.progress import in_phase, phase
from omniscv.render_options import Price
from omniscv.sources.base import Capture, Request, Source, SourceWrapper, Traced, View
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.world_rows import object_from_json

_AIMS = (0.01, 0.003, 0.001)  # accuracies whose costs are shown
_PLANNED_CENTERS = 500  # places, and instants of a world that moves, that are planned: others cost the same
_PLANNED_POSES = 3
"""Of a camera that moves while its lines are read: others cost the same, or nearly so."""
_DECIMALS = 7  # of the positions of cameras of one pose, metres
_SMALLER = 4  # how many times narrower the smaller of two captures is, whose difference is that of pixels
_LEAST_PX = 16  # edge of a smaller capture
_MORE_POSES = 3  # whose images are measured where those of the first pose came soon
_SOON_S = 4.0
_PAUSE = 10  # times of captures that are so many times the median lie between two sessions
_log = logging.getLogger("omniscv")
_Planned = list[tuple[tuple[str, ...], list[list[Plan]]]]
_Moments = list[InstantViews]


def costs(job: Job, *, measure: bool = False, searched_s: float = 0.0) -> list[Cost]:
    """Return what a job's images take by ``auto``, by three accuracies, and by every other strategy.

    Strategies that the source does not support are left out.

    Args:
        job: of one world.
        measure: whether two captures of each mode, and one image, are made to measure seconds
            (:func:`measured_pace`). Otherwise they are those of the captures in the job's recording, if it
            says when these were made; else None.
        searched_s: what opening the source with the search of places took before, if the job has the places.
    """
    ways: dict[str, tuple[str, float | None]] = {"auto": ("auto", None)}  # strategy and accuracy
    for aim in _AIMS:
        ways[f"{100 * aim:g} %"] = ("auto", aim)
    for name in planning.names():
        ways.setdefault(name, (name, None))
    found = []
    check(job)
    pace = None if job.record is None or measure else recorded_pace(job.record)
    started = time.perf_counter()
    with opened(replace(job, record=None)) as (job, source):
        if measure:
            opening_s = max(searched_s, time.perf_counter() - started)
            with phase("measuring captures and an image"):
                pace = measured_pace(job, source, opening_s)
        with phase("listing frames"):
            groups = list(_grouped(frames_by_instant(job)))
        plan_of = partial(Renderer(source).plan, options=job.options)
        by_way: dict[str, list[Cost]] = {way: [] for way in ways}
        for moments, count in in_phase("planning", groups):
            for modes, plans in _plans_of(job, moments, plan_of):
                for way in list(by_way):
                    strategy, accuracy = ways[way]
                    try:
                        whole = cost(way, plans, modes, strategy=strategy, accuracy=accuracy)
                    except ArgumentError:  # the source cannot do it
                        del by_way[way]
                        continue
                    by_way[way].append(whole.times(count))
        for costs_of_groups in by_way.values():
            whole = reduce(add, costs_of_groups)
            found.append(replace(whole, seconds=None if pace is None else pace.seconds(whole, len(job))))
    return found


def _grouped(planned: Iterable[SharedFrames]) -> Iterator[tuple[_Moments, float]]:
    """Yield moments that share captures, and how many times they count, as others cost the same.

    Those of the same cameras with the same rotations cost the same at any position. Cameras whose lines are
    read as they move are others at each pose: some stand for all.
    """
    at_centers: dict[tuple[str, bytes], _Moments] = {}
    for shared in planned:
        for moment in shared.captured:
            instant, views, _ = moment
            centers = b"".join(pose.position.tobytes() for _, pose in views)
            at_centers.setdefault((instant.state, centers), []).append(moment)
    alike: dict[Hashable, list[_Moments]] = {}
    for moments in at_centers.values():
        alike.setdefault(_likeness(moments), []).append(moments)
    chosen = []
    for equal in alike.values():
        most = _PLANNED_POSES if _is_moving(equal[0]) else 1
        step = -(-len(equal) // most)
        for moments in equal[::step]:
            chosen.append((moments, len(equal) / len(equal[::step])))
    step = -(-len(chosen) // _PLANNED_CENTERS)
    if step > 1:
        line = "planned at %d of %d places and instants, which stand for the others"
        _log.info(line, len(chosen[::step]), len(chosen))
    factor = sum(count for _, count in chosen) / sum(count for _, count in chosen[::step])
    for moments, count in chosen[::step]:
        yield moments, factor * count


def _likeness(moments: _Moments) -> Hashable:
    """Return what moments that cost the same have in common: modes, cameras at rest, and how they stand."""
    first_w = moments[0][1][0][1].position
    described = []
    for _, views, modes in moments:
        stands: list[Hashable] = []
        for camera, pose in views:
            if path_of(camera) is not None:
                stands.append(without_path(camera))
            else:
                apart = tuple(np.round(pose.position - first_w, _DECIMALS).tolist())
                stands.append((camera, apart, pose.rotation.tobytes()))
        described.append((tuple(stands), modes))
    return tuple(described)


def _is_moving(moments: _Moments) -> bool:
    """Return whether a camera of some moments moves while its lines are read."""
    return any(path_of(camera) is not None for _, views, _ in moments for camera, _ in views)


def _plans_of(job: Job, moments: _Moments, plan_of: Callable[[Camera, Pose], Plan]) -> _Planned:
    """Return the modes of moments that share captures, and the plans of each moment with these modes."""
    plans_of: dict[tuple[str, ...], list[list[Plan]]] = {}
    for _, views, modes in moments:
        plans_of.setdefault(modes, []).append([plan_of(camera, pose) for camera, pose in views])
    planned: _Planned = []
    exposures: _Planned = []
    for captured, plans in plans_of.items():
        modes = job.options.sampled(captured)
        planned.append((modes, plans))
        if "lit" in modes:
            exposures.append((("lit",), plans))
    return planned + exposures * max(0, len(job.brackets) - 1)


# -- time ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pace:
    """What the work of a job was measured to take.

    Attributes:
        price: of captures.
        opening_s: until the source was open, with the search of places.
        image_s: of an image, besides its captures and rays: composed, with its truths, and written.
        rays_s: of an image's rays, where modes come by them.
    """

    price: Price
    opening_s: float = 0.0
    image_s: float = 0.0
    rays_s: float = 0.0

    def __str__(self) -> str:
        price = f"capture_ms=[{self.price.request:.2f},{self.price.megapixel:.2f}]"
        rays = f", {self.rays_s:.3g} s of rays" if self.rays_s else ""
        return (
            f"{price}, {self.opening_s:.3g} s to open the source, {self.image_s:.3g} s an image besides{rays}"
        )

    def seconds(self, whole: Cost, images: int) -> float:
        """Return the seconds that ``images`` with captures as counted take.

        Where what is seen decides, captures are halfway between the expected ones and the most.
        """
        captures = (1 + whole.most / whole.requests) / 2 if whole.requests else 1.0
        captured_s = captures * float(self.price.of(whole.requests, whole.pixels)) / 1e3
        each_s = self.image_s + (self.rays_s if whole.traced else 0.0)
        return self.opening_s + captured_s + images * each_s


class _Spent:
    """Seconds, requests and pixels that a source has spent."""

    def __init__(self) -> None:
        self.captured_s = 0.0
        self.rays_s = 0.0
        self.requests = 0
        self.pixels = 0


class _TimedSource(SourceWrapper):
    """Measures how long captures and rays are waited for.

    Args:
        source: that makes them.
        spent: is added to.
    """

    def __init__(self, source: Source, spent: _Spent) -> None:
        super().__init__(source)
        self._spent = spent

    def around(self, source: Source) -> Source:
        return _TimedSource(source, self._spent)

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        started = time.perf_counter()
        for capture in self._source.capture(requests):
            self._spent.captured_s += time.perf_counter() - started
            self._spent.requests += 1
            self._spent.pixels += capture.request.view.width * capture.request.view.height
            yield capture
            started = time.perf_counter()

    def trace(self, origins_w: Array, directions_w: Array) -> Traced:
        started = time.perf_counter()
        try:
            return self._source.trace(origins_w, directions_w)
        finally:
            self._spent.rays_s += time.perf_counter() - started

    def shade(self, origins_w: Array, directions_w: Array) -> NDArray[np.float32]:
        started = time.perf_counter()
        try:
            return self._source.shade(origins_w, directions_w)
        finally:
            self._spent.rays_s += time.perf_counter() - started


def measured_pace(job: Job, source: Source, opening_s: float) -> Pace:
    """Measure what a job takes by two captures of each mode, and the images of its first pose.

    Where these come soon, they only prepare what is made once, and the images of the next poses are measured.

    Args:
        job: with its poses.
        source: of the job, open.
        opening_s: that opening it took.
    """
    planned = list(frames_by_instant(job, range(min(1 + _MORE_POSES, len(job.poses)))))
    shared = planned[0]
    renderer = Renderer(source)
    with renderer_at(renderer, shared.instant) as renderer_then:
        camera, pose = shared.captured[0][1][0]
        edge = renderer_then.plan(camera, pose, options=job.options).edge
        modes = job.options.sampled(job.captured)
        price = _measured_price(renderer_then.source, pose, modes, edge)
    seconds, spent = _measured_images(job, source, planned[:1])
    count = len(shared.frames)
    if seconds < _SOON_S and len(planned) > 1:
        seconds, spent = _measured_images(job, source, planned[1:])
        count = sum(len(shared.frames) for shared in planned[1:])
    image_s = max(0.0, seconds - spent.captured_s - spent.rays_s)
    expected_ms = price.of(spent.requests, spent.pixels)
    if expected_ms > 0:
        faster = 1e3 * spent.captured_s / expected_ms
        price = Price(faster * price.request, faster * price.megapixel)
    elif spent.requests:  # a recording reads and decodes its captures
        price = Price(1e3 * spent.captured_s / spent.requests, 0.0)
    pace = Pace(price, opening_s, image_s / count, spent.rays_s / count)
    _log.info("measured: %s", pace)
    return pace


def _measured_images(job: Job, source: Source, planned: Sequence[SharedFrames]) -> tuple[float, _Spent]:
    """Return the seconds in which images were made, and what the source spent of them."""
    spent = _Spent()
    timed = _TimedSource(source, spent)
    started = time.perf_counter()
    with TemporaryDirectory(prefix="omniscv-") as folder:
        _make(replace(job, out=Path(folder) / "measured", record=None), timed, planned)
    return time.perf_counter() - started, spent


def _make(job: Job, source: Source, planned: Sequence[SharedFrames]) -> None:
    """Compose and write planned images, one while the next is composed: of a dataset with their truths."""
    if job.recipe != Recipe():
        keys = {frame.key for shared in planned for frame in shared.frames}
        run_part(replace(job, recipe=replace(job.recipe, exports=())), Part(), source=source, chosen=keys)
        return
    renderer = Renderer(source)

    def save(shared: SharedFrames, image: OmniImage, number: int) -> None:
        key = shared.frames[number].key
        image.save(Path(job.out), key, job.image_format, job.store, job.depth_format)

    def images() -> Iterator[tuple[SharedFrames, OmniImage, int]]:
        for shared in planned:
            for number, image in enumerate(images_of(renderer, shared, job)):
                yield shared, image, number

    deque(ahead(lambda made: save(*made), images(), 1), maxlen=0)


def _measured_price(source: Source, pose: Pose, modes: tuple[str, ...], edge: int) -> Price:
    """Return what captures take by two of each mode: of an edge, px, and of a smaller one.

    The first one of a mode is not timed where a source prepares much for it: the image is.
    """
    if source.recorded_views() is not None:
        return Price(0.0, 0.0)
    can = source.capabilities
    smaller = edge if not can.can_set_size else max(_LEAST_PX, edge // _SMALLER)
    requests_ms = []
    megapixels_ms = []
    for mode in modes:
        large_ms = _capture_ms(source, pose, mode, edge)
        small_ms = _capture_ms(source, pose, mode, smaller)
        more = 1e-6 * (edge**2 - smaller**2)
        megapixel_ms = max(0.0, large_ms - small_ms) / more if more else 0.0
        megapixels_ms.append(megapixel_ms)
        requests_ms.append(max(0.0, small_ms - 1e-6 * smaller**2 * megapixel_ms))
    count = max(1, len(modes))
    return Price(sum(requests_ms) / count, sum(megapixels_ms) / count)


def _capture_ms(source: Source, pose: Pose, mode: str, edge: int) -> float:
    """Return the milliseconds of a capture of a mode, of an edge, px, unless the source sets its size."""
    can = source.capabilities
    width, height = can.image_size or (edge, edge)
    view = View(pose, can.fov_deg or 90.0, width, height)
    started = time.perf_counter()
    list(source.capture([Request(view, mode, source.state)]))
    return 1e3 * (time.perf_counter() - started)


def recorded_pace(path: Path) -> Pace | None:
    """Return what captures in a recording took, of those that say when they were made; None if they do not.

    Pauses between sessions are left out.
    """
    if not path.exists() or not path.stat().st_size:
        return None
    with closing(Store(path)) as store:
        times = []
        for row in store.listing():
            made_at = object_from_json(row.provenance).get("time")
            if isinstance(made_at, int | float):
                times.append(float(made_at))
    between = [later - before for before, later in pairwise(sorted(times))]
    if not between:
        return None
    longest = _PAUSE * median(between)
    working = [seconds for seconds in between if seconds <= longest]
    return Pace(Price(1e3 * sum(working) / len(working), 0.0)) if working else None
