"""Progress of long work as data: images, and the captures that they are composed of."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import astuple, dataclass, replace
from operator import add, sub
from statistics import linear_regression
from threading import Lock
from typing import Self, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Progress:
    """Counts of work done; the progress of parts adds up.

    Attributes:
        images: images done.
        of_images: images in all.
        captures: received, for these images and those in progress; a shared capture counts for each image.
        of_captures: known to be needed so far; adaptive strategies request more later.
        nbytes: received for the captures; of their pixels where they were not encoded.
    """

    images: int = 0
    of_images: int = 0
    captures: int = 0
    of_captures: int = 0
    nbytes: int = 0

    def __add__(self, other: Self) -> Self:
        return type(self)(*map(add, astuple(self), astuple(other)))

    def __sub__(self, other: Self) -> Self:
        return type(self)(*map(sub, astuple(self), astuple(other)))


_SETTLED = 0.25
"""An estimate is made of a time that is at least so long as the time before it, which kernels, first captures
and the opening of a source take."""
_FEWEST = 2  # images of a few, or captures of a single one, whose time is measured
_MANY = 4  # images of many whose time is measured: some of them may be made at a time
_POINTS = 100  # images, about, through whose times a line is laid: some are made at a time, or take longer
_PART = 0.1  # of the captures of a single image, whose time is measured


class Remaining:
    """Estimates how long work will take, by the times at which its images were done.

    The first image, or the first capture of a single one, only starts the clock: what is made once is not
    counted. Of many images the later half counts, as the first ones may have been kept, or shared captures.
    """

    def __init__(self) -> None:
        self._now = Progress()
        self._done_s: list[float] = []
        self._first: tuple[int, float] | None = None  # captures, and when they were first reported

    def note(self, now: Progress, seconds: float) -> None:
        """Note the progress ``seconds`` after the start."""
        self._done_s += [seconds] * (now.images - len(self._done_s))
        if self._first is None and now.captures:
            self._first = now.captures, seconds
        self._now = now

    def seconds(self, elapsed: float) -> float | None:
        """Return the seconds that are left, ``elapsed`` seconds after the start; None if nobody knows."""
        now = self._now
        if now.of_images and now.images >= now.of_images:
            return 0.0
        if now.of_images == 1:
            return self._of_captures(elapsed)
        first = max(1, len(self._done_s) // 2)
        count = len(self._done_s) - first
        if count < min(_MANY, max(_FEWEST, now.of_images // 3)):
            return None
        last_s = self._done_s[-1]
        first_s = self._done_s[first - 1]
        if last_s - first_s < _SETTLED * first_s:
            return None
        numbers = range(first - 1, len(self._done_s), 1 + count // _POINTS)
        each_s = linear_regression(numbers, [self._done_s[number] for number in numbers]).slope
        missing = now.of_images - now.images
        return max((missing - 1) * each_s, missing * each_s - (elapsed - last_s))

    def _of_captures(self, elapsed: float) -> float | None:
        """As :meth:`seconds`, of a single image."""
        if self._first is None:
            return None
        first, first_s = self._first
        count = self._now.captures - first
        if count < max(_FEWEST, _PART * self._now.of_captures) or elapsed - first_s < _SETTLED * first_s:
            return None
        return (self._now.of_captures - self._now.captures) * (elapsed - first_s) / count


Steps = Callable[[int, int], None]
"""A callback, called with (steps done, steps in all) of work that has no captures."""


def counted(items: Sequence[T], progress: Steps | None) -> Iterator[T]:
    """Yield items, and report each to ``progress``, unless that is None, when it is done with."""
    for done, item in enumerate(items, start=1):
        yield item
        if progress:
            progress(done, len(items))


PhaseListener = Callable[[str, int, int], None]
"""A callback, called with the name of a phase of long work, its steps done, and its steps in all, 0 if nobody
knows; an empty name ends the last phase."""
_listener: ContextVar[PhaseListener | None] = ContextVar("listener", default=None)
_current: ContextVar[tuple[str, int]] = ContextVar("current", default=("", 0))


@contextmanager
def listening(listener: PhaseListener) -> Iterator[None]:
    """Tell a listener the phases of what is done in the context, by its thread."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def phase(name: str, steps: int = 0) -> Iterator[Callable[[int], None]]:
    """Name a phase of long work, which has no images yet or any more.

    Args:
        name: such as ``searching places``.
        steps: of the phase in all; 0 if nobody knows.

    Yields:
        A function to be called with the number of steps that are done.
    """
    listener = _listener.get()
    if listener is None:
        yield _ignore
        return
    before = _current.set((name, steps))
    listener(name, 0, steps)
    try:
        yield lambda done: listener(name, done, steps)
    finally:
        _current.reset(before)
        outer, of_steps = _current.get()
        listener(outer, 0, of_steps)


def in_phase(name: str, items: Sequence[T]) -> Iterator[T]:
    """Yield the items of a phase, whose steps they are."""
    with phase(name, len(items)) as step:
        yield from counted(items, lambda done, _: step(done))


def _ignore(done: int) -> None:
    """Take the steps of a phase to which nobody listens."""


Report = Callable[[Progress], None]
"""A callback, called repeatedly with the progress since the start."""


class Meter:
    """Sums the progress of parts of a work, which may run in several threads.

    Args:
        of_images: the number of images in all; replaces the parts' sum.
        report: called with the sum after each part's report, by one thread at a time.
    """

    def __init__(self, of_images: int, report: Report | None) -> None:
        self._sum = Progress()
        self._of_images = of_images
        self._report = report
        self._lock = Lock()

    def part(self) -> Report:
        """Return the callback of a part, to be called with that part's progress."""
        last = Progress()

        def report(now: Progress) -> None:
            nonlocal last
            with self._lock:
                self._sum = self._sum + (now - last)
                last = now
                if self._report:
                    self._report(replace(self._sum, of_images=self._of_images))

        return report


def without_images(report: Report) -> Report:
    """Return the callback of a part of which only the captures count: its images are intermediate."""
    return lambda now: report(replace(now, images=0))
