"""``omniscv doctor``: find what would spoil captures."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option, Typer

from omniscv.cli import console, options
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)

_STYLES = {"ok": "green", "warning": "yellow", "bad": "bold red"}


@app.command(epilog="Example: omniscv doctor mock://four-wall\n\nExample: omniscv doctor --self")
def doctor(
    uri: Annotated[
        str | None,
        Argument(
            help="unreal://host:port, mock://SCENE, blender://FILE; a recording, or a folder of captures."
        ),
    ] = None,
    self: Annotated[bool, Option("--self", help="Check this installation, in place of a server.")] = False,
    quick: Annotated[
        bool, Option("--quick", help="Leave out the unit of depth, agreement of captures, and motion.")
    ] = False,
    position: Annotated[str | None, Option(help="X,Y,Z in metres; else the player's position.")] = None,
    picture: Annotated[
        Path | None, Option(help="PNG to write: the worst edge between two faces of a recording.")
    ] = None,
    as_json: options.AsJson = False,
    timeout: options.Timeout = None,
    patience: options.Patience = None,
) -> None:
    """Measure what a server is, and what would spoil captures there; or check this installation.

    Exit code 1 if something is bad.
    """
    if (uri is None) != self:
        raise ArgumentError(
            "doctor: expected the address of a server or --self, got " + ("both" if self else "none")
        )
    if uri is None:
        from omniscv.diagnostics.installation import examine_installation

        findings = examine_installation()
    else:
        import numpy as np

        from omniscv.diagnostics.doctor import examine_address

        where = None if position is None else np.array(options.numbers("--position", position))
        deadlines = options.deadlines(timeout, patience)
        findings = examine_address(uri, where, quick, picture=picture, **deadlines)
    if as_json:
        console.as_json([asdict(finding) for finding in findings])
    elif self:
        for finding in findings:
            remedy = f": {finding.remedy}" if finding.remedy else ""
            console.line(f"{finding.verdict:<8} {finding.name}: {finding.value}{remedy}")
    else:
        rows = [(finding.verdict, finding.name, finding.value, finding.remedy) for finding in findings]
        console.table(("", "measured", "found", "remedy"), rows, _STYLES)
    raise Exit(1 if any(finding.verdict == "bad" for finding in findings) else 0)
