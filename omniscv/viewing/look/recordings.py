"""Panoramas at the places of a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from omniscv import modalities
from omniscv.cameras import Camera, create
from omniscv.compose.image import OmniImage
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
) -> str:
    """Compose a level panorama at every place that a recording shows all around, and save it in a folder.

    A place is shown in all modes in which it is recorded all around; colour must be one, unless the recording
    has none.

    Args:
        path: of the recording.
        out: the folder.
        size: width and height, px.
        progress: called with (places done, places in all).

    Returns:
        How many places are left out, in words; empty for none.

    Raises:
        RecordingError: the file is no recording, or shows no place all around.
    """
    camera = create("equirectangular", width=size[0], height=size[1])
    with open_source(str(path)) as source:
        renderer, found = Renderer(source), places(source)
        modes = [each for each in modalities.names() if each in source.capabilities.modes]
        left_out = 0
        for i, place in enumerate(found):
            image = _image(renderer, camera, Pose.from_angles(place), modes)
            if image is None:
                left_out += 1
            else:
                image.save(out, stem=f"place-{i:04d}")
            if progress:
                progress(i + 1, len(found))
    why = f"{left_out} of {len(found)} optical centres are not recorded in {modes[0]} all around"
    if left_out == len(found):
        raise RecordingError(f"{path}: expected a place that is recorded all around, got none: {why}")
    return why if left_out else ""


def _image(renderer: Renderer, camera: Camera, pose: Pose, modes: Sequence[str]) -> OmniImage | None:
    """An image in those of some modes that are recorded, the first of them at least; else None."""
    try:
        return renderer.render(camera, pose, modes)
    except MissingCaptureError:
        held = [mode for mode in modes if _is_held(renderer, camera, pose, mode)]
    return renderer.render(camera, pose, held) if modes[0] in held else None


def _is_held(renderer: Renderer, camera: Camera, pose: Pose, mode: str) -> bool:
    try:
        renderer.render(camera, pose, [mode])
    except MissingCaptureError:
        return False
    return True


def places(source: Source) -> list[tuple[float, float, float]]:
    """Return the optical centres, metres, of as many views as a cube has faces, in the order of recording."""
    views = source.recorded_views() or ()
    at = Counter(tuple(float(each) for each in view.pose.position) for view in views)
    return [(x, y, z) for (x, y, z), count in at.items() if count >= _FACES]
