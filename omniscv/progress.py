"""Progress of long work as data: images, and the captures that they are composed of."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from operator import add, sub
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


Steps = Callable[[int, int], None]
"""A callback, called with (steps done, steps in all) of work that has no captures."""


def counted(items: Sequence[T], progress: Steps | None) -> Iterator[T]:
    """Yield items, and report each to ``progress``, unless that is None, when it is done with."""
    for done, item in enumerate(items, start=1):
        yield item
        if progress:
            progress(done, len(items))


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
