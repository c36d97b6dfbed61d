"""``omniscv chart``: measure speed against accuracy, and draw it."""

from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, BadParameter, Option, Typer

from omniscv.cli import console
from omniscv.cli.console import StyleOption, display

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv chart central --width 128 --out charts")
def chart(
    kind: Annotated[
        Literal["accuracy", "central", "failures", "stability", "sensor"], Argument(help="What is drawn.")
    ],
    out: Annotated[Path, Option(help="Folder for the JSON and the pictures.")] = Path("charts"),
    width: Annotated[int | None, Option(min=16, help="Of the (largest) images, px.")] = None,
    quick: Annotated[bool, Option("--quick", help="Tiny images: shows that it works.")] = False,
    progress: StyleOption = None,
) -> None:
    """Draw cost against error; what makes images fail; models at their limits; noise of sensors."""
    module = import_module(f"omniscv.chart.{kind}")
    options: dict[str, Any] = dict(module.QUICK) if quick else {}
    if width is not None:
        if "width" not in signature(module.measure).parameters:
            raise BadParameter(f"expected none: images of {kind} have one size", param_hint="--width")
        options["width"] = width
    with display("rounds", progress) as shown:
        rows = module.measure(**options, progress=shown.steps)
    for path in module.write(rows, out):
        console.line(path)
