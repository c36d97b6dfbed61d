"""``omniscv job``: check a job, or print one with every key."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from omniscv.cli import console
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv job job.yaml\n\nExample: omniscv job --example")
def job(
    job: Annotated[Path | None, Argument(metavar="JOB.yaml", help="A job to check.")] = None,
    example: Annotated[bool, Option("--example", help="Print a job with every key, as a start.")] = False,
) -> None:
    """Check a job without opening its source, and print what it makes; or print one with every key."""
    if (job is None) != example:
        raise ArgumentError("job: expected JOB.yaml or --example, got " + ("both" if example else "neither"))
    if job is None:
        from omniscv.job import EXAMPLE

        console.document(EXAMPLE.read_text(encoding="utf-8"))
        return
    from omniscv.arguments import within
    from omniscv.job import Recipe, load
    from omniscv.make import check, check_dataset

    found = load(job)
    with within(job):
        check(found) if found.recipe == Recipe() else check_dataset(found)
    frames = "poses sampled in the source" if found.sampling else _count(len(found.poses), "pose")
    cameras = _count(len(found.cameras), "camera")
    console.line(f"{job}: {cameras} at {frames}, of {', '.join(found.sources)}")
    for name, camera in found.cameras.items():
        console.line(f"{name}: {camera}")


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
