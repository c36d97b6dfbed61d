"""``omniscv look``: a page to look around in images."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from omniscv.cli import console, options
from omniscv.cli.console import StyleOption, display

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv look images/ --out look.html")
def look(
    what: Annotated[
        str,  # as a path, a URL would lose a slash
        Argument(
            metavar="DIR|FILE|RECORDING",
            help="Images, a STEM.json, a picture; or a dataset or recording, by path or URL.",
        ),
    ],
    out: Annotated[Path, Option(help="The page; many frames lie beside it, in NAME.frames/.")] = Path(
        "look.html"
    ),
    size: Annotated[str, Option(help="Of the panoramas of a recording, px.")] = "1024x512",
    rerun: Annotated[Path | None, Option(help="Also write NAME.rrd, for the Rerun viewer.")] = None,
    open: Annotated[bool, Option("--open", help="Show the page in the browser.")] = False,
    progress: StyleOption = None,
) -> None:
    """Write a page to look around in: every layer as a sphere or flat, names and metres under the cursor.

    It is one HTML file that works without a server or a network.
    """
    from omniscv.viewing.look import look

    with display("frames", progress) as shown:
        page, *rest = look(
            what, out, size=options.size(size), rerun=rerun, progress=shown.steps, warn=console.error
        )
    console.line(page)
    if rerun is not None:
        console.line(rest[-1])
    if open:
        import webbrowser

        if not webbrowser.open(page.resolve().as_uri()):
            console.error(f"expected a browser to show {page}, found none; open it yourself")
