"""Rounds of viewpoints: what a strategy yields, and how it is captured."""

from __future__ import annotations

from collections.abc import Callable, Container, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import chain, islice

from omniscv import modalities
from omniscv.depth.hits import Hits, KnownDepth
from omniscv.errors import BadReplyError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Ints, Mask
from omniscv.progress import Progress
from omniscv.render_options import COMPARED
from omniscv.sources.base import Capture, Request, Source, View
from omniscv.sources.recorded_views import Shape

FINER = "finer "
"""Before the mode of captures that are compared."""


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """An optical centre, what is captured there, and the pixels that it serves.

    Attributes:
        center_w: (3,) the centre, world frame, metres.
        views: of colours.
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
        truth_scale: how much finer ground truth is captured; as the options say if None.
        state: of the world in which captures are made; set by the plan.
        compared: whether depth and masks are captured in a second, finer size, too; set by the plan.
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
    truth_scale: int | None = None
    state: str = ""
    compared: bool = False

    def views_of(self, mode: str) -> tuple[View, ...]:
        """Return the views that are captured in a mode."""
        return self._scaled(self._scale(mode))

    def finer(self, modes: Sequence[str]) -> list[Request]:
        """Return the captures that are compared with those of ground truth; none where nothing is."""
        if not self.compared:
            return []
        names = [row.name for row in self._rows(modes)]
        requests = []
        for view in self._scaled(self.truth_scale or 1):
            width, height, _ = Shape.of(view).finer()
            finer_view = replace(view, width=width, height=height)
            for mode in COMPARED:
                if mode in names:
                    requests.append(Request(finer_view, mode, self.state))
        return requests

    def requests(self, modes: Sequence[str]) -> list[Request]:
        """Return the captures for an image in some modes.

        They are ordered view by view, ground truth first where it is finer: a server then poses its camera
        once for all modes of one size. Depth comes first.
        """
        # Depth differs between viewpoints where colours may be alike: a live source detects by it that its
        # camera has moved.
        depth = []
        others = []
        for row in self._rows(modes):
            if row.interpolation != "surface":
                others.append(row.captured_as or row.name)
            elif self.known_depth is None:
                depth.append(row.name)
        captured = list(dict.fromkeys(depth + others))
        requests = []
        for scale in sorted(set(map(self._scale, captured)), reverse=True):
            modes_of_scale = [mode for mode in captured if self._scale(mode) == scale]
            for view in self._scaled(scale):
                for mode in modes_of_scale:
                    requests.append(Request(view, mode, self.state))
        return requests + self.finer(modes)

    def _rows(self, modes: Sequence[str]) -> list[modalities.Modality]:
        """Return the modalities that are captured here for an image in some modes."""
        return [modalities.get(mode) for mode in (modes if self.modes is None else self.modes)]

    def _scale(self, mode: str) -> int:
        """Return how much finer a mode is captured than colours."""
        if self.truth_scale is None or not modalities.get(mode).truth:
            return 1
        return self.truth_scale

    def _scaled(self, scale: int) -> tuple[View, ...]:
        """Return the views, so much finer."""
        if scale == 1:
            return self.views
        return tuple(view.scaled(scale) for view in self.views)


@dataclass(frozen=True, eq=False)
class Round:
    """Viewpoints that are captured one after the other, before the strategy decides on the next round.

    Attributes:
        viewpoints: in the order of their capture.
        stopped: why no round follows that would make the image more accurate; empty where that is not known.
        instead: the strategy that is taken where the source cannot do what the plan's needs.
    """

    viewpoints: tuple[Viewpoint, ...]
    stopped: str = ""
    instead: str = ""

    @property
    def informs(self) -> bool:
        """Whether the strategy is sent captures of the round, on which later ones depend."""
        return any(viewpoint.keep for viewpoint in self.viewpoints)

    def changed(self, change: Callable[[Viewpoint], Viewpoint]) -> Round:
        """Return the round with every viewpoint changed."""
        return replace(self, viewpoints=tuple(map(change, self.viewpoints)))

    def requests(self, modes: Sequence[str]) -> list[Request]:
        """Return the captures of an image in some modes, viewpoint by viewpoint."""
        requests = []
        for viewpoint in self.viewpoints:
            requests += viewpoint.requests(modes)
        return requests


Captures = list[Mapping[str, Sequence[Capture]]]
"""Of a round's viewpoints that are kept, in their order: by mode, in the views' order."""

Rounds = Generator[Round, Captures | None, None]
"""Yields rounds, is sent their kept captures; None where a plan is made without capturing."""


def pass_on(rounds: Rounds, change: Callable[[Round], Round]) -> Rounds:
    """Yield rounds, each after a ``change``, and pass on what is sent."""
    kept: Captures | None = None
    with closing(rounds):
        while (planned := _next(rounds, kept)) is not None:
            kept = yield change(planned)


def _next(rounds: Rounds, kept: Captures | None) -> Round | None:
    """Return the next round, None at the end, when what was kept of the last one is sent."""
    try:
        return rounds.send(kept)
    except StopIteration:
        return None


def drive(rounds: Rounds, capture: Callable[[Round], Captures | None]) -> None:
    """Run a strategy to its end.

    Args:
        rounds: the strategy's generator.
        capture: called with each round; returns its kept captures, or None where nothing is captured.
    """
    kept: Captures | None = None
    with closing(rounds):
        while (planned := _next(rounds, kept)) is not None:
            kept = capture(planned)


def captured(
    round_: Round, source: Source, modes: Sequence[str], skip: Container[Request] = ()
) -> Iterator[tuple[Viewpoint, dict[str, list[Capture]]]]:
    """Capture a round, and yield its viewpoints with their captures by mode, in the views' order; those that
    are compared are under ``FINER`` and the mode.

    Args:
        round_: the viewpoints.
        source: reads requests ahead, as far as it pipelines.
        modes: of the image.
        skip: requests that are not made again, except for viewpoints that are kept.

    Raises:
        BadReplyError: the source ends early.
    """
    missing = []
    for viewpoint in round_.viewpoints:
        requests = viewpoint.requests(modes)
        if not viewpoint.keep:
            requests = [request for request in requests if request not in skip]
        missing.append(requests)
    captures = iter(source.capture(chain.from_iterable(missing)))
    for viewpoint, requests in zip(round_.viewpoints, missing, strict=True):
        by_mode: dict[str, list[Capture]] = {}
        finer = frozenset(viewpoint.finer(modes))
        for request, capture in zip(requests, islice(captures, len(requests)), strict=False):
            mode = (FINER if request in finer else "") + capture.mode
            stated = source.stated(capture) if capture.mode == "depth" else capture
            by_mode.setdefault(mode, []).append(stated)
        count = sum(map(len, by_mode.values()))
        if count < len(requests):
            raise BadReplyError(f"source: expected {len(requests)} captures of a viewpoint, got {count}")
        yield viewpoint, by_mode


def pixels_of(views: Iterable[View]) -> int:
    """Return how many pixels views have."""
    return sum(view.width * view.height for view in views)


def captured_progress(captures: Mapping[str, Sequence[Capture]]) -> Progress:
    """Return the progress that the captures of a viewpoint, by mode, are."""
    count = 0
    nbytes = 0
    for capture in chain.from_iterable(captures.values()):
        count += 1
        nbytes += capture.pixels.nbytes if capture.payload is None else len(capture.payload)
    return Progress(captures=count, nbytes=nbytes)
