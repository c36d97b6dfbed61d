"""How far a long work has come, as data: images, and the captures that they are composed of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Lock
from typing import Self


@dataclass(frozen=True)
class Progress:
    """What is done of a work; the sum of its parts' progress is its own.

    Attributes:
        images: that are done.
        of_images: in all.
        captures: that came, for these images and those under way; one that several use counts for each.
        of_captures: known to be needed so far: strategies that look at what came ask for more.
        nbytes: of the captures, as they were received, or of their pixels where nothing was encoded.
    """

    images: int = 0
    of_images: int = 0
    captures: int = 0
    of_captures: int = 0
    nbytes: int = 0

    def __add__(self, other: Self) -> Self:
        return type(self)(*(a + b for a, b in zip(_values(self), _values(other), strict=True)))

    def __sub__(self, other: Self) -> Self:
        return type(self)(*(a - b for a, b in zip(_values(self), _values(other), strict=True)))


def _values(each: Progress) -> tuple[int, ...]:
    return each.images, each.of_images, each.captures, each.of_captures, each.nbytes


Report = Callable[[Progress], None]
"""What is called, again and again, with how far a work has come since its start."""


class Meter:
    """Sums the progress of a work's parts, which may run in threads of their own.

    Args:
        of_images: the number of images in all, whatever the parts say.
        report: called with the sum after each part's report, by one thread at a time.
    """

    def __init__(self, of_images: int, report: Report | None) -> None:
        self._sum, self._of_images, self._report, self._lock = Progress(), of_images, report, Lock()

    def part(self) -> Report:
        """Return what a part is to call with its own progress."""
        last = Progress()

        def report(now: Progress) -> None:
            nonlocal last
            with self._lock:
                self._sum, last = self._sum + (now - last), now
                if self._report:
                    self._report(replace(self._sum, of_images=self._of_images))

        return report


def without_images(report: Report) -> Report:
    """Return a report of a part whose captures count, and whose images do not: others are made of them."""
    return lambda now: report(replace(now, images=0))
