"""``omniscv record``: capture into a recording."""

from pathlib import Path
from typing import ClassVar

from typer import Option, Typer

from omniscv.cli import console, options
from omniscv.cli.job_options import CaptureOptions, Keys
from omniscv.cli.progress import STYLE, Style, display

app = Typer(add_completion=False)


class RecordOptions(CaptureOptions):
    """What to capture, from where, into which file: without a job, cube maps at positions."""

    keys_of: ClassVar = {
        **CaptureOptions.keys_of,
        "source": lambda addresses: {"source": addresses},
        "launch": lambda paths: {"source": [f"launch:{path}" for path in paths]},
        "position": lambda texts: {"poses": [{"position": options.numbers("--position", t)} for t in texts]},
        "fix_exposure": lambda fix: {"source_options.fix_exposure": True} if fix else {},
        "out": lambda path: {"record": str(path)},
    }

    source: list[str] = Option([], help="As for render; repeatable: replicas of a game share the captures.")
    launch: list[Path] = Option([], help="A packaged game to start, and to stop at the end; repeatable.")
    position: list[str] = Option(["0,0,1.5"], help="X,Y,Z in metres; repeatable.")
    fix_exposure: bool = Option(False, "--fix-exposure", help="Switch off vignette and auto exposure.")
    overscan: int | None = Option(None, min=0, max=8192, help="px beyond each side, cropped later.")
    out: Path | None = Option(None, help="The recording; else the job's, or capture.sqlite.")
    face_size: str = Option("1024", help="px of a 90 degree face, or auto.")
    modes: str = Option("lit,object_mask,depth", help="As for render.")
    strategy: str = Option("cube", help="As for render.")
    progress: Style | None = STYLE

    def keys(self, names: list[str]) -> Keys:
        edge = options.edge(self.face_size)
        size = f"?size={edge}x{edge}" if isinstance(edge, int) else ""  # of a game that cannot set another
        addresses = [*self.source, *(f"launch:{path}{size}" for path in self.launch)]
        return {**super().keys(names), **({"source": addresses} if addresses else {})}  # of both options

    def described(self) -> Keys:
        edge = options.edge(self.face_size)
        width = 2048 if edge == "auto" else 2 * edge
        cube = {"model": "equirectangular", "width": width, "height": width // 2}
        return {"source": "mock://four-wall", "cameras": {"cube": cube}}


@app.command(
    epilog="Example: omniscv record --source mock://four-wall --position 0,0,1.5 --position 1,0,1.5 "
    "--face-size 256 --modes lit,mask,depth --out room.sqlite"
)
@RecordOptions.command
def record(given: RecordOptions) -> None:
    """Capture cube maps at positions, or all that a job needs, into a recording; rerun to resume."""
    from omniscv.make import capture
    from omniscv.sources.recording.publishing import target_of

    job = given.to_job()
    path = job.record or Path("capture.sqlite")
    target_of(path)  # refuses what is no file, before a game is launched
    with display("images", given.progress) as shown:
        count = capture(job, path, shown, border_px=given.overscan)
    console.line(f"{path}: {count} captures")
