"""``omniscv look``: a page to look around in images."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from omniscv.cli import console, options

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv look images/ --out look.html")
def look(
    what: Annotated[
        Path,
        Argument(
            metavar="DIR|FILE|RECORDING", help="Images, a dataset, a STEM.json, a picture, a recording."
        ),
    ],
    out: Annotated[Path, Option(help="The page; many frames lie beside it, in NAME.frames/.")] = Path(
        "look.html"
    ),
    size: Annotated[str, Option(help="Of the panoramas of a recording, px.")] = "1024x512",
    open: Annotated[bool, Option("--open", help="Show the page in the browser.")] = False,
) -> None:
    """Write a page to look around in: every layer as a sphere or flat, names and metres under the cursor.

    It is one HTML file that works without a server or a network.
    """
    from omniscv.viewing.look import look

    with console.progress_bar("frames") as progress:
        page, *_ = look(what, out, size=options.size(size), progress=progress, warn=console.error)
    console.line(page)
    if open:
        import webbrowser

        if not webbrowser.open(page.resolve().as_uri()):
            console.error(f"expected a browser to show {page}, found none; open it yourself")
