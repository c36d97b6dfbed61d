"""The pipeline from end to end, without Unreal: serve, capture over TCP, record, compose, replay, compare.

Its images are in one sheet: their colours, and smaller their labels, depth and normals.
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.compose.image import OmniImage
from omniscv.compose.pictures import (
    Picture,
    captioned,
    colored_depth,
    farthest,
    line_of_text,
    picture,
    resized,
    transfer_shown,
)
from omniscv.compose.renderer import Renderer
from omniscv.errors import OmniscvError
from omniscv.geometry import Pose
from omniscv.planning import RenderOptions
from omniscv.progress import Meter, Report
from omniscv.sources.base import ObjectTable, Source
from omniscv.sources.recording import record
from omniscv.sources.recording.inspection import info
from omniscv.sources.registry import open_source

MODES = ("lit", "object_mask", "depth", "normals")
ROOMS = ("four-wall", "six-wall")
_POSES = {
    0.0: Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0),
    90.0: Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0, pitch_deg=90.0),
    -90.0: Pose.from_angles((1.4, 0.5, 1.5), yaw_deg=20.0, pitch_deg=-90.0),
}
"""Camera poses by a model's usual pitch: mirrors hang above a camera that looks up, plans look down."""

_SQUARE_PX = 256
_WIDE_PX = 512
"""Widths of square images and of panoramas."""
_FACE_PX = 256
"""Width of a 90 degree face."""
_ACCURACY = 0.08
"""Of cameras with many viewpoints: less than the default's, for images as small as these."""

_PAPER = (255, 255, 255)
_LINE_PX = 2  # between pictures of one image
_WIDE = 1.8  # width by height of wide images
_SECTIONS = {
    "Panoramas": 2,
    "One optical centre: lenses, cube maps, mirrors seen from below": 4,
    "Many optical centres": 4,
}
"""Heading to the number of images in a row."""


def demo_cameras(scale: int = 1) -> dict[str, tuple[Camera, Pose]]:
    """Return an example of every registered model and its pose, by name.

    Args:
        scale: factor of the images' sizes.
    """
    examples = {}
    for name in cameras.names():
        model = cameras.model(name)
        camera = model.example(scale * _SQUARE_PX)
        camera = camera if camera.width < 2 * camera.height else model.example(scale * _WIDE_PX)
        examples[name] = camera, _POSES[model.typical_pitch_deg]
    return examples


@dataclass(frozen=True)
class DemoReport:
    """Counts and contact sheets of a demo, or of one of its rooms."""

    sheets: tuple[Path, ...]
    images: int
    captures: int
    compared: int
    seconds: float = 0.0

    def lines(self) -> Iterator[str]:
        """Yield the lines to print."""
        yield f"{self.captures} captures over TCP, {self.images} images in {self.seconds:.0f} s"
        yield f"{self.compared} layers recomposed from the recordings without the server: the same bytes"
        for sheet in self.sheets:
            yield f"contact sheet: {sheet}"


def run_demo(out: Path, progress: Report | None = None, scale: int = 1) -> DemoReport:
    """Serve each room, record and compose every camera in every mode, and recompose from the recording.

    Args:
        out: folder for the recordings, the images of each room, and the contact sheets.
        progress: called with the progress; each image counts twice, captured and recomposed.
        scale: factor of the images' sizes.

    Raises:
        OmniscvError: an image recomposed from the recording differs from the one that was captured.
    """
    started = time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    meter = Meter(2 * len(ROOMS) * len(demo_cameras()), progress)
    with ThreadPoolExecutor(len(ROOMS), thread_name_prefix="room") as pool:
        rooms = list(pool.map(lambda name: _room(name, out, meter, scale), ROOMS))
    sheets: list[Path] = []
    images = 0
    captures = 0
    compared = 0
    for room in rooms:
        sheets += room.sheets
        images += room.images
        captures += room.captures
        compared += room.compared
    return DemoReport(tuple(sheets), images, captures, compared, time.monotonic() - started)


def _room(name: str, out: Path, meter: Meter, scale: int) -> DemoReport:
    """Capture and compose all images of a room, and compare them with those recomposed from its recording."""
    recording = out / f"{name}.sqlite"
    images = {}
    with open_source(f"mock://{name}") as live, record(live, recording) as source:
        for stem, image in _compose(source, meter, scale):
            image.save(out / name, stem=stem)
            images[stem] = image
        objects = source.objects()
    compared = 0
    with open_source(str(recording)) as replay:
        for stem, image in _compose(replay, meter, scale):
            compared += _compare(images[stem], image, stem)
    title = f"omniscv: every camera in the room '{name}'"
    sheet = contact_sheet(images, objects, out / f"{name}.png", title)
    return DemoReport((sheet,), len(images), sum(info(recording).captures.values()), compared)


def _compose(source: Source, meter: Meter, scale: int) -> Iterator[tuple[str, OmniImage]]:
    """Yield name and image of every camera; cameras of one pose and kind share their captures."""
    renderer = Renderer(source)
    groups: dict[tuple[float, bool], dict[str, tuple[Camera, Pose]]] = {}
    for name, camera_and_pose in demo_cameras(scale).items():
        model = cameras.model(name)
        groups.setdefault((model.typical_pitch_deg, model.central), {})[name] = camera_and_pose
    for (_, central), group in groups.items():
        options = RenderOptions(face_size=scale * _FACE_PX, accuracy=None if central else _ACCURACY)
        images = renderer.render_together([*group.values()], MODES, options, progress=meter.part())
        yield from zip(group, images, strict=True)


def _compare(captured: OmniImage, replayed: OmniImage, name: str) -> int:
    """Return the number of layers; OmniscvError names the first layer that differs."""
    if list(captured.layers) != list(replayed.layers):
        raise OmniscvError(f"{name}: expected the layers {', '.join(captured.layers)} of the recording too")
    for layer, pixels in captured.layers.items():
        again = replayed.layers[layer]
        if (pixels.dtype, pixels.shape, pixels.tobytes()) != (again.dtype, again.shape, again.tobytes()):
            raise OmniscvError(f"{name}: expected the same {layer} when recomposed, but its bytes differ")
    return len(captured.layers)


def contact_sheet(images: Mapping[str, OmniImage], objects: ObjectTable, path: Path, title: str) -> Path:
    """Draw images with their truths, under headings: panoramas, other central cameras, non-central cameras.

    Args:
        images: caption to image; each has lit, labels, depth and normals.
        objects: for the legend of the labels.
        path: the PNG to write.
        title: printed on top.

    Returns:
        ``path``.

    Raises:
        ArgumentError: an image lacks a layer.
    """
    width = max(image.camera.width for image in images.values()) * 8 // 3
    em = max(8, width // 95)
    most = float(np.ceil(farthest(np.concatenate([image["depth"].ravel() for image in images.values()]))))
    blocks = [
        line_of_text(title, round(2.2 * em)),
        line_of_text("large: colour    beside it, downwards: labels, depth, normals", em),
    ]
    for heading, columns in _SECTIONS.items():
        cell = (width - (columns - 1) * em) // columns
        tiles = {}
        for name, image in images.items():
            if _section(image.camera) == heading:
                pixels = tile(image, most)
                height = round(pixels.shape[0] * cell / pixels.shape[1])
                tiles[name] = resized(pixels, (cell, height), transfer_shown(image))
        if tiles:
            blocks += [line_of_text(heading, round(1.3 * em)), captioned(tiles, columns, em)]
    metres = np.linspace(1e-3, most, width // 2, dtype=np.float32)
    bar = colored_depth(np.tile(metres, (em, 1)), most)
    blocks.append(captioned({f"depth along the ray, 0 to {most:g} m; white: sky": bar}, 1, em))
    blocks.append(captioned(_legend(images.values(), objects, (em, width // 6)), 5, em))
    widest = max(block.shape[1] for block in blocks)
    page = []
    for block in blocks:
        padding = (0, 0), (0, widest - block.shape[1]), (0, 0)
        page.append(np.pad(block, padding, constant_values=255))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(page)).save(path, compress_level=3)
    return path


def _section(camera: Camera) -> str:
    """Return the heading under which a camera's image stands."""
    panoramas, one_center, many_centers = _SECTIONS
    if camera.width >= _WIDE * camera.height:
        return panoramas
    return one_center if camera.central else many_centers


def _legend(images: Iterable[OmniImage], objects: ObjectTable, size: tuple[int, int]) -> dict[str, Picture]:
    """Return by name a field, of a height and width, in the colour of each object that an image shows."""
    seen: set[int] = set()
    for image in images:
        seen.update(np.unique(image["labels"]).tolist())
    legend = {}
    for name in objects.names():
        if objects.label(name) in seen:
            legend[name] = np.full((*size, 3), objects.colors[name], np.uint8)
    return legend


def tile(image: OmniImage, most: float) -> Picture:
    """Return (H, 4/3 W, 3) RGB of an ``image``: its colours, and beside them, a third as large, its labels,
    depth and normals. ``most`` is the depth, metres, at the end of the colour scale."""
    return beside(picture(image, "lit"), truths(image, most))


def beside(large: Picture, small: Sequence[Picture]) -> Picture:
    """Return the picture ``large`` with a column of ``small`` ones on its right, together as high."""
    height, width = large.shape[:2]
    count = len(small)
    column = np.full((height, width // count + _LINE_PX, 3), _PAPER, np.uint8)
    for number, image in enumerate(small):
        above = round(number * (height + _LINE_PX) / count)
        below = round((number + 1) * (height + _LINE_PX) / count)
        size = column.shape[1] - _LINE_PX, below - above - _LINE_PX
        column[above : below - _LINE_PX, _LINE_PX:] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.hstack([large, column])


def truths(image: OmniImage, most: float) -> tuple[Picture, Picture, Picture]:
    """Return (H, W, 3) RGB of the labels, depth and normals of an ``image``.

    ``most`` is the depth, metres, at the end of the colour scale.
    """
    return picture(image, "labels"), picture(image, "depth", most), picture(image, "normals")
