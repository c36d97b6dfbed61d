"""Progress of long work on standard error: a bar on a terminal, lines for a log, or nothing."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal, Self

from typer import Option

from omniscv.cli import signals

if TYPE_CHECKING:
    from omniscv.progress import Progress

Style = Literal["bar", "plain", "none"]
_HELP = "bar, plain (lines for a log) or none; else bar on a terminal."
StyleOption = Annotated[Style | None, Option("--progress", help=_HELP)]
"""The option of every command that runs long."""

_LINES_EVERY_S = 5.0


@dataclass(frozen=True)
class Pace:
    """Progress and time.

    Attributes:
        now: the progress.
        seen: the progress when the last image was done.
        seconds: since the start.
    """

    now: Progress
    seen: Progress
    seconds: float

    def at(self, now: Progress, seconds: float) -> Self:
        """Return the pace at a later time."""
        return replace(
            self, now=now, seconds=seconds, seen=now if now.images != self.now.images else self.seen
        )

    @property
    def fraction(self) -> float:
        """The share of the work that is done, 0 to 1; of images in progress, their captures count."""
        came, needed = self.now.captures - self.seen.captures, self.now.of_captures - self.seen.captures
        part = came / needed if needed > 0 else 0.0
        return min(1.0, (self.now.images + part) / max(1, self.now.of_images))

    @property
    def left_s(self) -> float | None:
        """Estimate of the seconds that are left; None at the start."""
        return self.seconds * (1 / self.fraction - 1) if self.fraction > 0 else None

    def captures(self) -> str:
        """Return ``345/460 captures, 45.2 MB, 22/s, 1.9 MB/s``; empty for work without captures."""
        now, seconds = self.now, max(self.seconds, 1e-3)
        if not now.of_captures:
            return ""
        rates = f"{now.captures / seconds:.3g}/s, {_megabytes(now.nbytes / seconds)}/s"
        return f"{now.captures}/{now.of_captures} captures, {_megabytes(now.nbytes)}, {rates}"

    def line(self, what: str) -> str:
        """Return everything in one line."""
        left = "" if self.left_s is None else f"{_clock(self.left_s)} left"
        done = f"{what} {self.now.images}/{self.now.of_images}"
        return ", ".join(part for part in (done, self.captures(), left) if part)


class Display:
    """Receives progress, and shows nothing; the base of displays.

    Args:
        what: is counted, such as "images".
    """

    def __init__(self, what: str) -> None:
        from omniscv.progress import Progress

        self._what, self._started = what, time.monotonic()
        self._pace = Pace(Progress(), Progress(), 0.0)

    def __call__(self, now: Progress) -> None:
        """Show a :class:`omniscv.progress.Progress`; raise KeyboardInterrupt after a signal."""
        signals.check()
        self._pace = self._pace.at(now, time.monotonic() - self._started)
        self._show(self._pace)

    def steps(self, done: int, total: int) -> None:
        """Show the progress of work that has no captures."""
        from omniscv.progress import Progress

        self(Progress(done, total))

    def _show(self, pace: Pace) -> None:
        pass

    def close(self) -> None:
        """End the display."""


class Lines(Display):
    """A line every few seconds; the first and the last always.

    Args:
        what: is counted.
        every_s: least seconds between lines.
    """

    def __init__(self, what: str, every_s: float = _LINES_EVERY_S) -> None:
        super().__init__(what)
        self._every_s, self._printed_s, self._printed = every_s, -every_s, ""

    def _show(self, pace: Pace) -> None:
        if pace.seconds - self._printed_s >= self._every_s:
            self._print(pace)

    def _print(self, pace: Pace) -> None:
        line = pace.line(self._what)
        if line != self._printed:
            print(line, file=sys.stderr, flush=True)
        self._printed, self._printed_s = line, pace.seconds

    def close(self) -> None:
        if self._printed:
            self._print(self._pace)


class _Bars(Display):
    def __init__(self, what: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        super().__init__(what)
        columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[text]}")
        self._bars = Progress(*columns, console=Console(stderr=True, force_terminal=True), transient=True)
        self._whole = self._bars.add_task(what, total=None, text="")
        self._part = self._bars.add_task("captures", total=None, visible=False, text="")
        self._bars.start()

    def _show(self, pace: Pace) -> None:
        now, seen = pace.now, pace.seen
        left = "" if pace.left_s is None else f"  {_clock(pace.left_s)} left"
        count = f"{now.images}/{now.of_images}{left}"
        self._bars.update(self._whole, completed=pace.fraction, total=1, text=count)
        came, needed = now.captures - seen.captures, now.of_captures - seen.captures
        shown = now.of_captures > 0
        self._bars.update(self._part, completed=came, total=needed, text=pace.captures(), visible=shown)

    def close(self) -> None:
        self._bars.stop()


@contextmanager
def display(what: str, style: Style | None = None) -> Iterator[Display]:
    """Yield a display to be called with each :class:`omniscv.progress.Progress`.

    Args:
        what: is counted, such as "images".
        style: by default a bar if standard error is a terminal, else nothing.
    """
    style = style or ("bar" if sys.stderr and sys.stderr.isatty() else "none")  # None: it is closed
    kinds: dict[Style, type[Display]] = {"bar": _Bars, "plain": Lines, "none": Display}
    with closing(kinds[style](what)) as shown:
        yield shown


def _megabytes(nbytes: float) -> str:
    return f"{nbytes / 1e6:.1f} MB"


def _clock(seconds: float) -> str:
    """``75`` as 1:15."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
