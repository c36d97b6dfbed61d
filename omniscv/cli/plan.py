"""``omniscv plan``: the captures of each strategy."""

from dataclasses import asdict, replace
from typing import Annotated

from typer import Option, Typer

from omniscv.cli import console, options
from omniscv.cli.old_spellings import OF_JOBS, accepting
from omniscv.cli.options import VIEW, JobArguments, with_job

app = Typer(add_completion=False)

_COLUMNS = (
    "strategy",
    "views",
    "requests",
    "at most",
    "Mpx",
    "MB",
    "seconds",
    "shift m",
    "marked %",
)


@app.command(
    cls=accepting(OF_JOBS),
    epilog="Example: omniscv plan --camera noncentral-panorama --set camera.radius=1 --modes lit,depth",
)
@with_job(VIEW)
def plan(
    job: JobArguments,
    measure: Annotated[bool, Option("--measure", help="Open the source, and time captures.")] = False,
    as_json: options.AsJson = False,
) -> None:
    """List what each strategy would capture for a job, and how long that takes, without capturing it.

    The last columns are the largest distance from a pixel's own optical centre to that of its captures, and
    the share of pixels that are expected to be marked as inexact or unsure: the price of fewer viewpoints.
    """
    from omniscv.make import aims, costs, measured_price

    loaded = job.load()
    if measure:
        price = measured_price(loaded)
        console.error(f"measured: capture_ms=[{price.request:.2f},{price.megapixel:.2f}]")
        loaded = replace(loaded, options=replace(loaded.options, capture_ms=(price.request, price.megapixel)))
    strategies, accuracies = costs(loaded, measure=measure), aims(loaded)
    if as_json:
        console.as_json([asdict(cost) for cost in (*strategies, *accuracies)])
        return
    rows = []
    for cost in strategies:
        counts = (cost.views, cost.requests, cost.most_requests)
        sizes = (f"{cost.pixels / 1e6:.2f}", f"{cost.bytes / 1e6:.1f}", f"{cost.seconds:.1f}")
        rows.append(
            (cost.strategy, *counts, *sizes, f"{cost.displacement_m:.3f}", f"{100 * cost.marked:.0f}")
        )
    console.table(_COLUMNS, rows)
    aimed = [
        (cost.strategy, cost.requests, f"{cost.pixels / 1e6:.2f}", f"{cost.seconds:.1f}")
        for cost in accuracies
    ]
    console.table(("accuracy", "requests", "Mpx", "seconds"), aimed)
