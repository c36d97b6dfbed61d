"""``omniscv evaluate``: repeat an evaluation of the paper, and print it beside the paper's figures."""

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option, Typer

from omniscv.cli import console
from omniscv.cli.console import StyleOption, display

app = Typer(add_completion=False)

_Name = Literal["layout", "calibration", "lines", "odometry"]


@app.command(epilog="Example: omniscv evaluate lines --quick --out evaluations")
def evaluate(
    name: Annotated[_Name, Argument(help="What is evaluated.")],
    out: Annotated[Path, Option(help="Folder for NAME.json, NAME.csv and the chart.")] = Path("evaluations"),
    quick: Annotated[bool, Option("--quick", help="Few small images: within a minute.")] = False,
    source: Annotated[str | None, Option(help="A source in place of the mock's scenes.")] = None,
    predictions: Annotated[
        Path | None, Option(help="layout: a folder of predictions, CFL maps or HorizonNet's txt or json.")
    ] = None,
    trajectory: Annotated[
        Path | None, Option(help="odometry: a file of poses, TUM, KITTI or EuRoC, in place of the loop.")
    ] = None,
    progress: StyleOption = None,
) -> None:
    """Run an algorithm on images with known truth, and score it."""
    from omniscv.evaluate.registry import Settings, run

    out.mkdir(parents=True, exist_ok=True)
    files = {"predictions": predictions, "trajectory": trajectory}
    options = {key: path for key, path in files.items() if path is not None}
    with display(name, progress) as shown:
        report = run(name, Settings(out, quick, source, options, shown.steps))
    rows = [
        (row.name, f"{row.value:.4g} {row.unit}", "" if row.paper is None else f"{row.paper:g}", row.n)
        for row in report.figures
    ]
    console.table((name, "ours", "paper", "n"), rows)
    for path in report.write(name, out):
        console.line(path)
