"""``omniscv plan``: what each strategy would capture."""

from dataclasses import asdict

from typer import Option, Typer

from omniscv.cli import console, options
from omniscv.cli.job_options import JobOptions

app = Typer(add_completion=False)

_COLUMNS = ("strategy", "views", "requests", "at most", "megapixels", "megabytes", "seconds", "shift m")


class PlanOptions(JobOptions):
    """What to plan."""

    as_json: options.AsJson = False
    measure: bool = Option(False, "--measure", help="Open the source, and measure how long a request takes.")


@app.command(epilog="Example: omniscv plan --camera noncentral-panorama --param radius=1 --modes lit,depth")
@PlanOptions.command
def plan(given: PlanOptions) -> None:
    """List what each strategy would capture for a job, and how long that takes, without capturing it.

    The last column is the largest distance from a pixel's own optical centre to that of its captures: what
    fewer --viewpoints give up.
    """
    from omniscv.make import costs

    found = costs(given.to_job(), measure=given.measure)
    if given.as_json:
        console.as_json([asdict(cost) for cost in found])
        return
    rows = []
    for cost in found:
        counts = (cost.views, cost.requests, cost.most_requests)
        sizes = (f"{cost.pixels / 1e6:.2f}", f"{cost.bytes / 1e6:.1f}", f"{cost.seconds:.1f}")
        rows.append((cost.strategy, *counts, *sizes, f"{cost.displacement_m:.3f}"))
    console.table(_COLUMNS, rows)
