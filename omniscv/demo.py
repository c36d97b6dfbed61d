"""The pipeline from end to end, without Unreal: serve, capture over TCP, record, compose, replay, compare."""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.errors import OmniscvError
from omniscv.geometry import Pose
from omniscv.planning import RenderOptions
from omniscv.progress import Meter, Report
from omniscv.sources.base import Source
from omniscv.sources.recording import record
from omniscv.sources.recording.inspection import info
from omniscv.sources.registry import open_source
from omniscv.viewing.contact_sheet import contact_sheet

MODES = ("lit", "object_mask", "depth", "normals")
ROOMS = ("four-wall", "six-wall")
_POSES = {
    0.0: Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0),
    90.0: Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0, pitch_deg=90.0),
    -90.0: Pose.from_angles((1.4, 0.5, 1.5), yaw_deg=20.0, pitch_deg=-90.0),
}
"""Camera poses by a model's usual pitch: mirrors hang above a camera that looks up, plans look down."""

_SQUARE_PX, _WIDE_PX = 256, 512
"""Widths of square images and of panoramas."""
_FACE_PX = {True: 256, False: 128}
"""Width of a 90 degree face for central cameras, and for others, which have many viewpoints."""


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
        yield from (f"contact sheet: {sheet}" for sheet in self.sheets)


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
    return DemoReport(
        tuple(sheet for room in rooms for sheet in room.sheets),
        sum(room.images for room in rooms),
        sum(room.captures for room in rooms),
        sum(room.compared for room in rooms),
        time.monotonic() - started,
    )


def _room(name: str, out: Path, meter: Meter, scale: int) -> DemoReport:
    """Capture and compose all images of a room, and compare them with those recomposed from its recording."""
    recording, images = out / f"{name}.sqlite", {}
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
        options = RenderOptions("adaptive", face_size=scale * _FACE_PX[central])
        images = renderer.render_together([*group.values()], MODES, options, progress=meter.part())
        yield from zip(group, images, strict=True)


def _compare(captured: OmniImage, replayed: OmniImage, name: str) -> int:
    """Return the number of layers; OmniscvError names the first layer that differs."""
    if list(captured.layers) != list(replayed.layers):
        raise OmniscvError(f"{name}: expected the layers {', '.join(captured.layers)} of the recording too")
    for layer, pixels in captured.layers.items():
        again = replayed.layers[layer]
        if (pixels.dtype, pixels.shape, pixels.tobytes()) != (again.dtype, again.shape, again.tobytes()):
            raise OmniscvError(
                f"{name}: expected {layer} to be the same when recomposed, but its bytes differ"
            )
    return len(captured.layers)
