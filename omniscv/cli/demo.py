"""``omniscv demo``: everything once, without Unreal."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Typer

from omniscv.cli import console

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv demo out/")
def demo(
    out: Annotated[Path, Argument(help="Folder for images, recordings, contact sheets.")] = Path("out/demo"),
) -> None:
    """Record scenes from the mock server over TCP, compose every camera, and compare with the replay."""
    from omniscv.demo import run_demo

    with console.progress_bar("demo") as progress:
        report = run_demo(out, progress)
    for line in report.lines():
        console.line(line)
