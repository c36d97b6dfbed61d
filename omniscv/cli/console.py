"""What commands print: lines and tables."""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence

from omniscv.errors import one_line, printable


def line(text: object) -> None:
    """Print text in one line on standard output, what is not printable in it as escapes."""
    print(printable(text), flush=True)


def document(text: str) -> None:
    """Print text of several lines on standard output, each as :func:`line` does."""
    for each in text.splitlines():
        line(each)


def as_json(value: object) -> None:
    """Print plain values as JSON on standard output."""
    document(json.dumps(value, indent=2))


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
