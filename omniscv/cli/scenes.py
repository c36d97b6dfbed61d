"""``omniscv scenes``: the scenes of the mock server."""

from typing import Annotated

from typer import Argument, Typer

from omniscv.cli import console
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv scenes\n\nExample: omniscv scenes four-wall")
def scenes(
    name: Annotated[str | None, Argument(metavar="SCENE", help="A scene's name, or a YAML file.")] = None,
) -> None:
    """List the mock server's scenes; or the objects of one, with their boxes in metres."""
    import mock_server

    if name is None:
        columns = ("scene", "objects", "moving", "description")
        found = [(each, mock_server.load_scene(each)) for each in mock_server.scene_names()]
        rows = [(each, len(s.objects), len(s.moving), mock_server.summary(each)) for each, s in found]
        console.table(columns, rows)
        return
    try:
        scene = mock_server.load_scene(name)
    except ValueError as wrong:
        raise ArgumentError(str(wrong)) from wrong
    console.line(f"{scene.name}: {mock_server.summary(name)}")
    boxes = []
    for each in scene.objects:
        least, greatest = (" ".join(f"{x:.4g}" for x in corner) for corner in scene.bounds(each))
        boxes.append((each, least, greatest, "yes" if each in scene.moving else ""))
    console.table(("object", "least corner m", "greatest corner m", "moves"), boxes)
