"""Output of commands: lines, tables, JSON, and errors; and the progress of long work, on standard error."""

from __future__ import annotations

import atexit
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from threading import Event, Lock, Thread
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Option

from omniscv.errors import one_line, printable

STOPPED = 128 + signal.SIGINT
"""The exit code of a stopped command if its signal is not known."""

_ONE_STOP_S = 1.0
"""Signals within this time count as one: terminals and ``timeout`` send several."""

_received: list[int] = []


def check() -> None:
    """Raise KeyboardInterrupt after a signal: one raised within an import or callback may be lost."""
    if _received:
        raise KeyboardInterrupt


def _unraisable(lost: Any) -> None:
    """Print an unraisable error, except a stop raised in ``__del__``, which :func:`check` raises again."""
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)


def unwound(command: Callable[[], int]) -> int:  # noqa: PLR0915 - one list of faults, each with its code
    """Run a command and return its exit code: 128 + the signal's number if a signal stopped it.

    Each signal raises KeyboardInterrupt in the main thread. An inherited SIG_IGN of SIGINT, as in background
    jobs of a shell, is overridden; that of SIGHUP, as under ``nohup``, is kept.
    """
    _received.clear()
    latest = -_ONE_STOP_S

    def stop(number: int, frame: FrameType | None) -> None:
        """Stop the command at the signal ``number``, in whatever ``frame``."""
        nonlocal latest
        if time.monotonic() - latest > _ONE_STOP_S:
            latest = time.monotonic()
            _received.append(number)
            raise KeyboardInterrupt

    def end(number: int, frame: FrameType | None) -> None:
        """End the process with the code of the first signal, else of ``number``, in whatever ``frame``."""
        os._exit(128 + (_received[0] if _received else number))

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    for number in numbers:
        signal.signal(number, stop)
        atexit.register(signal.signal, number, signal.SIG_IGN)  # the shutdown restores the default: it kills
    sys.unraisablehook = _unraisable
    try:
        code = command()
    except KeyboardInterrupt:
        code = STOPPED
    except Exception:
        if not _received:
            raise
        code = STOPPED  # an interrupted import may raise anything
    finally:
        for number in numbers:
            signal.signal(number, end)  # a second signal ends the process at once
    return 128 + _received[0] if code == STOPPED and _received else code


if TYPE_CHECKING:
    from omniscv.progress import Progress

Style = Literal["bar", "plain", "none"]
_HELP = "bar, plain (lines for a log) or none; else bar on a terminal, and a line now and then elsewhere."
StyleOption = Annotated[Style | None, Option("--progress", help=_HELP)]
"""The option of every command that runs long."""
_LINES_EVERY_S = 5.0  # from line to line of ``--progress plain``
_LINES_ELSEWHERE_S = 60.0  # the same without a terminal and a style, once as much time has passed
FIRST_LINE_S = 2.0
"""Seconds until the first line without a terminal and a style; the next ones come after longer times."""


_LOOKS_EVERY_S = 0.5  # from look to look whether a line is due


def line(text: object) -> None:
    """Print a text in one line on standard output, with escapes for unprintable characters."""
    print(printable(text), flush=True)


def document(text: str) -> None:
    """Print a text of several lines on standard output, each as :func:`line` does."""
    for part in text.splitlines():
        line(part)


def as_json(value: object) -> None:
    """Print plain values as JSON on standard output."""
    document(json.dumps(value, indent=2))


def summary(values: Mapping[str, object]) -> None:
    """Print a table of keys and values; those that are no texts as JSON."""
    rows = []
    for key, value in values.items():
        text = value if isinstance(value, str) else json.dumps(value)
        rows.append((key.replace("_", " "), text))
    table(("", ""), rows)


def error(text: object) -> None:
    """Print an error on standard error, in one line."""
    print(one_line(f"omniscv: {text}"), file=sys.stderr, flush=True)


def table(
    columns: Sequence[str], rows: Iterable[Sequence[object]], styles: Mapping[str, str] | None = None
) -> None:
    """Print a table.

    Args:
        columns: their headings; none are printed if all are empty.
        rows: of cells, as many as columns.
        styles: of rich, by the text of a cell.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    drawn = Table(*columns, box=None, show_header=any(columns), header_style="bold", padding=(0, 2, 0, 0))
    drawn.columns[0].no_wrap = True  # names are not shortened on narrow terminals
    if styles is None:
        styles = {}
    for row in rows:
        drawn.add_row(*[Text(printable(cell), styles.get(str(cell), "")) for cell in row])
    Console(highlight=False, soft_wrap=True).print(drawn)


class Display:
    """Receives progress, and shows it as a bar, as a line every few seconds, or not at all.

    Args:
        what: is counted, such as "images".
        style: of the display.
        every_s: least seconds between lines.
        from_s: seconds before the first line, and after it between lines, which are twice as many each time,
            up to ``every_s``; the last line is printed if another one was. None: the first line at once.

    Attributes:
        note: is shown behind the counts; may be set at any time.
    """

    def __init__(
        self, what: str, style: Style = "none", every_s: float = _LINES_EVERY_S, from_s: float | None = None
    ) -> None:
        from omniscv.progress import Progress, Remaining

        self.note = ""
        self._remaining = Remaining()
        self._what = what
        self._started = time.monotonic()
        self._seconds = 0.0
        self._now = self._last_image = Progress()  # now, and when the last image was done
        self._style = style
        self._every_s = every_s
        self._due_s = from_s or 0.0
        self._wait_s = every_s if from_s is None else from_s
        self._printed = ""
        self._phase = ""
        self._printing = Lock()
        self._ended = Event()
        if style == "plain":
            Thread(target=self._watch, daemon=True).start()
        if style == "bar":
            from rich import progress
            from rich.console import Console

            columns = (progress.BarColumn(), progress.TextColumn("{task.description}"))
            terminal = Console(stderr=True, force_terminal=True)
            self._bar = progress.Progress(*columns, console=terminal, transient=True)
            self._task = self._bar.add_task(what, total=1)
            self._bar.start()

    def __call__(self, now: Progress) -> None:
        """Show a :class:`omniscv.progress.Progress`; raise KeyboardInterrupt after a signal."""
        check()
        self._seconds = time.monotonic() - self._started
        if now.images != self._now.images:
            self._last_image = now
        self._now = now
        self._remaining.note(now, self._seconds)
        if self._style == "bar":
            self._bar.update(self._task, completed=self.fraction, description=self.line())
        elif self._style == "plain":
            self._print_due(self._seconds)

    def phase(self, name: str, done: int, steps: int) -> None:
        """Show a phase of the work before and after images, see :func:`omniscv.progress.phase`."""
        check()
        self._phase = f"{name} {done}/{steps}" if name and steps else name
        if self._style == "bar":
            self._bar.update(self._task, completed=self.fraction, description=self.line())

    def _watch(self) -> None:
        """Print lines that are due while nothing is reported."""
        started = time.perf_counter()
        while not self._ended.wait(_LOOKS_EVERY_S):
            self._print_due(time.perf_counter() - started)

    def steps(self, done: int, total: int) -> None:
        """Show the progress of work that has no captures: ``done`` steps of ``total``."""
        from omniscv.progress import Progress

        self(Progress(done, total))

    @property
    def seconds(self) -> float:
        """Seconds since it was made."""
        return time.monotonic() - self._started

    def close(self) -> None:
        """End the display."""
        self._ended.set()
        if self._style == "bar":
            self._bar.stop()
        elif self._printed and self._now.of_images:
            self._phase = ""
            with self._printing:
                self._print()

    def _print_due(self, seconds: float) -> None:
        """Print the line if it is due ``seconds`` after the start."""
        with self._printing:
            is_known = self._phase or self._now.of_images
            if is_known and seconds >= self._due_s and not self._ended.is_set():
                self._print()
                self._due_s = seconds + self._wait_s
                self._wait_s = min(2 * self._wait_s, self._every_s)

    def _print(self) -> None:
        """Print the line, unless it is the last one that was printed."""
        line = self.line()
        if line != self._printed:
            print(line, file=sys.stderr, flush=True)
        self._printed = line

    @property
    def fraction(self) -> float:
        """The share of the work that is done, 0 to 1; of images in progress, their captures count."""
        part = self._now - self._last_image
        in_progress = part.captures / part.of_captures if part.of_captures > 0 else 0.0
        return min(1.0, (self._now.images + in_progress) / max(1, self._now.of_images))

    def line(self) -> str:
        """Return ``images 3/12, 345/460 captures, 45.2 MB, 22/s, 1.9 MB/s, 0:41 left``, as far as known."""
        now = self._now
        if self._phase:
            return self._phase
        seconds = max(self._seconds, 1e-3)
        parts = [f"{self._what} {now.images}/{now.of_images}"]
        if self.note:
            parts.append(self.note)
        if now.of_captures:
            rates = f"{now.captures / seconds:.3g}/s, {_megabytes(now.nbytes / seconds)}/s"
            parts.append(f"{now.captures}/{now.of_captures} captures, {_megabytes(now.nbytes)}, {rates}")
        left_s = self._remaining.seconds(self._seconds)
        if left_s is not None:
            parts.append(f"{_clock(round(left_s))} left")
        return ", ".join(parts)


def _clock(seconds: int) -> str:
    """Return seconds as ``0:41``, or ``1:02:03`` from an hour on."""
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


@contextmanager
def display(what: str, style: Style | None = None) -> Iterator[Display]:
    """Yield a display to be called with each :class:`omniscv.progress.Progress`.

    Args:
        what: is counted, such as "images".
        style: by default a bar if standard error is a terminal, else lines from the second second on.
    """
    if style is not None:
        shown = Display(what, style, _LINES_EVERY_S)
    elif not sys.stderr:
        shown = Display(what, "none")
    elif sys.stderr.isatty():
        shown = Display(what, "bar")
    else:
        shown = Display(what, "plain", _LINES_ELSEWHERE_S, from_s=FIRST_LINE_S)
    from omniscv.progress import listening

    with closing(shown), listening(shown.phase):
        yield shown


def _megabytes(nbytes: float) -> str:
    """Return bytes as text."""
    return f"{nbytes / 1e6:.1f} MB"
