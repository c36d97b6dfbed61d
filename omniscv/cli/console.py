"""Output of commands: lines, tables, JSON, and errors."""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence

from omniscv.errors import one_line, printable


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
