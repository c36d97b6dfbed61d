"""Commands that look at something: cameras, plan, captures, doctor, chart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from omniscv.cli.progress import out as console
from omniscv.cli.progress import progress_bar

RecordFile = Annotated[Path, typer.Argument(metavar="FILE", help="A recorded file.")]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON, for programs.")]


def add_to(app: typer.Typer) -> None:
    """Adds the commands."""
    app.command(epilog="Example: omniscv cameras fisheye-equisolid")(cameras)
    app.command(epilog="Example: omniscv plan job.yaml --latency-ms 30")(plan)
    app.command(epilog="Example: omniscv doctor unreal://localhost:9000 --json")(doctor)
    records = typer.Typer(
        help="Look into a recorded file, check it, turn it into folders and back.", no_args_is_help=True
    )
    records.command(epilog="Example: omniscv captures info captures/four-wall.sqlite")(info)
    records.command(epilog="Example: omniscv captures verify captures/four-wall.sqlite")(verify)
    records.command(epilog="Example: omniscv captures export captures/four-wall.sqlite faces/")(export)
    records.command("import", epilog="Example: omniscv captures import faces/ mine.sqlite")(import_)
    app.add_typer(records, name="captures")
    charts = typer.Typer(help="Measure speed and accuracy, and draw them.", no_args_is_help=True)
    charts.command(epilog="Example: omniscv chart central --out docs/")(central)
    charts.command(epilog="Example: omniscv chart noncentral --out docs/")(noncentral)
    app.add_typer(charts, name="chart")


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


def plan(
    job: Annotated[Path, typer.Argument(metavar="JOB.yaml", help="A job.")],
    latency_ms: Annotated[
        float | None, typer.Option(help="Time of one request; measured on the source if not given.")
    ] = None,
) -> None:
    """What a job would capture, for every strategy side by side, before it is run."""
    from omniscv.job import costs, load

    table = Table(
        "strategy", "views", "requests", "megapixels", "megabytes", "seconds", box=None, header_style="bold"
    )
    for row in costs(load(job), latency_ms):
        table.add_row(*row)
    console.print(table)


def doctor(
    uri: Annotated[str, typer.Argument(help="unreal://host:port or mock://room.")], as_json: AsJson = False
) -> None:
    """What a server is, and what would spoil captures there. Exit code 1 if something would."""
    from omniscv.captures.unreal.doctor import doctor as examine

    report = examine(uri)
    if as_json:
        console.print(json.dumps(report.to_dict(), indent=2), markup=False)
    else:
        table = Table(
            "check", "found", "verdict", "cure", box=None, header_style="bold", padding=(0, 2, 0, 0)
        )
        for row in report.rows:
            color = {"ok": "green", "warn": "yellow"}.get(row.verdict, "red")
            table.add_row(row.name, row.value, f"[{color}]{row.verdict}[/{color}]", row.cure)
        console.print(table)
    raise typer.Exit(0 if report.ok else 1)


def info(file: RecordFile, as_json: AsJson = False) -> None:
    """What a recorded file holds and where it came from."""
    from omniscv.captures.store import info as look_into

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
    from omniscv.captures.store import verify as check

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


Out = Annotated[Path, typer.Option("--out", help="Folder for the figure and its numbers.")]


def central(out: Out = Path("out/chart")) -> None:
    """Central cameras: time and error for filters, face sizes and models."""
    from omniscv.chart.central import chart

    with progress_bar("measurements") as progress:
        files = chart(out, progress)
    for path in files:
        console.print(str(path), markup=False)


def noncentral(out: Out = Path("out/chart")) -> None:
    """Non-central cameras: requests, seconds and error for strategies and viewpoints."""
    from omniscv.chart.noncentral import chart

    with progress_bar("measurements") as progress:
        files = chart(out, progress)
    for path in files:
        console.print(str(path), markup=False)
