"""Strategies: the interface, the registry, the task that a strategy plans for, and the rounds of viewpoints
that it yields."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, islice
from typing import Any, ClassVar, TypeVar

import numpy as np

from omniscv import modalities, plugins
from omniscv.arguments import one_of
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Array, Pose
from omniscv.geometry.arrays import Ints, Mask
from omniscv.geometry.pose import rotated
from omniscv.planning import tuned
from omniscv.planning.ray_marching import Hits, KnownDepth
from omniscv.planning.rays import ImageRays, RayGroup
from omniscv.progress import Progress
from omniscv.render_options import COMPARED, RenderOptions
from omniscv.sources.base import Capabilities, Capture, Request, Source, View
from omniscv.sources.recorded_views import RecordedViews, Shape

_LARGEST_PX = 16384  # of a finer view of ground truth
FINER = "finer "
"""Before the mode of captures that are compared."""


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """An optical centre, what is captured there, and the pixels that it serves.

    Attributes:
        center_w: (3,) the centre, world frame, metres.
        views: of colours; those of ground truth are ``truth_scale`` times finer.
        pixels: (N,) int64, row-major flat indices of the image's pixels that it serves; none where its
            captures only inform the strategy.
        modes: what is captured; all that the image needs if not given.
        keep: whether the strategy is sent its captures at the end of the round.
        toward_w: (N, 3) directions, of any length, in which the pixels are looked up; their own rays if None.
        known_depth: of the pixels, where the strategy knows it; depth is then not captured.
        check: what the pixels' own rays meet, as far as the camera's position sees it, where they are
            captured from another centre that is far from their own.
        occluded: (N,) bool, pixels whose own optical centre is not visible from the camera's position;
            None: not judged.
        unsure: (N,) bool, pixels whose own optical centre may lie beyond a surface, seen from ``center_w``;
            None: not judged.
        truth_scale: set by :func:`omniscv.planning.rounds` for every strategy.
        state: of the world in which captures are made; set as well.
        compared: whether depth and masks are captured in a second, finer size, too; set as well.
    """

    center_w: Array
    views: tuple[View, ...]
    pixels: Ints
    modes: tuple[str, ...] | None = None
    keep: bool = False
    toward_w: Array | None = None
    known_depth: KnownDepth | None = None
    check: Hits | None = None
    occluded: Mask | None = None
    unsure: Mask | None = None
    truth_scale: int = 1
    state: str = ""
    compared: bool = False

    def views_of(self, mode: str) -> tuple[View, ...]:
        """Return the views that are captured in a mode."""
        return self._scaled(self._scale(mode))

    def finer(self, modes: Sequence[str]) -> list[Request]:
        """Return the captures that are compared with those of ground truth; none where nothing is."""
        if not self.compared:
            return []
        names = [modalities.get(mode).name for mode in (modes if self.modes is None else self.modes)]
        shapes = [(view, Shape.of(view).finer()) for view in self._scaled(self.truth_scale)]
        views = [replace(view, width=width, height=height) for view, (width, height, _) in shapes]
        return [Request(view, mode, self.state) for view in views for mode in COMPARED if mode in names]

    def requests(self, modes: Sequence[str]) -> list[Request]:
        """Return the captures for an image in some modes.

        They are ordered view by view, ground truth first where it is finer: a server then poses its camera
        once for all modes of one size. Depth comes first.
        """
        rows = [modalities.get(mode) for mode in (modes if self.modes is None else self.modes)]
        # Depth differs between viewpoints where colours may be alike: a live source detects by it that its
        # camera has moved.
        depth = [row.name for row in rows if row.interpolation == "surface" and self.known_depth is None]
        others = [row.captured_as or row.name for row in rows if row.interpolation != "surface"]
        captured = list(dict.fromkeys(depth + others))
        scales = sorted(set(map(self._scale, captured)), reverse=True)
        return [
            Request(view, mode, self.state)
            for scale in scales
            for view in self._scaled(scale)
            for mode in captured
            if self._scale(mode) == scale
        ] + self.finer(modes)

    def _scale(self, mode: str) -> int:
        return self.truth_scale if modalities.get(mode).truth else 1

    def _scaled(self, scale: int) -> tuple[View, ...]:
        return self.views if scale == 1 else tuple(view.scaled(scale) for view in self.views)


@dataclass(frozen=True, eq=False)
class Round:
    """Viewpoints that are captured one after the other, before the strategy decides on the next round.

    Attributes:
        viewpoints: in the order of their capture.
        stopped: why no round follows that would make the image more accurate; empty where that is not known.
        instead: the strategy that is taken where the source cannot do what the task's needs.
    """

    viewpoints: tuple[Viewpoint, ...]
    stopped: str = ""
    instead: str = ""

    def changed(self, change: Callable[[Viewpoint], Viewpoint]) -> Round:
        """Return the round with every viewpoint changed."""
        return replace(self, viewpoints=tuple(map(change, self.viewpoints)))

    def requests(self, modes: Sequence[str]) -> list[Request]:
        """Return the captures of an image in some modes, viewpoint by viewpoint."""
        return [request for viewpoint in self.viewpoints for request in viewpoint.requests(modes)]


class Kept(list[Mapping[str, Sequence[Capture]]]):
    """The captures of a round's viewpoints that are kept, in their order: by mode, in the views' order.

    Attributes:
        doubt: returns (H, W) bool, the pixels that the image doubts, as far as it is composed; None where
            captures are not composed.
    """

    def __init__(self, doubt: Callable[[], Mask] | None = None) -> None:
        super().__init__()
        self.doubt = doubt


Rounds = Generator[Round, Kept | None, None]
"""Yields rounds, is sent their kept captures; None where a plan is made without capturing."""


def pass_on(
    rounds: Rounds, change: Callable[[Round], Round] = lambda planned: planned
) -> Generator[Round, Kept | None, Any]:
    """Yield rounds, changed, and pass on what is sent; return what was sent for the last one."""
    kept: Kept | None = None
    with closing(rounds):
        while (planned := _next(rounds, kept)) is not None:
            kept = yield change(planned)
    return kept


def _next(rounds: Rounds, kept: Kept | None) -> Round | None:
    """Return the next round, None at the end, when what was kept of the last one is sent."""
    try:
        return rounds.send(kept)
    except StopIteration:
        return None


def drive(rounds: Rounds, capture: Callable[[Round], Kept | None]) -> None:
    """Run a strategy to its end.

    Args:
        rounds: the strategy's generator.
        capture: called with each round; returns its kept captures, or None where nothing is captured.
    """
    kept: Kept | None = None
    with closing(rounds):
        while (planned := _next(rounds, kept)) is not None:
            kept = capture(planned)


def captured(
    round_: Round, source: Source, modes: Sequence[str], skip: Container[Request] = ()
) -> Iterator[tuple[Viewpoint, dict[str, list[Capture]]]]:
    """Capture a round, and yield its viewpoints with their captures by mode, in the views' order.

    Those that are compared are under ``FINER`` and the mode.

    Args:
        round_: what to capture.
        source: where captures come from; requests are read ahead as far as it pipelines.
        modes: of the image.
        skip: requests that are not made again, except for viewpoints that are kept.

    Raises:
        BadReplyError: the source ends early.
    """
    missing = [[r for r in v.requests(modes) if v.keep or r not in skip] for v in round_.viewpoints]
    captures = iter(source.capture(request for requests in missing for request in requests))
    for viewpoint, requests in zip(round_.viewpoints, missing, strict=True):
        by_mode: dict[str, list[Capture]] = {}
        finer = frozenset(viewpoint.finer(modes))
        for request, capture in zip(requests, islice(captures, len(requests)), strict=False):
            mode = (FINER if request in finer else "") + capture.mode
            by_mode.setdefault(mode, []).append(capture)
        if (count := sum(map(len, by_mode.values()))) < len(requests):
            raise BadReplyError(f"source: expected {len(requests)} captures of a viewpoint, got {count}")
        yield viewpoint, by_mode


def pixels_of(views: Iterable[View]) -> int:
    """Return how many pixels views have."""
    return sum(view.width * view.height for view in views)


def captured_progress(captures: Mapping[str, Sequence[Capture]]) -> Progress:
    """Return the progress that the captures of a viewpoint, by mode, are."""
    flat = list(chain.from_iterable(captures.values()))
    sizes = (c.pixels.nbytes if c.payload is None else len(c.payload) for c in flat)
    return Progress(captures=len(flat), nbytes=sum(sizes))


@dataclass(frozen=True, eq=False)
class Task:
    """One image for which captures are planned.

    Attributes:
        rays: the camera's, in its frame.
        pose: of the camera, world frame.
        capabilities: of the source.
        options: how the image is rendered.
        cover: the views that together show all that one should (:meth:`omniscv.sources.Source.cover`).
        recorded: the views of a recording; None for sources that make new captures.
        border_px: how much wider views are on every side; what the widest filter needs, if not given.
        state: of the world, in which captures are made.
        modes: that the image samples; only a planner that is asked for an accuracy reads them.
        shared: whether its captures serve other cameras, too: faces of a cube map, and no view of its own.
    """

    rays: ImageRays
    pose: Pose
    capabilities: Capabilities
    options: RenderOptions = field(default_factory=RenderOptions)
    cover: Callable[[View], tuple[View, ...]] = lambda view: (view,)
    recorded: RecordedViews | None = None
    border_px: int | None = None
    state: str = ""
    modes: tuple[str, ...] = ()
    shared: bool = False

    def __post_init__(self) -> None:
        if self.border_px is not None and self.border_px < 0:
            raise ArgumentError(f"border_px: expected a whole number of pixels >= 0, got {self.border_px!r}")

    @cached_property
    def edge(self) -> int:
        """px of a 90 degree face."""
        size = self.options.face_size
        return self.rays.face_size if size == "auto" else size

    def available(self, views: Sequence[View]) -> bool:
        """Return whether the source can deliver views: if it is a recording, as colours or as ground
        truth."""
        scales = {1, self.options.truth_scale}
        return self.recorded is None or any(
            self.recorded.hold(view.scaled(scale) for view in views) for scale in scales
        )

    @property
    def sets_views(self) -> bool:
        """Whether views may have any size and field of view."""
        return self.capabilities.can_set_size and self.capabilities.can_set_fov

    @property
    def scattered(self) -> bool:
        """Whether nearly every pixel has an optical centre of its own, and the options ask for no fewer."""
        return self.options.viewpoints is None and self.rays.scattered

    @property
    def aim(self) -> float | None:
        """Share of the valid pixels that may be doubtful; None where captures do not depend on it.

        ``auto`` has an aim of its own where there are many optical centres: of few, each is captured.
        """
        if self.options.accuracy is not None or self.options.strategy != "auto" or self.rays.one_center:
            return self.options.accuracy
        return tuned.DEFAULT_AIM if self.scattered or len(self.rays.groups()) > tuned.FEW_CENTERS else None

    def finished(self, viewpoint: Viewpoint) -> Viewpoint:
        """Return a viewpoint in the task's state of the world, compared if the options ask for it.

        Raises:
            ArgumentError: the source cannot capture what is compared.
        """
        compared = self.options.checks == "beat" and (len(viewpoint.pixels) > 0 or not viewpoint.keep)
        if compared and not self.capabilities.can_set_size:
            raise ArgumentError("checks: expected none or light of a source of one size, got beat")
        return replace(viewpoint, state=self.state, compared=compared)

    def border(self, default: int) -> int:
        """Return how much wider views are on every side, px."""
        return default if self.border_px is None else self.border_px

    def groups(self, viewpoints: int | None = None) -> tuple[RayGroup, ...]:
        """Return the valid pixels by optical centre, as many centres as the options have, else as given."""
        count = self.options.viewpoints
        return self.rays.groups(viewpoints if count is None else count)

    def origins_w(self, pixels: Ints) -> Array:
        """Return (N, 3) the optical centres of a non-central camera's pixels, world frame, metres."""
        assert self.rays.origins is not None
        return self.pose.to_world(self.rays.origins.reshape(-1, 3)[pixels])

    def directions_w(self, pixels: Ints) -> Array:
        """Return (N, 3) the unit rays of pixels, world frame."""
        return rotated(RayGroup(np.zeros(3), pixels, self.rays).directions, self.pose.R_w_c)


class Strategy(ABC):
    """Which views an image is captured with: a class without arguments, registered under its name.

    Attributes:
        name: of the options.
    """

    name: ClassVar[str]

    @abstractmethod
    def rounds(self, task: Task) -> Rounds:
        """Yield rounds until every valid pixel is served, each once.

        A round whose captures are not sent (None: a plan is made) is followed by what is needed at least.

        Raises:
            ArgumentError: the source cannot do what the strategy needs.
        """


S = TypeVar("S", bound=Strategy)

_strategies: dict[str, type[Strategy]] = {}


def register(strategy: type[S]) -> type[S]:
    """Add a strategy under its name; also as a decorator.

    Raises:
        ArgumentError: no subclass of Strategy with a name, or another class under a name that is taken.
    """
    if not (isinstance(strategy, type) and issubclass(strategy, Strategy) and hasattr(strategy, "name")):
        raise ArgumentError(f"strategy: expected a subclass of Strategy with a name, got {strategy!r}")
    if _strategies.setdefault(strategy.name, strategy) is not strategy:
        raise ArgumentError(f"strategy: expected a name that is not taken, got {strategy.name!r} again")
    return strategy


def names() -> tuple[str, ...]:
    """Return the names of all strategies."""
    plugins.load()
    return tuple(_strategies)


def get(name: str) -> Strategy:
    """Return the strategy of a name.

    Raises:
        ArgumentError: no strategy has that name.
    """
    if name not in _strategies and name not in names():
        one_of("strategy", name, names())
    return _strategies[name]()


def rounds(task: Task) -> Rounds:
    """Return the rounds of a task's strategy, in the task's state of the world, with its ``truth_scale``.

    Raises:
        ArgumentError: an unknown strategy, or finer ground truth of a source that cannot set the size of
            views.
    """
    options, strategy = task.options, get(task.options.strategy)
    if options.truth_scale > 1 and not task.capabilities.can_set_size:
        wanted = "expected 1 of a source that cannot set the size"
        raise ArgumentError(f"truth_scale: {wanted}, got {options.truth_scale}")

    scale = options.truth_scale

    def finish(viewpoint: Viewpoint) -> Viewpoint:
        largest = max((max(view.width, view.height) for view in viewpoint.views), default=0)
        if scale > 1 and scale * largest > _LARGEST_PX:
            raise ArgumentError(
                f"truth_scale: expected views of at most {_LARGEST_PX} px, got {scale} x {largest}; "
                "give a smaller face_size or truth_scale"
            )
        return task.finished(replace(viewpoint, truth_scale=scale))

    return pass_on(strategy.rounds(task), lambda each: each.changed(finish))
