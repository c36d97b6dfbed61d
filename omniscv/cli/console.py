"""What commands print: lines, tables, and a progress bar on a terminal."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from omniscv.cli import signals
from omniscv.texts import one_line, printable


def line(text: object) -> None:
    """Print text in one line on standard output, what is not printable in it as escapes."""
    print(printable(text), flush=True)


def document(text: str) -> None:
    """Print text of several lines on standard output, each as :func:`line` does."""
    for each in text.splitlines():
        line(each)


def error(text: object) -> None:
    """Print text on standard error, after the name of the program: one line of at most 300 characters."""
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


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[float, int], None]]:
    """A function to call with (done, total); it draws a bar on standard error if that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console, disable = Console(stderr=True), not sys.stderr.isatty()
    with Progress(*columns, console=console, transient=True, disable=disable) as bar:
        task = bar.add_task(what, total=None)

        def update(done: float, total: int) -> None:
            signals.check()
            bar.update(task, completed=done, total=total)

        yield update
