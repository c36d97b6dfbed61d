"""``omniscv chart``: measure speed against accuracy, and draw it."""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option, Typer

from omniscv.cli import console
from omniscv.cli.progress import StyleOption, display

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv chart central --width 128 --out charts")
def chart(
    kind: Annotated[Literal["central", "noncentral"], Argument(help="Of cameras.")],
    out: Annotated[Path, Option(help="Folder for the JSON and the pictures.")] = Path("charts"),
    width: Annotated[int | None, Option(min=16, help="Of the images, px; else 2048 or 384.")] = None,
    page: Annotated[bool, Option("--page", help="Also write all tables as an HTML page.")] = False,
    progress: StyleOption = None,
) -> None:
    """Compare filters and face sizes with other programs, or strategies, by exact tracing. Takes minutes."""
    module = import_module(f"omniscv.chart.{kind}")
    given: dict[str, Any] = {} if width is None else {"width": width}
    with display("rounds", progress) as shown:
        rows = module.measure(**given, progress=shown.steps)
        tables = {module.TITLE: rows, **(module.further(shown.steps, **given) if page else {})}
    written = module.write(rows, out)
    if page:
        from omniscv.chart.page import write

        pictures = [path for path in written if path.suffix == ".svg"]
        written.append(write(module.TITLE, tables, pictures, out / f"chart-{kind}.html"))
    for path in written:
        console.line(path)
