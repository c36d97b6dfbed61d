"""``omniscv record``: capture into a recording."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from typer import Option, Typer

from omniscv.cli import console, options
from omniscv.cli.console import StyleOption, display
from omniscv.cli.old_spellings import OF_JOBS, accepting
from omniscv.cli.options import MODES, SET, SOURCE_HELP, JobArguments, JobOption, Keys, key, with_job

app = Typer(add_completion=False)

_OVERSCAN_HELP = "Additional px on each side of a capture. [default: of a cube map, 1/16 of its faces]"


def _positions(texts: list[str]) -> Keys:
    return {"poses": [{"position": options.numbers("--position", text)} for text in texts]}


def _exposure(text: str) -> float | str:
    """Return ``auto``, ``game`` or a bias in stops."""
    if text in ("auto", "game"):
        return text
    try:
        return float(text)
    except ValueError:
        raise options.wrong("--exposure", "auto, game or a bias in stops such as 0.5", text) from None


OPTIONS = {
    "source": JobOption(
        key("source"), list[str], [], f"{SOURCE_HELP} Repeatable: replicas of a game share the captures."
    ),
    "position": JobOption(
        _positions, list[str], ["0,0,1.5"], "X,Y,Z in metres: X forward, Y left, Z up; repeatable."
    ),
    "modes": MODES._replace(default="lit,object_mask,depth", panel=""),
    "fix_exposure": JobOption(
        lambda fix: {"source_options.fix_exposure": True} if fix else {},
        bool,
        False,
        "Switch off vignette and auto exposure.",
    ),
    "brackets": JobOption(
        lambda text: dict([options.setting(f"brackets=[{text}]")]),
        str | None,
        None,
        "Stops of exposure, such as -2,0,2: colours are captured at each, and merged to light.",
    ),
    "exposure": JobOption(
        lambda text: {} if text is None else {"source_options.exposure": _exposure(text)},
        str | None,
        None,
        "Of the camera: auto, manual and as bright as the game (default if the plugin can); a bias in stops; "
        "or game, the game's own.",
    ),
    "out": JobOption(key("record"), str | None, None, "The recording; else the job's, or capture.sqlite."),
    **SET,
}


@app.command(
    cls=accepting(OF_JOBS),
    no_args_is_help=True,
    epilog="Example: omniscv record --source mock://four-wall --position 0,0,1.5 --position 1,0,1.5 "
    "--set face_size=256 --modes lit,mask,depth --out room.sqlite",
)
@with_job(OPTIONS)
def record(
    job: JobArguments,
    launch: Annotated[
        list[Path] | None, Option(help="A packaged game to start, and to stop at the end; repeatable.")
    ] = None,
    overscan: Annotated[int | None, Option(min=0, max=8192, help=_OVERSCAN_HELP)] = None,
    progress: StyleOption = None,
) -> None:
    """Capture cube maps at positions, or all that a job needs, into a recording; rerun to resume."""
    from omniscv.make import capture
    from omniscv.sources.recording.files import target_of

    loaded = _described(job, launch or []).load()
    path = loaded.record or Path("capture.sqlite")
    target_of(path)  # refuses what is no file, before a game is launched
    before = _count(path)
    cube_map = overscan is None and job.file is None
    with display("images", progress) as show:
        count = capture(loaded, path, show, border_px="overscan" if cube_map else overscan)
    new = _count(path) - before
    console.line(f"{path}: {count} captures" + ("" if new == count else f", {new or 'none'} new"))


def _count(path: Path) -> int:
    """Return how many captures a recording holds; 0 without one."""
    from omniscv.sources.recording.inspection import info

    return sum(info(path).captures.values()) if path.exists() and path.stat().st_size else 0


def _described(job: JobArguments, games: list[Path]) -> JobArguments:
    """Add what a job without a file captures, a cube map, and the games that are launched."""
    from omniscv.sources.registry import scheme_of

    values = dict(job.values)
    recorded = values["source"] and not any(map(scheme_of, values["source"]))
    edge = dict(map(options.setting, values["set"])).get("face_size", "auto" if recorded else 1024)
    width = 2 * edge if isinstance(edge, int) else 2048
    cube = {"model": "equirectangular", "width": width, "height": width // 2}
    described: dict[str, Any] = {
        "source": "mock://four-wall",
        "cameras": {"cube": cube},
        "strategy": "cube",
        "face_size": edge,
    }
    # The size is for a game that cannot set another one.
    size = f"?size={edge}x{edge}" if isinstance(edge, int) else ""
    values["source"] = [*values["source"], *(f"launch:{game}{size}" for game in games)]
    given = job.given | ({"source"} if games else set())
    return replace(job, values=values, given=given, described=described)
