"""The command that looks at a server."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from omniscv.cli import options
from omniscv.cli.look import AsJson
from omniscv.cli.progress import out as console

_STYLES = {"ok": "green", "warning": "yellow", "bad": "bold red"}


def add_to(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(epilog="Example: omniscv doctor unreal://localhost:9000")(doctor)


def doctor(
    uri: Annotated[str, typer.Argument(help="unreal://host:port or mock://room.")],
    position: Annotated[
        str | None,
        typer.Option("--position", help="Where to look around, X,Y,Z in metres; where the player is."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """What a server is, and what would spoil captures there. Exit code 1 if something would."""
    from omniscv.captures.opening import open_link
    from omniscv.captures.unreal.doctor import examine

    place = None if position is None else np.array(options.numbers("--position", position, 3))
    with open_link(uri) as link:
        findings = examine(link, place)
    if as_json:
        console.print(json.dumps([asdict(finding) for finding in findings], indent=2), markup=False)
    else:
        table = Table("", "looked at", "found", "cure", box=None, header_style="bold", padding=(0, 1, 0, 0))
        for each in findings:
            table.add_row(f"[{_STYLES[each.verdict]}]{each.verdict}[/]", each.name, each.value, each.cure)
        console.print(table)
    raise typer.Exit(1 if any(finding.verdict == "bad" for finding in findings) else 0)
