"""``omniscv job``: check a job, list its keys, or print one with every key."""

import re
from collections.abc import Iterator
from dataclasses import MISSING, is_dataclass
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option, Typer

from omniscv.cli import console
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)

_COMMENT_COLUMN = 38


@app.command(
    epilog="Example: omniscv job job.yaml\n\nExample: omniscv job --example\n\nExample: omniscv job --keys"
)
def job(
    job: Annotated[Path | None, Argument(metavar="JOB.yaml", help="A job to check.")] = None,
    example: Annotated[bool, Option("--example", help="Print a job with every key, as a start.")] = False,
    keys: Annotated[bool, Option("--keys", help="List the keys, for job files and --set.")] = False,
) -> None:
    """Check a job without opening its source, and print what it makes; list its keys, or print an example."""
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

    for key in keys():
        yield key.name, _shown_default(key.default), key.help


def _shown_default(value: Any) -> str:
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

    help_of = {key.name: key.help for key in keys()}
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
    from omniscv.make import check, check_dataset

    job = load(file)
    with within(file):
        check(job) if job.recipe == Recipe() else check_dataset(job)
    frames = "poses sampled in the source" if job.sampling else _count(len(job.poses), "pose")
    console.line(f"{file}: {_count(len(job.cameras), 'camera')} at {frames}, of {', '.join(job.sources)}")
    for name, camera in job.cameras.items():
        console.line(f"{name}: {camera}")


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
