"""``omniscv demo``: the whole pipeline once, without Unreal."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Typer

from omniscv.cli import console
from omniscv.cli.console import StyleOption, display

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv demo out/")
def demo(
    out: Annotated[Path, Argument(help="Folder for images, recordings, contact sheets.")] = Path("out/demo"),
    progress: StyleOption = None,
) -> None:
    """Record scenes from the mock server over TCP, compose every camera, and compare with the replay."""
    from omniscv.demo import run_demo

    with display("images", progress) as shown:
        report = run_demo(out, shown)
    for line in report.lines():
        console.line(line)
