"""``omniscv scenes``: the scenes of the mock server."""

from typing import Annotated

from typer import Argument, Typer

from omniscv.cli import console, options
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv scenes\n\nExample: omniscv scenes four-wall")
def scenes(
    name: Annotated[str | None, Argument(metavar="SCENE", help="A scene's name, or a YAML file.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """List the mock server's scenes; or the objects of one, with their boxes in metres."""
    if name is None:
        _list(as_json)
    else:
        _describe(name, as_json)


def _list(as_json: bool) -> None:
    import mock_server

    columns = ("scene", "objects", "moving", "description")
    loaded = {name: mock_server.load_scene(name) for name in mock_server.scene_names()}
    rows = [(name, len(s.objects), len(s.moving), mock_server.summary(name)) for name, s in loaded.items()]
    if as_json:
        console.as_json([dict(zip(columns, row, strict=True)) for row in rows])
    else:
        console.table(columns, rows)


def _describe(name: str, as_json: bool) -> None:
    import mock_server

    try:
        scene = mock_server.load_scene(name)
    except ValueError as wrong:
        raise ArgumentError(str(wrong)) from wrong
    boxes = {key: [corner.tolist() for corner in scene.bounds(key)] for key in scene.objects}
    if as_json:
        objects = {key: {"box_m": box, "moves": key in scene.moving} for key, box in boxes.items()}
        console.as_json({"scene": scene.name, "description": mock_server.summary(name), "objects": objects})
        return
    console.line(f"{scene.name}: {mock_server.summary(name)}")
    rows = []
    for key, box in boxes.items():
        least, greatest = (" ".join(f"{x:.4g}" for x in corner) for corner in box)
        rows.append((key, least, greatest, "yes" if key in scene.moving else ""))
    console.table(("object", "least corner m", "greatest corner m", "moves"), rows)
