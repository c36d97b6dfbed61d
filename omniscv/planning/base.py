"""What a plan is made of: rounds of viewpoints, and the strategies that yield them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import ClassVar, Literal, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.arguments import number, one_of, shown, text, whole_number
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Array, Pose
from omniscv.planning import densities
from omniscv.planning.recorded_faces import RecordedViews
from omniscv.planning.viewpoints import CameraRays, RayGroup
from omniscv.progress import Progress
from omniscv.sources.base import Capabilities, Capture, Request, Source, View

Filter = Literal["auto", "nearest", "bilinear", "bicubic", "area"]
FILTERS: tuple[str, ...] = get_args(Filter)
Normals = Literal["captured", "from-depth"]
FINEST_TRUTH = 8
MOST_VIEWPOINTS = 1_000_000
"""As an image has columns, at most."""


class RenderKeywords(TypedDict, total=False):
    """The options of :class:`RenderOptions` as keyword arguments."""

    strategy: str
    viewpoints: int | None
    face_size: int | Literal["auto"]
    filter: Filter
    max_error_px: float | None
    truth_scale: int
    normals: Normals


@dataclass(frozen=True)
class RenderOptions:
    """How an image is captured and composed.

    Args:
        strategy: which views are captured: a name of :func:`omniscv.planning.names`.
        viewpoints: optical centres of a non-central camera; chosen by the strategy if not given.
        face_size: px of a 90 degree face; ``auto`` is the smallest that loses no detail and few edges.
        filter: for blended modalities: ``nearest``, ``bilinear``, ``bicubic``, ``area`` (averages what a
            pixel spans) or ``auto``: area where most pixels span two of a view's or more, else bilinear.
        max_error_px: the error that ``reproject`` and ``adaptive`` may make, in output pixels.
        truth_scale: how many times finer than colours masks, depth and normals are captured, 1 to 8.
        normals: ``captured``, or ``from-depth``: of planes fitted to captured depth.

    Raises:
        ArgumentError: a value outside its domain.
    """

    strategy: str = "auto"
    viewpoints: int | None = None
    face_size: int | Literal["auto"] = "auto"
    filter: Filter = "auto"
    max_error_px: float | None = None
    truth_scale: int = 1
    normals: Normals = "captured"

    def __post_init__(self) -> None:
        text("strategy", self.strategy)
        one_of("filter", self.filter, FILTERS)
        one_of("normals", self.normals, get_args(Normals))
        if self.viewpoints is not None:
            whole_number("viewpoints", self.viewpoints, most=MOST_VIEWPOINTS)
        size = self.face_size
        if size != "auto" and not (type(size) is int and 1 <= size <= densities.LARGEST):
            wanted = f"expected 'auto' or 1 to {densities.LARGEST} px"
            raise ArgumentError(f"face_size: {wanted}, got {shown(size)}")
        if self.max_error_px is not None:
            number("max_error_px", self.max_error_px, above=0)
        whole_number("truth_scale", self.truth_scale, most=FINEST_TRUTH)


def sampled(modes: Sequence[str], options: RenderOptions) -> tuple[str, ...]:
    """Return the modalities that are sampled for those that an image shows: normals may come from depth."""
    other = {"normals": "normals_from_depth"} if options.normals == "from-depth" else {}
    return tuple(other.get(mode, mode) for mode in modes)


@dataclass(frozen=True, eq=False)
class FoundDepth:
    """What a strategy knows of the depth of N pixels before their other modalities are captured.

    Attributes:
        distance: (N,) float32 metres along the pixels' own rays, +inf no surface.
        error: (N,) float32 metres, how far that may be off; +inf where nothing bounds it.
        direction_error: (N,) float32 radians, how far the directions of the lookup may be off for it.
        grazes: (N,) bool, whether a ray passes within a capture's pixel of another surface on its way.
        unsure: (N,) bool, what no capture verified.
    """

    distance: NDArray[np.float32]
    error: NDArray[np.float32]
    direction_error: NDArray[np.float32]
    grazes: NDArray[np.bool_]
    unsure: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """An optical centre, what is captured there, and the pixels that it serves.

    Attributes:
        center_w: (3,) the centre, world frame, metres.
        views: the pictures taken there, of colours; those of ground truth are ``truth_scale`` times finer.
        pixels: (N,) int64, row-major flat indices of the image's pixels that it serves; none where its
            captures only inform the strategy.
        modes: what is captured; all that the image needs if not given.
        keep: whether the strategy is sent its captures at the end of the round.
        toward_w: (N, 3) directions, of any length, in which the pixels are looked up; their own rays if None.
        found: the depth of the pixels, where the strategy knows it; depth is then not captured.
        check: what is known of the depth along the pixels' own rays, which share another centre.
        occluded: (N,) bool, pixels whose own optical centre is not visible from the camera's position;
            None: not judged.
        truth_scale: set by :func:`omniscv.planning.rounds` for every strategy.
        state: of the world in which captures are made; set as well.
    """

    center_w: Array
    views: tuple[View, ...]
    pixels: NDArray[np.int64]
    modes: tuple[str, ...] | None = None
    keep: bool = False
    toward_w: Array | None = None
    found: FoundDepth | None = None
    check: FoundDepth | None = None
    occluded: NDArray[np.bool_] | None = None
    truth_scale: int = 1
    state: str = ""

    def views_of(self, mode: str) -> tuple[View, ...]:
        """Return the pictures taken in a mode."""
        scale = self.truth_scale if modalities.get(mode).truth else 1
        return self.views if scale == 1 else tuple(view.scaled(scale) for view in self.views)

    def requests(self, modes: Sequence[str]) -> list[Request]:
        """What is captured for an image in some modes, view by view: a server poses its camera once for all
        modes of one size.

        Depth comes first, because it differs between places where colours may be alike: a live source
        detects by it that its camera has moved.
        """
        wanted = modes if self.modes is None else self.modes
        order = [mode for mode in ("depth",) if mode in wanted and self.found is None]
        order += [modalities.get(mode).captured_as or mode for mode in wanted if mode != "depth"]
        order = list(dict.fromkeys(order))
        finer = [mode for mode in order if self.truth_scale > 1 and modalities.get(mode).truth]
        sizes = finer, [mode for mode in order if mode not in finer]
        return [
            Request(view, mode, self.state)
            for same in sizes
            if same
            for view in self.views_of(same[0])
            for mode in same
        ]


@dataclass(frozen=True, eq=False)
class Round:
    """Viewpoints that are captured one after the other, before the strategy decides on the next round."""

    viewpoints: tuple[Viewpoint, ...]

    def requests(self, modes: Sequence[str]) -> list[Request]:
        """What is captured, viewpoint by viewpoint."""
        return [request for viewpoint in self.viewpoints for request in viewpoint.requests(modes)]


Kept = Sequence[Mapping[str, Sequence[Capture]]]
"""The captures of a round's viewpoints that are kept, in their order: by mode, in the views' order."""

Rounds = Generator[Round, Kept | None, None]
"""Yields rounds, is sent what was captured; None where a plan is made without capturing."""


@dataclass(frozen=True, eq=False)
class Task:
    """What a strategy plans for.

    Attributes:
        rays: the camera's, in its frame.
        pose: of the camera, world frame.
        capabilities: of the source.
        options: how the image is rendered.
        cover: the views that together show all that one should (:meth:`omniscv.sources.Source.cover`).
        recorded: what a recording holds; None for sources that make new captures.
        border_px: how much wider views are on every side; what the widest filter needs, if not given.
        state: of the world, in which captures are made.
    """

    rays: CameraRays
    pose: Pose
    capabilities: Capabilities
    options: RenderOptions = field(default_factory=RenderOptions)
    cover: Callable[[View], tuple[View, ...]] = lambda view: (view,)
    recorded: RecordedViews | None = None
    border_px: int | None = None
    state: str = ""

    def __post_init__(self) -> None:
        if self.border_px is not None and self.border_px < 0:
            raise ArgumentError(f"border_px: expected a whole number of pixels >= 0, got {self.border_px!r}")

    @cached_property
    def edge(self) -> int:
        """px of a 90 degree face."""
        size = self.options.face_size
        return self.rays.face_size if size == "auto" else size

    def available(self, views: Sequence[View]) -> bool:
        """Return whether the source can deliver views: unless it is a recording without them, be it as
        colours or as ground truth."""
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
        """Whether every pixel, or nearly, has an optical centre of its own, and fewer are not wanted."""
        return self.options.viewpoints is None and self.rays.scattered

    def border(self, default: int) -> int:
        """How much wider views are on every side, px."""
        return default if self.border_px is None else self.border_px

    def groups(self, viewpoints: int | None = None) -> tuple[RayGroup, ...]:
        """The valid pixels by optical centre, as many centres as the options have, else as given."""
        count = self.options.viewpoints
        return self.rays.groups(viewpoints if count is None else count)


class Strategy(ABC):
    """Which views an image is captured with: a class without arguments, registered under its name.

    Attributes:
        name: what options call it.
        approximate: whether it makes an error that ``max_error_px`` bounds.
    """

    name: ClassVar[str]
    approximate: ClassVar[bool] = False

    @abstractmethod
    def rounds(self, task: Task) -> Rounds:
        """Yield rounds until every valid pixel is served, each once.

        A round whose captures are not sent (None: a plan is made) is followed by what is needed at least.

        Raises:
            ArgumentError: the source cannot do what the strategy needs.
        """

    def further_views(self, task: Task) -> tuple[int, int]:
        """Return how many views a plan lacks that depend on what is captured: an estimate, and the most."""
        return 0, 0


def changed(rounds: Rounds, change: Callable[[Viewpoint], Viewpoint]) -> Rounds:
    """Yield a strategy's rounds with every viewpoint changed; what is sent goes on to the strategy."""
    with closing(rounds):
        following = next(rounds, None)
        while following is not None:
            kept = yield Round(tuple(map(change, following.viewpoints)))
            try:
                following = rounds.send(kept)
            except StopIteration:
                return


def drive(rounds: Rounds, capture: Callable[[Round], Kept | None]) -> None:
    """Run a strategy to its end; rendering, recording and planning all do.

    Args:
        rounds: the strategy's generator.
        capture: called with each round; returns what the strategy is sent.
    """
    with closing(rounds):
        following = next(rounds, None)
        while following is not None:
            kept = capture(following)
            try:
                following = rounds.send(kept)
            except StopIteration:
                return


def captured(
    round_: Round, source: Source, modes: Sequence[str], skip: Container[Request] = ()
) -> Iterator[tuple[Viewpoint, dict[str, list[Capture]]]]:
    """Capture a round, and yield its viewpoints with their captures by mode, in the views' order.

    Args:
        round_: what to capture.
        source: where captures come from; requests are read ahead as far as it pipelines.
        modes: of the image.
        skip: requests that are not made again, but for viewpoints that are kept.

    Raises:
        BadReplyError: the source ends early.
    """
    wanted = [[r for r in v.requests(modes) if v.keep or r not in skip] for v in round_.viewpoints]
    captures = iter(source.capture(request for requests in wanted for request in requests))
    for viewpoint, requests in zip(round_.viewpoints, wanted, strict=True):
        found: dict[str, list[Capture]] = {}
        for capture in islice(captures, len(requests)):
            found.setdefault(capture.mode, []).append(capture)
        if (came := sum(map(len, found.values()))) < len(requests):
            raise BadReplyError(f"source: expected {len(requests)} captures of a viewpoint, got {came}")
        yield viewpoint, found


def captured_progress(captures: Mapping[str, Sequence[Capture]]) -> Progress:
    """Return how far the captures of a viewpoint, by mode, bring a work."""
    every = [capture for mine in captures.values() for capture in mine]
    sizes = (len(each.payload) if each.payload is not None else each.pixels.nbytes for each in every)
    return Progress(captures=len(every), nbytes=sum(sizes))
