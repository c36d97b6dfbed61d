"""``omniscv serve``, ``scenes``, ``send`` and ``doctor``: the mock server, and what any server answers."""

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Exit, Option, Typer

from omniscv.cli import console, options
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)

_MESHES = (".glb", ".gltf", ".ply", ".obj", ".stl", ".off")
"""Endings of files that are served as meshes."""
_VERBS = ("vget", "vset", "vbp", "vrun", "vexec")
_STYLES = {"ok": "green", "warning": "yellow", "bad": "bold red"}


@app.command(
    context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []},
    epilog="Example: omniscv serve four-wall --port 9000 --dialect 0.3.10 --size 512x512",
)
def serve(context: typer.Context) -> None:
    """Serve a scene, a recording, or a mesh over the UnrealCV protocol, for any client, until Ctrl-C."""
    from mock_server.__main__ import main

    console.check()
    code = main(context.args, "omniscv serve", _opened)  # reads the options, as 'python -m mock_server' does
    raise Exit(code)


def _opened(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a server with the scene of a recording, as it was recorded, or of a mesh."""
    # Path.is_file raises an error where a name is too long.
    if not os.path.isfile(options["scene"]) or Path(options["scene"]).suffix in (".yaml", ".yml"):
        return options
    if Path(options["scene"]).suffix.lower() in _MESHES:
        from omniscv.sources.mesh.served import served

        return served(Path(options["scene"]), options)
    from omniscv.sources.recorded_scene import RecordedScene

    scene = RecordedScene(Path(options["scene"]))
    return scene.settings() | options | {"scene": scene}


@app.command(epilog="Example: omniscv scenes\n\nExample: omniscv scenes four-wall")
def scenes(
    name: Annotated[str | None, Argument(metavar="SCENE", help="A scene's name, or a YAML file.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """List the mock server's scenes; or the objects of one, with their boxes in metres."""
    if name is None:
        _list_scenes(as_json)
    else:
        _describe_scene(name, as_json)


def _list_scenes(as_json: bool) -> None:
    """Print the mock server's scenes."""
    import mock_server

    descriptions = []
    for name in mock_server.scene_names():
        scene = mock_server.load_scene(name)
        descriptions.append(
            {
                "scene": name,
                "objects": len(scene.objects),
                "moving": len(scene.moving),
                "description": mock_server.summary(name),
            }
        )
    if as_json:
        console.as_json(descriptions)
    else:
        rows = [tuple(description.values()) for description in descriptions]
        console.table(("scene", "objects", "moving", "description"), rows)


def _describe_scene(name: str, as_json: bool) -> None:
    """Print the objects of a scene, with their boxes."""
    import mock_server

    try:
        scene = mock_server.load_scene(name)
    except ValueError as wrong:
        raise ArgumentError(str(wrong)) from wrong
    objects = {}
    rows = []
    for key in scene.objects:
        least, greatest = scene.bounds(key)
        moves = key in scene.moving
        objects[key] = {"box_m": [least.tolist(), greatest.tolist()], "moves": moves}
        rows.append((key, _corner(least), _corner(greatest), "yes" if moves else ""))
    if as_json:
        console.as_json({"scene": scene.name, "description": mock_server.summary(name), "objects": objects})
        return
    console.line(f"{scene.name}: {mock_server.summary(name)}")
    console.table(("object", "least corner m", "greatest corner m", "moves"), rows)


def _corner(corner: Any) -> str:
    """Return a corner (3,), metres, as text."""
    return " ".join(f"{coordinate:.4g}" for coordinate in corner.tolist())


@app.command(
    epilog="Example: omniscv send mock://four-wall 'vget /unrealcv/status' 'vget /object/Table/location'"
)
@options.with_blocks
def send(
    uri: Annotated[str, Argument(help="unreal://host:port or mock://scene.")],
    commands: Annotated[list[str], Argument(metavar="COMMAND...", help="Of UnrealCV: 'vget /objects'.")],
    waiting: options.Waiting,
) -> None:
    """Send commands to a server, and print its replies; of a binary one, what it is and its size.

    The first command that is refused ends it, with exit code 1. What a command changes stays changed.
    """
    from omniscv.diagnostics.server import replies_to

    if commands[0] in _VERBS:
        raise ArgumentError(f"COMMAND: expected it in quotes, such as '{' '.join(commands)}', got words")
    for reply in replies_to(uri, commands, **waiting.deadlines()):
        console.document(reply)


@dataclass(frozen=True)
class _Files:
    """Files that the doctor writes, and options of a folder of frames with poses."""

    picture: Annotated[
        Path | None, Option(help="PNG to write: the worst edge between two faces of a recording.")
    ] = None
    report: Annotated[
        Path | None, Option(help="ZIP to write for those who cannot reach it: replies, timings, captures.")
    ] = None
    layout: Annotated[str, Option(help="Of a folder of frames with poses, as of an import.")] = "auto"
    depth: Annotated[str | None, Option(help="Its depth, as of an import: planar-mm and so on.")] = None
    intrinsics: Annotated[Path | None, Option(help="Its lens, a lens file of any form.")] = None


@app.command(epilog="Example: omniscv doctor mock://four-wall\n\nExample: omniscv doctor --self")
@options.with_blocks
def doctor(
    uri: Annotated[
        str | None,
        Argument(
            help="unreal://host:port, mock://SCENE, blender:// or mesh://FILE; recording; captures; frames."
        ),
    ] = None,
    self: Annotated[bool, Option("--self", help="Check this installation, in place of a server.")] = False,
    quick: Annotated[
        bool, Option("--quick", help="Leave out the unit of depth, agreement of captures, and motion.")
    ] = False,
    position: Annotated[str | None, Option(help="X,Y,Z in metres; else the player's position.")] = None,
    as_json: options.AsJson = False,
    *,
    files: _Files,
    waiting: options.Waiting,
) -> None:
    """Measure what a server is, and what would spoil captures there; or check this installation.

    Exit code 1 if something is bad.
    """
    if (uri is None) != self:
        given = "both" if self else "none"
        raise ArgumentError(f"doctor: expected the address of a server or --self, got {given}")
    if files.report is not None and not (uri or "").startswith(("unreal", "mock:")):
        raise ArgumentError(f"--report: expected an address unreal:// or mock://, got {uri or 'none'}")
    if uri is None:
        from omniscv.diagnostics.installation import examine_installation

        findings = examine_installation()
    else:
        findings = _examined(uri, quick, position, files, waiting)
    if as_json:
        console.as_json([asdict(finding) for finding in findings])
    else:
        _print_findings(findings, in_lines=self)
    raise Exit(1 if any(finding.verdict == "bad" for finding in findings) else 0)


def _print_findings(findings: list[Any], in_lines: bool) -> None:
    """Print findings as lines, or as a table."""
    rows = []
    for finding in findings:
        if in_lines:
            remedy = f": {finding.remedy}" if finding.remedy else ""
            console.line(f"{finding.verdict:<8} {finding.name}: {finding.value}{remedy}")
        else:
            rows.append((finding.verdict, finding.name, finding.value, finding.remedy))
    if not in_lines:
        console.table(("", "measured", "found", "remedy"), rows, _STYLES)


def _examined(
    uri: str, quick: bool, position: str | None, files: _Files, waiting: options.Waiting
) -> list[Any]:
    """Return the findings of an address, and write the files that are asked for; see :func:`doctor`."""
    import numpy as np

    from omniscv.diagnostics.doctor import examine_address
    from omniscv.progress import phase

    where = None if position is None else np.array(options.numbers("--position", position))
    words: dict[str, Any] = {}
    if files.depth is not None:
        words["depth"] = files.depth
    if files.intrinsics is not None:
        words["intrinsics"] = files.intrinsics
    deadlines = waiting.deadlines()
    with console.display("examining"), phase("examining"):
        findings = examine_address(
            uri, where, quick, picture=files.picture, layout=files.layout, said=words, **deadlines
        )
    if files.report is not None:
        from omniscv.diagnostics.report import write_report

        write_report(uri, findings, files.report, where, **deadlines)
    return findings
