"""Output of commands: lines, tables, JSON, and errors; and the progress of long work, on standard error."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Option

from omniscv.cli import signals
from omniscv.errors import one_line, printable

if TYPE_CHECKING:
    from omniscv.progress import Progress

Style = Literal["bar", "plain", "none"]
_HELP = "bar, plain (lines for a log) or none; else bar on a terminal."
StyleOption = Annotated[Style | None, Option("--progress", help=_HELP)]
"""The option of every command that runs long."""
_LINES_EVERY_S = 5.0


def line(text: object) -> None:
    """Print a text in one line on standard output, with escapes for unprintable characters."""
    print(printable(text), flush=True)


def document(text: str) -> None:
    """Print a text of several lines on standard output, each as :func:`line` does."""
    for one in text.splitlines():
        line(one)


def as_json(value: object) -> None:
    """Print plain values as JSON on standard output."""
    document(json.dumps(value, indent=2))


def summary(values: Mapping[str, object]) -> None:
    """Print a table of keys and values; those that are no texts as JSON."""
    texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in values.items()}
    table(("", ""), [(key.replace("_", " "), text) for key, text in texts.items()])


def error(text: object) -> None:
    """Print an error on standard error, in one line."""
    print(one_line(f"omniscv: {text}"), file=sys.stderr, flush=True)


def table(
    columns: Sequence[str], rows: Iterable[Sequence[object]], styles: Mapping[str, str] | None = None
) -> None:
    """Print a table, without headings if all are empty; ``styles`` maps cells to styles of rich."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    drawn = Table(*columns, box=None, show_header=any(columns), header_style="bold", padding=(0, 2, 0, 0))
    for row in rows:
        drawn.add_row(*(Text(printable(cell), (styles or {}).get(str(cell), "")) for cell in row))
    Console(highlight=False, soft_wrap=True).print(drawn)


class Display:
    """Receives progress, and shows nothing; the base of displays.

    Args:
        what: is counted, such as "images".
    """

    def __init__(self, what: str) -> None:
        from omniscv.progress import Progress

        self._what, self._started, self._seconds = what, time.monotonic(), 0.0
        self._now = self._last_image = Progress()  # now, and when the last image was done

    def __call__(self, now: Progress) -> None:
        """Show a :class:`omniscv.progress.Progress`; raise KeyboardInterrupt after a signal."""
        signals.check()
        self._seconds = time.monotonic() - self._started
        if now.images != self._now.images:
            self._last_image = now
        self._now = now
        self._show()

    def steps(self, done: int, total: int) -> None:
        """Show the progress of work that has no captures."""
        from omniscv.progress import Progress

        self(Progress(done, total))

    def _show(self) -> None:
        pass

    def close(self) -> None:
        """End the display."""

    @property
    def fraction(self) -> float:
        """The share of the work that is done, 0 to 1; of images in progress, their captures count."""
        part = self._now - self._last_image
        in_progress = part.captures / part.of_captures if part.of_captures > 0 else 0.0
        return min(1.0, (self._now.images + in_progress) / max(1, self._now.of_images))

    def line(self) -> str:
        """Return ``images 3/12, 345/460 captures, 45.2 MB, 22/s, 1.9 MB/s, 0:41 left``, as far as known."""
        now, seconds = self._now, max(self._seconds, 1e-3)
        parts = [f"{self._what} {now.images}/{now.of_images}"]
        if now.of_captures:
            rates = f"{now.captures / seconds:.3g}/s, {_megabytes(now.nbytes / seconds)}/s"
            parts.append(f"{now.captures}/{now.of_captures} captures, {_megabytes(now.nbytes)}, {rates}")
        if self.fraction > 0:
            parts.append(f"{_clock(self._seconds * (1 / self.fraction - 1))} left")
        return ", ".join(parts)


class Lines(Display):
    """A line every few seconds; the first and the last always.

    Args:
        what: is counted.
        every_s: least seconds between lines.
    """

    def __init__(self, what: str, every_s: float = _LINES_EVERY_S) -> None:
        super().__init__(what)
        self._every_s, self._printed_s, self._printed = every_s, -every_s, ""

    def _show(self) -> None:
        if self._seconds - self._printed_s >= self._every_s:
            self._print()

    def _print(self) -> None:
        line = self.line()
        if line != self._printed:
            print(line, file=sys.stderr, flush=True)
        self._printed, self._printed_s = line, self._seconds

    def close(self) -> None:
        if self._printed:
            self._print()


class _Bar(Display):
    def __init__(self, what: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        super().__init__(what)
        columns = BarColumn(), TextColumn("{task.description}")
        self._bar = Progress(*columns, console=Console(stderr=True, force_terminal=True), transient=True)
        self._task = self._bar.add_task(what, total=1)
        self._bar.start()

    def _show(self) -> None:
        self._bar.update(self._task, completed=self.fraction, description=self.line())

    def close(self) -> None:
        self._bar.stop()


@contextmanager
def display(what: str, style: Style | None = None) -> Iterator[Display]:
    """Yield a display to be called with each :class:`omniscv.progress.Progress`.

    Args:
        what: is counted, such as "images".
        style: by default a bar if standard error is a terminal, else nothing.
    """
    style = style or ("bar" if sys.stderr and sys.stderr.isatty() else "none")  # None: it is closed
    displays: dict[Style, type[Display]] = {"bar": _Bar, "plain": Lines, "none": Display}
    with closing(displays[style](what)) as shown:
        yield shown


def _megabytes(nbytes: float) -> str:
    return f"{nbytes / 1e6:.1f} MB"


def _clock(seconds: float) -> str:
    """``75`` as 1:15."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
