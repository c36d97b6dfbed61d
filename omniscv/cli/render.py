"""``omniscv render``: compose images."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from typer import Option, Typer

from omniscv.cli import console
from omniscv.cli.job_options import ImageOptions
from omniscv.cli.progress import STYLE, Style, display
from omniscv.errors import ArgumentError

if TYPE_CHECKING:
    from omniscv.job import Job

app = Typer(add_completion=False)


class RenderOptions(ImageOptions):
    """What to render, and the names of the files."""

    stem: str | None = Option(None, help="Start of the file names; else the camera's name.")
    progress: Style | None = STYLE

    def to_job(self) -> Job:
        job = super().to_job()
        if self.stem is None:
            return job
        if job.rig is not None or len(job.cameras) != 1:
            raise ArgumentError(f"--stem: expected a job with one camera, got {len(job.cameras)}")
        (camera,) = job.cameras.values()
        return replace(job, cameras={self.stem: camera})


@app.command(
    epilog="Example: omniscv render --source mock://four-wall --camera fisheye-equidistant "
    "--size 1024x1024 --fov 185 --position 0,0,1.5 --modes lit,depth --out out/\n\n"
    "Example: omniscv render job.yaml --modes lit --face-size 512 --out draft/"
)
@RenderOptions.command
def render(given: RenderOptions) -> None:
    """Compose images and their ground truth."""
    from omniscv.make import run

    job = given.to_job()
    with display("images", given.progress) as shown:
        files = run(job, shown, warn=console.error)
    for path in files:
        console.line(path)
