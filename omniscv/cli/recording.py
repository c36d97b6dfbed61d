"""``omniscv recording``: inspect, check and convert recordings."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option, Typer

from omniscv.cli import console, options
from omniscv.cli.console import StyleOption, display
from omniscv.errors import ArgumentError

_HELP = "Inspect recordings, check, join and divide them, convert them to folders and back."
app = Typer(name="recording", help=_HELP, no_args_is_help=True, add_completion=False)

_MOST_NAMES = 5  # of objects in a line

# Texts: as a path, a URL would lose a slash.
Recording = Annotated[str, Argument(metavar="FILE", help="A recording, by path or URL.")]
Written = Annotated[Path, Argument(metavar="FILE", help="A recording.")]


@app.command(epilog="Example: omniscv recording info room.sqlite")
def info(file: Recording, as_json: options.AsJson = False) -> None:
    """Show what a recording holds and where it came from."""
    from omniscv.sources.recording import inspection

    summary = asdict(inspection.info(file))
    if as_json:
        console.as_json(summary)
        return
    states = summary.pop("states")
    console.summary(summary)
    if states.keys() - {""}:
        rows = []
        for name, state in states.items():
            instant = state["instant"] or {"time": None, "poses": {}, "hidden": []}
            time = "" if instant["time"] is None else f"{instant['time']:.9g} s"
            placed = ", ".join(sorted(instant["poses"])[:_MOST_NAMES])
            hidden = ", ".join(sorted(instant["hidden"])[:_MOST_NAMES])
            rows.append((name or "still", state["captures"], time, placed, hidden))
        console.table(("state", "captures", "time", "placed", "hidden"), rows)


@app.command(epilog="Example: omniscv recording check room.sqlite")
def check(file: Recording) -> None:
    """Check a recording: its structure, and every capture against its checksums. Exit code 1 if damaged."""
    from omniscv.sources.recording import inspection

    report = inspection.verify(file)
    for line in report.lines():
        console.line(line)
    raise Exit(0 if report.ok else 1)


@app.command(epilog="Example: omniscv recording export room.sqlite faces/")
def export(file: Recording, folder: Annotated[Path, Argument(help="An empty or new folder.")]) -> None:
    """Write a recording as a folder of images and JSON."""
    from omniscv.importing import folders

    console.line(f"{folder}: {folders.export(file, folder)} captures")


@dataclass(frozen=True)
class _Said:
    """Options that say of pictures what they do not."""

    position: Annotated[str | None, Option(metavar="X,Y,Z", help="Of one place, metres.")] = None
    yaw: Annotated[float | None, Option(help="Of the front face, degrees to the left.")] = None
    depth: Annotated[str | None, Option(help="planar-mm, ray-m, ray-1/512 and so on; or carla.")] = None
    missing: Annotated[list[float] | None, Option(help="A number of no depth; repeatable.")] = None
    names: Annotated[Path | None, Option(help="JSON of the objects in masks.")] = None
    poses: Annotated[Path | None, Option(help="CSV or JSON of panoramas' poses, by name.")] = None
    intrinsics: Annotated[Path | None, Option(help="A lens file of any form.")] = None
    frame: Annotated[str | None, Option(help="Axes of --poses: camera, body, unreal, opengl, ned.")] = None
    unit: Annotated[str | None, Option(help="Of --poses: m, cm, mm, or metres of one.")] = None
    mirrored: Annotated[bool, Option("--mirrored", help="Pictures show left as right.")] = False
    clip: Annotated[bool, Option("--clip", help="Take negative and NaN light as 0.")] = False
    transfer: Annotated[str | None, Option(help="Of 8-bit colours: srgb, linear, film, unknown.")] = None
    trust_words: Annotated[bool, Option("--trust-words", help="Take poses and projections as said.")] = False

    def given(self) -> dict[str, Any]:
        """Return the options that are given."""
        values = {name: value for name, value in vars(self).items() if value}
        if "position" in values:
            values["position"] = options.numbers("--position", values["position"])
        values.pop("yaw", None)
        if self.yaw is not None:
            values["yaw_deg"] = self.yaw
        return values


@app.command("import", epilog="Example: omniscv recording import skybox/ mine.sqlite --position 0,0,1.5")
@options.with_blocks
def import_(
    pictures: Annotated[
        Path, Argument(help="A folder of captures, faces, panoramas or frames; or a picture.")
    ],
    file: Written,
    layout: Annotated[
        str, Option(help="auto, one of docs/capture-folders.md, or a file .yaml that describes one.")
    ] = "auto",
    *,
    said: _Said,
) -> None:
    """Add pictures that other tools rendered, or an exported folder, to a recording."""
    from omniscv.importing import folders, importing
    from omniscv.progress import phase

    if (pictures / folders.INDEX).exists():
        given = said.given()
        if given:
            raise ArgumentError(f"{next(iter(given))}: expected none, because {folders.INDEX} says it")
        console.line(f"{file}: {folders.import_folder(pictures, file)} captures")
        return
    with display("pictures"), phase("importing"):
        added = importing.import_pictures(pictures, file, layout, **said.given())
    for line in (*added.lines, f"{file}: {added.captures} captures"):
        console.line(line)


@app.command(epilog="Example: omniscv recording merge house.sqlite room.sqlite kitchen.sqlite")
def merge(
    out: Annotated[str, Argument(metavar="OUT", help="The recording to add to or create, by path or URL.")],
    files: Annotated[list[str], Argument(metavar="FILE...", help="Recordings of one scene, by path or URL.")],
    progress: StyleOption = None,
) -> None:
    """Add recordings to another one, all or nothing; captures that it already holds are skipped."""
    from omniscv.sources import recording
    from omniscv.storage import without_secrets

    with display("recordings", progress) as shown:
        added = recording.merge(out, files, shown.steps)
    console.line(f"{without_secrets(out)}: {added} captures added")


@app.command(epilog="Example: omniscv recording split room.sqlite --out rooms")
def split(
    file: Recording,
    out: Annotated[str, Option(help="An empty or new folder: path or URL.")],
    distance: Annotated[float, Option(help="Metres between neighbours of one place, at most.")] = 0.5,
) -> None:
    """Write a recording for each place, with the captures that were made there."""
    from omniscv.sources import recording
    from omniscv.storage import folder

    for name, count in recording.split(file, out, distance):
        console.line(f"{folder(out)}/{name}: {count} captures")


@app.command(epilog="Example: omniscv recording places room.sqlite")
def places(file: Recording, as_json: options.AsJson = False) -> None:
    """List the optical centres of a recording, and what was captured at each."""
    from omniscv.sources.recording import inspection

    centers = inspection.centers(file)
    if as_json:
        console.as_json([asdict(center) for center in centers])
        return
    rows = []
    for center in centers:
        position = " ".join(f"{value:.5g}" for value in center.center)
        captures = " ".join(f"{count} {mode}" for mode, count in center.captures.items())
        rows.append((position, captures, center.state or "still"))
    console.table(("position m", "captures", "state"), rows)
