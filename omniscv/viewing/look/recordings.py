"""Panoramas at the places of a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from omniscv.cameras import create
from omniscv.compose.renderer import Renderer
from omniscv.errors import MissingCaptureError, RecordingError
from omniscv.geometry import Pose
from omniscv.sources.base import Source
from omniscv.sources.registry import open_source

_HEADER = b"SQLite format 3\x00"
_FACES = 6


def is_recording(path: Path) -> bool:
    """Return whether a file is a database, as recordings are."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_HEADER)) == _HEADER


def compose(
    path: Path, out: Path, size: tuple[int, int], progress: Callable[[int, int], None] | None = None
) -> list[str]:
    """Compose a level panorama at every place that a recording shows all around, and save it in a folder.

    Args:
        path: of the recording.
        out: the folder.
        size: width and height, px.
        progress: called with (places done, places in all).

    Returns:
        A line for every place that is left out.

    Raises:
        RecordingError: the file is no recording, or shows no place all around.
    """
    camera = create("equirectangular", width=size[0], height=size[1])
    left_out = []
    with open_source(str(path)) as source:
        renderer, found = Renderer(source), places(source)
        modes = tuple(
            mode for mode in ("lit", "object_mask", "depth", "normals") if mode in source.capabilities.modes
        )
        for i, place in enumerate(found):
            pose = Pose.from_angles(place)
            try:
                renderer.render(camera, pose, modes).save(out, stem=f"place-{i:04d}")
            except MissingCaptureError as missing:
                left_out.append(f"place {place}: {missing}")
            if progress:
                progress(i + 1, len(found))
    if len(left_out) == len(found):
        why = left_out[0] if left_out else f"no place has {_FACES} views"
        raise RecordingError(f"{path}: expected a place that is recorded all around, got none: {why}")
    return left_out


def places(source: Source) -> list[tuple[float, float, float]]:
    """Return the optical centres, metres, of as many views as a cube has faces, in the order of recording."""
    views = source.recorded_views() or ()
    at = Counter(tuple(float(each) for each in view.pose.position) for view in views)
    return [(x, y, z) for (x, y, z), count in at.items() if count >= _FACES]
