"""``omniscv score``: predicted depth against truth that knows its own doubt."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from omniscv.cli import console, options
from omniscv.cli.console import StyleOption, display
from omniscv.progress import Progress

app = Typer(add_completion=False)


@app.command(
    no_args_is_help=True,
    epilog="Example: omniscv score predictions/ dataset/ --align median --out report/",
)
def score(
    predictions: Annotated[Path, Argument(metavar="PREDICTIONS", help="A folder: NAME.npy, .exr, .png, ...")],
    truth: Annotated[str, Argument(metavar="TRUTH", help="A dataset, or a folder that render wrote.")],
    out: Annotated[Path | None, Option(help="Folder for report.json, report.csv and report.html.")] = None,
    form: Annotated[str, Option(help="What predictions hold: range, planar or disparity.")] = "range",
    align: Annotated[str, Option(help="none, median, scale, scale-shift or disparity-scale-shift.")] = "none",
    unit: Annotated[float, Option(help="Of predictions, metres: .001 for millimetres.")] = 1.0,
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
    """Score predicted depth by pixels and by solid angle; pixels whose truth is in doubt are left out."""
    from omniscv.score import report

    with display("images", progress) as show:
        scored = report.score(
            predictions,
            truth,
            form=form,
            align=align,
            unit_m=unit,
            intervals=intervals,
            bounded=bounded,
            out=out,
            done=lambda count: show(Progress(images=count, of_images=count)),
        )
    if as_json:
        names = [item.name for item in scored]
        means = {"mean": report.mean(scored), "mean_within": report.mean_within(scored)}
        console.as_json({**means, "images": names})
        return
    rows = report.summary(scored)
    console.table(tuple(rows[0]), [tuple(row.values()) for row in rows])
    compared = sum(item.scores.compared for item in scored)
    in_doubt = sum(item.scores.in_doubt for item in scored)
    missing = sum(item.scores.missing for item in scored)
    lost = sum(item.scores.lost for item in scored)
    if lost:
        console.error(f"{lost} pixels are left out: aligned with a shift, their depth is 0 or less")
    counts = f"{compared} pixels compared, {in_doubt} in doubt left out, {missing} without a prediction"
    console.line(f"{len(scored)} images: {counts}")
    for item in scored:
        for mistake in item.mistakes:
            console.error(f"{item.name} {mistake.line()}")
        if item.resampled:
            console.error(f"{item.name}: {item.resampled}")
