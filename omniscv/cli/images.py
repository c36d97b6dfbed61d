"""``omniscv render``, ``record``, ``plan`` and ``job``: images, their captures, and jobs of them."""

import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, asdict, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option, Typer

from omniscv.cli import console, options
from omniscv.cli.console import StyleOption, display
from omniscv.cli.options import IMAGES, MODES, SET, SOURCE_HELP, VIEW, JobArguments, JobOption, key, with_job
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)

_COMMENT_COLUMN = 38  # of the example of a job
_UNCHECKED = (
    "an accuracy knows nothing of what no capture shows, such as slits and poles narrower than a captured "
    "pixel; --set checks=beat compares captures of a second size"
)
_OVERSCAN_HELP = "Additional px on each side of a capture. [default: of a cube map, 1/16 of its faces]"


@app.command(
    no_args_is_help=True,
    epilog="Example: omniscv render --source mock://four-wall --camera fisheye-equidistant "
    "--size 1024x1024 --set camera.fov_deg=185 --position 0,0,1.5 --modes lit,depth --out out/\n\n"
    "Example: omniscv render job.yaml --modes lit --set camera.width=512 --out draft/",
)
@with_job(IMAGES)
def render(
    job: JobArguments,
    stem: Annotated[str | None, Option(help="Start of the file names; else the camera's name.")] = None,
    as_json: options.AsJson = False,
    progress: StyleOption = None,
) -> None:
    """Compose images and their ground truth."""
    from omniscv.make import run

    loaded = job.load()
    if stem is not None:
        if loaded.rig is not None or len(loaded.cameras) != 1:
            raise ArgumentError(f"--stem: expected a job with one camera, got {len(loaded.cameras)}")
        (camera,) = loaded.cameras.values()
        own_cameras = {}
        for own_camera in loaded.own_cameras.values():  # one, or none
            own_cameras[stem] = own_camera
        loaded = replace(loaded, cameras={stem: camera}, own_cameras=own_cameras)
    images: list[tuple[float, float | None, Any]] = []
    with display("images", progress) as show:
        files = run(
            loaded,
            show,
            warn=console.error,
            done=lambda image: images.append((image.doubtful, image.options.accuracy, image.effort)),
        )
    names = list(dict.fromkeys(map(str, files)))  # objects.json is one file for all images
    if as_json:
        console.as_json(names)
    else:
        console.document(f"{len(names)} files in {loaded.out}/\n{_spent(images, show.seconds)}")


def _spent(images: Sequence[tuple[float, float | None, Any]], seconds: float) -> str:
    """Return what images took in one line: captures, the share in doubt of what was asked, why they ended."""
    if not images:
        return f"no images, {seconds:.1f} s"
    captures = sum(effort.captures for _, _, effort in images)
    doubtful, aim, effort = max(images, key=lambda image: image[0])
    count = "1 image"
    share = f"{100 * doubtful:.3g} % of the pixels in doubt"
    if len(images) > 1:
        count = f"{len(images)} images"
        share = f"at most {share}"
    if aim is not None:
        share += f" ({100 * aim:.3g} % asked)"
    if effort.stopped not in ("", "aim"):
        share += f"; {effort.stopped}"
    return f"{count}: {captures} captures, {share}, {seconds:.1f} s"


# -- record ----------------------------------------------------------------------------------------------


def _exposure(text: str) -> float | str:
    """Return ``auto``, ``game`` or a bias in stops."""
    if text in ("auto", "game"):
        return text
    try:
        return float(text)
    except ValueError:
        raise options.wrong("--exposure", "auto, game or a bias in stops such as 0.5", text) from None


def _positions(texts: list[str]) -> options.Keys:
    """Return the keys of ``--position``, a pose each."""
    poses = [{"position": options.numbers("--position", text)} for text in texts]
    return {"poses": poses}


RECORD = {
    "source": JobOption(
        key("source"), list[str], [], f"{SOURCE_HELP} Repeatable: replicas of a game share the captures."
    ),
    "position": JobOption(
        _positions,
        list[str],
        ["0,0,1.5"],
        "X,Y,Z in metres: X forward, Y left, Z up; repeatable.",
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
        key("source_options.exposure", _exposure),
        str | None,
        None,
        "Of the camera: auto, manual and as bright as the game (default if the plugin can); a bias in stops; "
        "or game, the game's own.",
    ),
    "out": JobOption(key("record"), str | None, None, "The recording; else the job's, or capture.sqlite."),
    **SET,
}
"""Cube maps at positions, and the recording that they are captured into."""


@app.command(
    no_args_is_help=True,
    epilog="Example: omniscv record --source mock://four-wall --position 0,0,1.5 --position 1,0,1.5 "
    "--modes lit,mask,depth --out room.sqlite",
)
@with_job(RECORD)
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
    cube_map = overscan is None and job.file is None
    with display("images", progress) as show:
        count, new = capture(
            loaded, path, show, console.error, border_px="overscan" if cube_map else overscan
        )
    console.line(f"{path}: {count} captures" + ("" if new == count else f", {new or 'none'} new"))


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


# -- plan ------------------------------------------------------------------------------------------------


@app.command(
    epilog="Example: omniscv plan --camera noncentral-panorama --set camera.radius=1 --modes lit,depth"
)
@with_job(VIEW)
def plan(
    job: JobArguments,
    measure: Annotated[
        bool, Option("--measure", help="Make two captures of each mode and one image, to measure seconds.")
    ] = False,
    as_json: options.AsJson = False,
    progress: StyleOption = None,
) -> None:
    """List what auto, three accuracies, exact and cube would capture for a job.

    The last column is the share of pixels that are expected to be marked as inexact or unsure: the price of
    fewer captures. Where what is seen decides, captures are from those of a furnished room to twice as many,
    in fine relief more. Seconds are listed where they are measured: by --measure, those of the whole job; by
    a recording of the job that knows when its captures were made, those of captures.
    """
    from omniscv.make import check_worlds, costs
    from omniscv.render_options import COMPARED

    priced: list[tuple[str, Any]] = []  # the name of a world, and a cost
    is_unchecked = False
    loaded = job.load()
    with display("worlds", progress):
        started = time.perf_counter()
        checked = check_worlds(loaded, dataset=False)
        searched_s = (time.perf_counter() - started) / len(checked.each)
        for world in checked.each:
            if world.options.checks != "beat" and not set(COMPARED).isdisjoint(world.modes):
                is_unchecked = True
            for cost in costs(world, measure=measure, searched_s=searched_s):
                priced.append((world.world, cost))
    if len({name for name, _ in priced}) > 1:
        priced += [("all worlds", total) for total in _totals(priced)]
    if as_json:
        console.as_json([_plain_cost(name, cost) for name, cost in priced])
        return
    _print_costs(priced, measured=measure)
    if is_unchecked and any(cost.way.endswith("%") for _, cost in priced):
        console.error(_UNCHECKED)


def _totals(priced: Sequence[tuple[str, Any]]) -> list[Any]:
    """Return the costs of all worlds together, one for each way."""
    by_way: dict[str, Any] = {}
    for _, cost in priced:
        by_way[cost.way] = by_way[cost.way] + cost if cost.way in by_way else cost
    return list(by_way.values())


def _plain_cost(world: str, cost: Any) -> dict[str, Any]:
    """Return a cost as plain values, with the name of its world if it has one."""
    values = asdict(cost)
    return {"world": world, **values} if world else values


def _print_costs(priced: Sequence[tuple[str, Any]], *, measured: bool) -> None:
    """Print the table of costs, with a column of worlds if they have names.

    Args:
        priced: the name of a world, and a cost.
        measured: whether seconds are of the whole job, else of the captures alone.
    """
    columns = ["strategy", "captures", "Mpx", "marked %"]
    is_timed = any(cost.seconds is not None for _, cost in priced)
    if is_timed:
        columns.insert(3, "seconds" if measured else "capture s")
    has_worlds = bool(priced[-1][0])
    if has_worlds:
        columns.insert(0, "world")
    rows = []
    for name, cost in priced:
        captures = str(cost.requests) if cost.most == cost.requests else f"{cost.requests} to {cost.most}"
        if cost.traced:
            captures += f", {', '.join(cost.traced)} by rays"
        marked = f"{100 * cost.marked:.2g}" if cost.marked < 1 else "unknown"
        row = [cost.way, captures, f"{cost.pixels / 1e6:.2f}", marked]
        if is_timed:
            row.insert(3, "" if cost.seconds is None else f"{cost.seconds:.3g}")
        rows.append([name, *row] if has_worlds else row)
    console.table(columns, rows)


# -- job -------------------------------------------------------------------------------------------------


@app.command(
    epilog="Example: omniscv job job.yaml\n\nExample: omniscv job --example\n\nExample: omniscv job --keys"
)
def job(
    job: Annotated[Path | None, Argument(metavar="JOB.yaml", help="A job to check.")] = None,
    example: Annotated[bool, Option("--example", help="Print a job with every key, as a start.")] = False,
    keys: Annotated[bool, Option("--keys", help="List the keys, for job files and --set.")] = False,
) -> None:
    """Check a job and its sources, and print what it makes; list its keys, or print an example."""
    if (job is not None) + example + keys != 1:
        raise ArgumentError("job: expected one of JOB.yaml, --example and --keys")
    if job is not None:
        _check(job)
    elif keys:
        console.table(("key", "default", "meaning"), key_rows())
    else:
        console.document(example_text())


def key_rows() -> Iterator[tuple[str, str, str]]:
    """Yield dotted key, default and help of every key: the table of ``--keys`` and of docs/job.md."""
    from omniscv.job import keys

    for row in keys():
        yield row.name, _shown_default(row.default), row.help


def _shown_default(value: Any) -> str:
    """Return the default of a key, as files have it."""
    if value is MISSING:
        return "required"
    if value is None or value == () or is_dataclass(value):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f"[{', '.join(map(str, value))}]" if isinstance(value, tuple) else str(value)


def example_text() -> str:
    """Return the example job, with the help of its keys as comments."""
    from omniscv.job import EXAMPLE, keys

    help_of = {row.name: row.help for row in keys()}
    lines = []
    for line in EXAMPLE.read_text(encoding="utf-8").splitlines():
        name = re.match(r"(\w+):", line)
        if name is None:
            lines.append(line)
        elif len(line) < _COMMENT_COLUMN:
            lines.append(f"{line:{_COMMENT_COLUMN}}# {help_of[name[1]]}")
        else:
            lines += [f"# {help_of[name[1]]}", line]
    return "\n".join(lines)


def _check(file: Path) -> None:
    """Print what a job makes; ArgumentError for anything that ``render`` or ``dataset make`` would refuse."""
    from omniscv.arguments import within
    from omniscv.job import Recipe, load
    from omniscv.make import check_worlds

    job = load(file)
    with within(file):
        dataset = bool(job.worlds) or job.recipe != Recipe()
        with display("worlds"):
            known = check_worlds(job, dataset=dataset)
    for world in known.each:
        start = f"{file}: worlds.{world.world}" if world.world else file
        cameras = _count(len(world.cameras), "camera")
        poses = _count(len(world.poses), "pose") if world.poses else "poses sampled in the source"
        console.line(f"{start}: {cameras} at {poses}, of {', '.join(world.sources)}")
    if known.worlds:
        console.line(f"{file}: {sum(map(len, known.worlds))} images of {len(known.worlds)} worlds")
    for name, camera in known.cameras.items():
        console.line(f"{name}: {camera}")


def _count(number: int, noun: str) -> str:
    """Return ``1 camera``, ``2 cameras``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
