"""``omniscv record``: capture into a recording."""

from dataclasses import replace
from pathlib import Path

from typer import Argument, Option, Typer

from omniscv.cli import console, options
from omniscv.cli.progress import STYLE, Style, display

app = Typer(add_completion=False)


class RecordOptions(options.ConnectionOptions):
    """What to capture, from where, into which file."""

    beside_job = options.ConnectionOptions.beside_job | {
        "source",
        "launch",
        "fix_exposure",
        "overscan",
        "out",
        "progress",
    }
    job: Path | None = Argument(None, metavar="JOB.yaml", help="A job, in place of positions, size, modes.")
    source: list[str] = Option([], help="As for render; repeatable: replicas of a game share the captures.")
    launch: list[Path] = Option([], help="A packaged game to start, and to stop at the end; repeatable.")
    position: list[str] = Option(["0,0,1.5"], help="X,Y,Z in metres; repeatable.")
    face_size: str = Option("1024", help="px of a 90 degree face, or auto.")
    modes: str = Option("lit,object_mask,depth", help="As for render.")
    fix_exposure: bool = Option(False, "--fix-exposure", help="Switch off vignette and auto exposure.")
    overscan: int | None = Option(None, min=0, max=8192, help="px beyond each side, cropped later.")
    out: Path | None = Option(None, help="The recording; else the job's, or capture.sqlite.")
    progress: Style | None = STYLE


@app.command(
    epilog="Example: omniscv record --source mock://four-wall --position 0,0,1.5 --position 1,0,1.5 "
    "--face-size 256 --modes lit,mask,depth --out room.sqlite"
)
@RecordOptions.command
def record(given: RecordOptions) -> None:
    """Capture cube maps at positions, or all that a job needs, into a recording; rerun to resume."""
    from omniscv.cameras import create
    from omniscv.geometry import Pose
    from omniscv.jobs import Job, capture, load
    from omniscv.planning import RenderOptions
    from omniscv.sources.recording.replacing import place_of

    edge = options.edge(given.face_size)
    size = f"?size={edge}x{edge}" if isinstance(edge, int) else ""  # of a game that cannot set another
    sources = (*given.source, *(f"launch:{path}{size}" for path in given.launch))
    if given.job is not None:
        job = load(given.job)
    else:
        width = 2048 if edge == "auto" else 2 * edge
        job = Job(
            source="mock://four-wall",
            cameras={"cube": create("equirectangular", width=width, height=width // 2)},
            poses=tuple(Pose.from_angles(options.numbers("--position", text)) for text in given.position),
            out=Path(),
            modes=options.modes(given.modes),
            options=RenderOptions("cube", face_size=edge),
        )
    job = replace(
        job, source=sources or job.source, source_options={**job.source_options, **given.source_options()}
    )
    if given.fix_exposure:
        job = replace(job, source_options={**job.source_options, "fix_exposure": True})
    path = given.out or job.record or Path("capture.sqlite")
    place_of(path)  # refuses what is no file, before a game is launched
    with display("images", given.progress) as shown:
        count = capture(job, path, shown, border_px=given.overscan)
    console.line(f"{path}: {count} captures")
