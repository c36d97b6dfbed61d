"""A page to look around in images: one HTML file, for any browser, without a server or a network."""

from collections.abc import Callable
from pathlib import Path

from omniscv.errors import ArgumentError
from omniscv.progress import Steps
from omniscv.storage import is_url

DEFAULT_SIZE = 1024, 512
MOST_PIXELS = 1 << 23
"""Of frames in the page itself: four panoramas of 2048 x 1024."""


def look(
    what: str | Path,
    out: str | Path = "look.html",
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    most_pixels: int = MOST_PIXELS,
    rerun: str | Path | None = None,
    progress: Steps | None = None,
    warn: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write a page that shows images: as a sphere or flat, in every layer.

    Args:
        what: a dataset, a folder that ``render`` wrote, the ``STEM.json`` or a layer of one image, a picture,
            or a recording; a dataset, a picture or a recording also by URL.
        out: the HTML file.
        size: of the panoramas that are composed at the viewpoints of a recording, px.
        most_pixels: frames with more pixels in all are written beside the page, into ``NAME.frames/``.
        rerun: a file NAME.rrd to write, too: the same frames for the Rerun viewer (extra ``rerun``).
        progress: called with (frames done, frames in all).
        warn: called with a line if viewpoints of a recording are left out.

    Returns:
        The files, the page first, and last the one for Rerun.

    Raises:
        ArgumentError: nothing that can be shown, a name that does not end in ``.html``, or no Rerun.
        DatasetError, RecordingError: it is damaged.
        StorageError: a URL cannot be read.
    """
    from omniscv.viewing import rerun_file
    from omniscv.viewing.look import gathering, page

    target = Path(out)
    if target.suffix.lower() not in (".html", ".htm"):
        raise ArgumentError(f"out: expected a file NAME.html, got {target.name!r}")
    if rerun is not None:
        rerun_file.check(Path(rerun))
    title = str(what).rstrip("/").rpartition("/")[2] if is_url(what) else Path(what).resolve().name
    with gathering.open_frames(what, size, progress, warn) as gathered:
        written = page.write(gathered, target, title, most_pixels, progress)
        return written if rerun is None else [*written, rerun_file.write(gathered.frames, Path(rerun))]
