"""``omniscv chart``: measure speed against accuracy, and draw it."""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option, Typer

from omniscv.cli import console

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv chart central --width 128 --out charts")
def chart(
    kind: Annotated[Literal["central", "noncentral"], Argument(help="Of cameras.")],
    out: Annotated[Path, Option(help="Folder for the JSON and the picture.")] = Path("charts"),
    width: Annotated[int | None, Option(min=16, help="Of the images, px; else 512 or 384.")] = None,
) -> None:
    """Compare filters and face sizes, or strategies, with exact tracing. Takes minutes."""
    module = import_module(f"omniscv.chart.{kind}")
    given = {} if width is None else {"width": width}
    with console.progress_bar("measuring") as progress:
        rows = module.measure(**given, progress=progress)
    for path in module.write(rows, out):
        console.line(path)
