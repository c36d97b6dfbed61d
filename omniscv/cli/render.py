"""``omniscv render``: compose images."""

from dataclasses import replace
from typing import Annotated

from typer import Option, Typer

from omniscv.cli import console
from omniscv.cli.console import StyleOption, display
from omniscv.cli.old_spellings import OF_JOBS, accepting
from omniscv.cli.options import IMAGES, JobArguments, with_job
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)


@app.command(
    cls=accepting(OF_JOBS),
    no_args_is_help=True,
    epilog="Example: omniscv render --source mock://four-wall --camera fisheye-equidistant "
    "--size 1024x1024 --set camera.fov_deg=185 --position 0,0,1.5 --modes lit,depth --out out/\n\n"
    "Example: omniscv render job.yaml --modes lit --set face_size=512 --out draft/",
)
@with_job(IMAGES)
def render(
    job: JobArguments,
    stem: Annotated[str | None, Option(help="Start of the file names; else the camera's name.")] = None,
    progress: StyleOption = None,
) -> None:
    """Compose images and their ground truth."""
    from omniscv.make import run

    loaded = job.load()
    if stem is not None:
        if loaded.rig is not None or len(loaded.cameras) != 1:
            raise ArgumentError(f"--stem: expected a job with one camera, got {len(loaded.cameras)}")
        loaded = replace(loaded, cameras=dict(zip([stem], loaded.cameras.values(), strict=True)))
    with display("images", progress) as show:
        files = run(loaded, show, warn=console.error)
    for path in dict.fromkeys(files):  # objects.json is one file for all images
        console.line(path)
