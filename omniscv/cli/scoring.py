"""``omniscv score``: predicted depth, labels or normals against truth that knows its own doubt."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option, Typer

from omniscv.cli import console, options
from omniscv.cli.console import StyleOption, display
from omniscv.progress import Progress

if TYPE_CHECKING:
    from omniscv.cameras import Camera
    from omniscv.score.reading import Lens
    from omniscv.score.report import Results

app = Typer(add_completion=False)


@app.command(
    no_args_is_help=True,
    epilog="Example: omniscv score predictions/ dataset/ --align median --out report/\n\n"
    "Example: omniscv score predictions/ dataset/ --beside other/ --also edges,points --out report/",
)
def score(
    predictions: Annotated[Path, Argument(metavar="PREDICTIONS", help="A folder: NAME.npy, .exr, .png, ...")],
    truth: Annotated[
        str, Argument(metavar="TRUTH", help="A dataset, a folder that render wrote; with --camera files.")
    ],
    out: Annotated[Path | None, Option(help="Folder for report.json, report.csv and report.html.")] = None,
    what: Annotated[str, Option(help="What is scored: depth, labels, normals or panoptic.")] = "depth",
    form: Annotated[str, Option(help="What predictions hold: range, planar or disparity.")] = "range",
    align: Annotated[str, Option(help="none, median, scale, scale-shift or disparity-scale-shift.")] = "none",
    per: Annotated[str, Option(help="One alignment for each image, or for the set.")] = "image",
    protocol: Annotated[
        str, Option(help="A paper's own figures, too: depth-anywhere, depth-any-camera, unik3d or moge.")
    ] = "",
    also: Annotated[str, Option(help="Figures that take longer: edges, points, or both with a comma.")] = "",
    beside: Annotated[
        list[Path] | None, Option(help="Other predictions of the same images, compared; repeatable.")
    ] = None,
    cameras: Annotated[
        str, Option(help="Names of a dataset's cameras whose frames count, with commas; all.")
    ] = "",
    unit: Annotated[float, Option(help="Of predictions, metres: .001 for millimetres.")] = 1.0,
    camera: Annotated[
        str | None, Option(help="The camera of TRUTH that is files: a central model, or a calibration file.")
    ] = None,
    set_: Annotated[
        list[str] | None, Option("--set", help="KEY=VALUE: a parameter of that camera; repeatable.")
    ] = None,
    truth_unit: Annotated[float, Option(help="Of such files, metres.")] = 1.0,
    predicted_camera: Annotated[
        str | None, Option(help="Another camera that predictions are of, at the same place.")
    ] = None,
    set_predicted: Annotated[
        list[str] | None, Option(help="KEY=VALUE: a parameter of that camera; repeatable.")
    ] = None,
    turn: Annotated[str, Option(help="Yaw,pitch,roll of that camera in the truth's, degrees.")] = "0,0,0",
    intervals: Annotated[
        bool | None,
        Option(
            "--intervals/--no-intervals",
            help="What figures can be by truths within their bounds; default: without --align.",
        ),
    ] = None,
    bounded: Annotated[
        bool, Option("--bounded", help="Compare pixels in doubt, too, where the truth has a bound.")
    ] = False,
    as_json: options.AsJson = False,
    progress: StyleOption = None,
) -> None:
    """Score predictions by pixels and by solid angle; pixels whose truth is in doubt are left out."""
    from omniscv.score import report

    chosen: dict[str, Any] = {
        "what": what,
        "form": form,
        "align": align,
        "per": per,
        "unit_m": unit,
        "intervals": intervals,
        "bounded": bounded,
        "also": tuple(name for name in also.split(",") if name),
        "protocol": protocol,
        "cameras": tuple(name for name in cameras.split(",") if name),
        "camera": _lens("--camera", camera, set_ or []),
        "truth_unit_m": truth_unit,
        "predicted_camera": _lens("--predicted-camera", predicted_camera, set_predicted or []),
        "rotation": _rotation(turn),
    }
    with display("images", progress) as show:
        results = report.score_all(
            [predictions, *(beside or [])],
            truth,
            out,
            lambda count: show(Progress(images=count, of_images=count)),
            **chosen,
        )
    if as_json:
        console.as_json(report.summary_of(results))
        return
    _print(results)


def _lens(option: str, text: str | None, settings: list[str]) -> Lens | None:
    """Return what gives the camera of an option in a size; None without it."""
    if text is None:
        return None

    def camera(width: int, height: int) -> Camera:
        """Return the camera in a size, px."""
        return options.central_camera(option, text, (width, height), settings)

    return camera


def _rotation(turn: str) -> Any:
    """Return R_truth_predicted of yaw, pitch and roll, degrees; None where all are 0."""
    angles = options.numbers("--turn", turn, "90,0,0")
    if not any(angles):
        return None
    from omniscv.geometry import R_LEVEL, Pose

    return R_LEVEL.T @ Pose.from_angles((0, 0, 0), *angles).R_w_c


def _print(results: Results) -> None:
    """Print the figures, what was left out, and what predictions read as instead."""
    from omniscv.score import report, running

    for name, scored in results.items():
        if len(results) > 1:
            console.line(f"{name}:")
        rows = report.summary(scored)
        console.table(tuple(rows[0]), [tuple(row.values()) for row in rows])
        for figure, value in running.mean_extra(scored).items():
            console.line(f"{figure}: {value:.4g}")
        _print_counts(scored)
    for name, rows_of in report.compared(results).items():
        cells = []
        for row in rows_of:
            if row.weights == "by_solid_angle":
                cells.append((row.measure, f"{row.mean:+.4g}", row.interval))
        scenes = f"{rows_of[0].scenes} {'scene' if rows_of[0].scenes == 1 else 'scenes'}"
        console.line(f"{name} less {next(iter(results))}, by solid angle, {scenes}:")
        console.table(("measure", "difference", "95 %"), cells)


def _print_counts(scored: Any) -> None:
    """Print what was compared and left out, and each image's mistakes."""
    compared = sum(item.scores.compared for item in scored)
    in_doubt = sum(item.scores.in_doubt for item in scored)
    missing = sum(getattr(item.scores, "missing", 0) for item in scored)
    lost = sum(getattr(item.scores, "lost", 0) for item in scored)
    if lost:
        console.error(f"{lost} pixels are left out: aligned with a shift, their depth is 0 or less")
    counts = f"{compared} pixels compared, {in_doubt} in doubt left out, {missing} without a prediction"
    console.line(f"{len(scored)} {'image' if len(scored) == 1 else 'images'}: {counts}")
    for item in scored:
        for mistake in item.mistakes:
            console.error(f"{item.name} {mistake.line()}")
        if item.resampled:
            console.error(f"{item.name}: {item.resampled}")
