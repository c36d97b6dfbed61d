"""``omniscv render``: compose images."""

from pathlib import Path

from typer import Option, Typer

from omniscv.cli import console
from omniscv.cli.options import JobOptions
from omniscv.cli.progress import STYLE, Style, display

app = Typer(add_completion=False)


class RenderOptions(JobOptions):
    """What to render, and where to write it."""

    beside_job = JobOptions.beside_job | {"progress"}
    out: Path = Option(Path("out"), help="Folder for the images.")
    stem: str | None = Option(None, help="Start of the file names; else the camera's name.")
    record: Path | None = Option(None, help="A recording to take captures from, and to add new ones to.")
    image_format: str = Option("png", help="png, jxl or jpg, for lit.")
    progress: Style | None = STYLE


@app.command(
    epilog="Example: omniscv render --source mock://four-wall --camera fisheye-equidistant "
    "--size 1024x1024 --fov 185 --position 0,0,1.5 --modes lit,depth --out out/"
)
@RenderOptions.command
def render(given: RenderOptions) -> None:
    """Compose images and their ground truth."""
    from omniscv.jobs import run

    job = given.to_job(given.stem, out=given.out, record=given.record, image_format=given.image_format)
    with display("images", given.progress) as shown:
        files = run(job, shown, warn=console.error)
    for path in files:
        console.line(path)
