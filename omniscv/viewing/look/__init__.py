"""A page to look around in images: one HTML file, for any browser, without a server or a network."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from omniscv.errors import ArgumentError

DEFAULT_SIZE = 1024, 512
MOST_PIXELS = 1 << 23
"""Of frames in the page itself: four panoramas of 2048 x 1024."""


def look(
    what: str | Path,
    out: str | Path = "look.html",
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    most_pixels: int = MOST_PIXELS,
    progress: Callable[[int, int], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write a page that shows images: as a sphere or flat, in every layer.

    Args:
        what: a dataset, a folder that ``render`` wrote, the ``STEM.json`` or a layer of one image, a picture,
            or a recording.
        out: the HTML file.
        size: of the panoramas that are composed at the places of a recording, px.
        most_pixels: the frames of more than that in all lie beside the page, in ``NAME.frames/``.
        progress: called with (frames done, frames in all).
        warn: called with a line where places of a recording are left out.

    Returns:
        The files, the page first.

    Raises:
        ArgumentError: nothing that can be shown, or a name that does not end in ``.html``.
        DatasetError, RecordingError: it is damaged.
    """
    from omniscv.viewing.look import gathering, page, recordings

    given, target = Path(what), Path(out)
    if target.suffix.lower() not in (".html", ".htm"):
        raise ArgumentError(f"out: expected a file NAME.html, got {target.name!r}")
    title = given.resolve().name
    if not recordings.is_recording(given):
        return page.write(gathering.gather(given), target, title, most_pixels, progress)
    with TemporaryDirectory() as folder:
        left_out = recordings.compose(given, Path(folder), size, progress)
        if left_out and warn:
            warn(left_out)
        return page.write(gathering.gather(Path(folder)), target, title, most_pixels)
