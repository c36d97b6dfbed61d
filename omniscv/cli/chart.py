"""Commands that measure speed against accuracy and draw it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from omniscv.cli.progress import out as console
from omniscv.cli.progress import progress_bar

Row = TypeVar("Row")

Out = Annotated[Path, typer.Option("--out", help="Folder for the JSON and the picture.")]


def add_to(app: typer.Typer) -> None:
    """Adds the commands."""
    charts = typer.Typer(help="Measure speed against accuracy, and draw it.", no_args_is_help=True)
    charts.command(epilog="Example: omniscv chart central --out docs")(central)
    charts.command(epilog="Example: omniscv chart noncentral --out docs")(noncentral)
    app.add_typer(charts, name="chart")


def central(
    out: Out = Path("charts"),
    width: Annotated[int, typer.Option(min=16, help="Width of the images, px.")] = 512,
) -> None:
    """Filters x face sizes x central models, against exact tracing. Takes a minute or two."""
    from omniscv.chart.central import measure, write

    _chart(measure, write, width, out)


def noncentral(
    out: Out = Path("charts"),
    width: Annotated[int, typer.Option(min=16, help="Width of the panorama, px.")] = 384,
) -> None:
    """Strategies x optical centres of the non-central models, against exact tracing. Takes minutes."""
    from omniscv.chart.noncentral import measure, write

    _chart(measure, write, width, out)


def _chart(
    measure: Callable[[int, Callable[[int, int], None]], list[Row]],
    write: Callable[[list[Row], Path], list[Path]],
    width: int,
    out: Path,
) -> None:
    with progress_bar("measuring") as progress:
        rows = measure(width, progress)
    for path in write(rows, out):
        console.print(path, markup=False)
