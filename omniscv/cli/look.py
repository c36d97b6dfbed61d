"""Commands that look at something: cameras, plan, captures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from omniscv.cli.progress import out as console

RecordFile = Annotated[Path, typer.Argument(metavar="FILE", help="A recorded file.")]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON, for programs.")]


def add_to(app: typer.Typer) -> None:
    """Adds the commands."""
    app.command(epilog="Example: omniscv cameras fisheye-equisolid")(cameras)
    app.command(epilog="Example: omniscv plan job.yaml")(plan)
    records = typer.Typer(
        help="Look into a recorded file, check it, turn it into folders and back.", no_args_is_help=True
    )
    records.command(epilog="Example: omniscv captures info captures/four-wall.sqlite")(info)
    records.command(epilog="Example: omniscv captures verify captures/four-wall.sqlite")(verify)
    records.command(epilog="Example: omniscv captures export captures/four-wall.sqlite faces/")(export)
    records.command("import", epilog="Example: omniscv captures import faces/ mine.sqlite")(import_)
    app.add_typer(records, name="captures")


def cameras(name: Annotated[str | None, typer.Argument(help="A model; all if not given.")] = None) -> None:
    """The camera models, their parameters and domains."""
    import inspect

    from omniscv.cameras import model, names

    if name is not None:
        console.print(f"{name}\n\n{inspect.getdoc(model(name))}", markup=False)
        return
    table = Table("model", "kind", "what it is", box=None, header_style="bold", padding=(0, 2, 0, 0))
    for each in names():
        cls = model(each)
        first = (inspect.getdoc(cls) or "").partition("\n")[0]
        table.add_row(each, "central" if cls.central else "non-central", first)
    console.print(table)


def plan(job: Annotated[Path, typer.Argument(metavar="JOB.yaml", help="A job.")]) -> None:
    """What a job would capture, for every strategy side by side, before it is run."""
    from omniscv.job import costs, load

    table = Table("strategy", "views", "requests", "megapixels", "megabytes", "seconds", box=None)
    for row in costs(load(job)):
        table.add_row(
            row.strategy,
            str(row.views),
            str(row.requests),
            f"{row.pixels / 1e6:.2f}",
            f"{row.bytes / 1e6:.1f}",
            f"{row.seconds:.1f}",
        )
    console.print(table)


def info(file: RecordFile, as_json: AsJson = False) -> None:
    """What a recorded file holds and where it came from."""
    from omniscv.captures.inspection import info as look_into

    summary = look_into(file).to_dict()
    if as_json:
        console.print(json.dumps(summary, indent=2), markup=False)
        return
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for key, value in summary.items():
        table.add_row(
            key.replace("_", " "), json.dumps(value) if isinstance(value, dict | list) else str(value)
        )
    console.print(table)


def verify(file: RecordFile) -> None:
    """Check every capture in a recorded file against its checksum. Exit code 1 if one is damaged."""
    from omniscv.captures.inspection import verify as check

    report = check(file)
    for line in report.lines():
        console.print(line, markup=False)
    raise typer.Exit(0 if report.ok else 1)


def export(file: RecordFile, folder: Annotated[Path, typer.Argument(help="An empty or new folder.")]) -> None:
    """Turn a recorded file into folders of images and JSON."""
    from omniscv.captures.transfer import export as to_folder

    console.print(f"{folder}: {to_folder(file, folder)} captures", markup=False)


def import_(
    folder: Annotated[Path, typer.Argument(help="A folder as 'export' makes it; docs/capture-folders.md.")],
    file: RecordFile,
) -> None:
    """Turn folders of images, exported or rendered by other tools, into a recorded file."""
    from omniscv.captures.transfer import import_folder

    console.print(f"{file}: {import_folder(folder, file)} captures", markup=False)
