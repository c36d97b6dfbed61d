"""``omniscv demo``, ``look``, ``chart`` and ``evaluate``: sheets, pages and charts for people to look at."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option, Typer

from omniscv.cli import console, options
from omniscv.cli.console import StyleOption, display
from omniscv.errors import ArgumentError, OmniscvError

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


@app.command(epilog="Example: omniscv look images/ --out look.html")
def look(
    what: Annotated[
        str,  # as a path, a URL would lose a slash
        Argument(
            metavar="DIR|FILE|RECORDING",
            help="Images, a STEM.json, a picture; or a dataset or recording, by path or URL.",
        ),
    ],
    out: Annotated[Path, Option(help="The page; many frames lie beside it, in NAME.frames/.")] = Path(
        "look.html"
    ),
    size: Annotated[str, Option(help="Of the panoramas of a recording, px.")] = "1024x512",
    rerun: Annotated[Path | None, Option(help="Also write NAME.rrd, for the Rerun viewer.")] = None,
    progress: StyleOption = None,
) -> None:
    """Write a page to look around in: every layer as a sphere or flat, names and metres under the cursor.

    It is one HTML file that works without a server or a network.
    """
    from omniscv.viewing.look import look

    with display("frames", progress) as shown:
        files = look(
            what, out, size=options.size(size), rerun=rerun, progress=shown.steps, warn=console.error
        )
    console.line(files[0])
    if rerun is not None:
        console.line(files[-1])


@dataclass(frozen=True)
class Own:
    """Options of a camera of one's own, of the chart ``accuracy``; see :func:`options.with_blocks`."""

    camera: Annotated[str | None, Option(help="accuracy: your camera, a model or a lens file.")] = None
    source: Annotated[str | None, Option(help=f"accuracy: where it looks. {options.SOURCE_HELP}")] = None
    size: Annotated[str | None, Option(help="accuracy: of the camera's image, px.")] = None
    position: Annotated[str | None, Option(help="accuracy: X,Y,Z of the camera, metres.")] = None
    set: Annotated[
        list[str] | None, Option(help="accuracy: KEY=VALUE of a job, such as camera.fov_deg=185.")
    ] = None


@app.command(epilog="Example: omniscv chart central --quick --out charts")
@options.with_blocks
def chart(
    kind: Annotated[Literal["accuracy", "central", "failures", "stability"], Argument(help="What is drawn.")],
    out: Annotated[Path, Option(help="Folder for the JSON and the pictures.")] = Path("charts"),
    quick: Annotated[bool, Option("--quick", help="Tiny images: shows that it works.")] = False,
    progress: StyleOption = None,
    *,
    own: Own,
) -> None:
    """Draw cost against error; what makes images fail; models at their limits."""
    given = {name: value for name, value in asdict(own).items() if value}
    if given and (kind != "accuracy" or quick):
        raise ArgumentError(f"--{min(given)}: expected none, with --quick or a chart that is not 'accuracy'")
    _check_charts()
    module = import_module(f"omniscv.chart.{kind}")
    with display("rounds", progress) as shown:
        if given:
            rows = _measured_own(given, shown.steps)
        else:
            rows = module.measure(**(module.QUICK if quick else {}), progress=shown.steps)
    for path in module.write(rows, out):
        console.line(path)


def _check_charts() -> None:
    """Raise OmniscvError if charts cannot be drawn."""
    if find_spec("matplotlib") is None:
        raise OmniscvError("charts: expected the package matplotlib; pip install 'omniscv[charts]'")


def _measured_own(given: Mapping[str, Any], progress: Any) -> Any:
    """Return the rows of a camera of one's own, by the options that are given."""
    from omniscv.chart.accuracy import measure_own
    from omniscv.sources.registry import open_sources

    known = {}
    values = {}
    for field in fields(Own):
        option = options.VIEW[field.name]
        known[field.name] = option
        values[field.name] = given.get(field.name, option.default)
    job = options.JobArguments(None, known, values, frozenset(given)).load()
    ((name, camera),) = job.cameras.items()
    with open_sources(job.sources, **job.source_options) as opened:
        return measure_own(name, camera, job.poses[0], opened, progress=progress)


@app.command(epilog="Example: omniscv evaluate lines --quick --out evaluations")
def evaluate(
    name: Annotated[
        Literal["layout", "calibration", "lines", "odometry"], Argument(help="What is evaluated.")
    ],
    out: Annotated[Path, Option(help="Folder for NAME.json, NAME.csv and the chart.")] = Path("evaluations"),
    quick: Annotated[bool, Option("--quick", help="Few small images: within a minute.")] = False,
    source: Annotated[str | None, Option(help="A source in place of the mock's scenes.")] = None,
    predictions: Annotated[
        Path | None, Option(help="layout: a folder of predictions, CFL maps or HorizonNet's txt or json.")
    ] = None,
    trajectory: Annotated[
        Path | None, Option(help="odometry: a file of poses, TUM, KITTI or EuRoC, in place of the loop.")
    ] = None,
    progress: StyleOption = None,
) -> None:
    """Run an algorithm on images with known truth, score it, and print the scores beside the paper's."""
    _check_charts()
    from omniscv.evaluate import Settings, run

    out.mkdir(parents=True, exist_ok=True)
    options: dict[str, Any] = {}
    if predictions is not None:
        options["predictions"] = predictions
    if trajectory is not None:
        options["trajectory"] = trajectory
    with display(name, progress) as shown:
        report = run(name, Settings(out, quick, source, options, shown.steps))
    rows = []
    for row in report.figures:
        paper = "" if row.paper is None else f"{row.paper:g}"
        rows.append((row.name, f"{row.value:.4g} {row.unit}", paper, row.n))
    console.table((name, "ours", "paper", "n"), rows)
    for path in report.write(name, out):
        console.line(path)
