"""The pipeline from end to end, without Unreal: serve, capture over TCP, record, compose, replay, compare."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from omniscv import cameras
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.errors import OmniscvError
from omniscv.geometry import Pose
from omniscv.progress import Meter, Report
from omniscv.sources.base import Source
from omniscv.sources.recording import record
from omniscv.sources.recording.inspection import info
from omniscv.sources.registry import open_source
from omniscv.viewing.contact_sheet import contact_sheet

MODES = ("lit", "object_mask", "depth")
ROOMS = ("four-wall", "six-wall")
POSE = Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0)
_POSES = {
    0.0: ("", POSE),
    90.0: ("-looking-up", Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0, pitch_deg=90.0)),
    -90.0: ("-looking-down", Pose.from_angles((1.4, 0.5, 1.5), yaw_deg=20.0, pitch_deg=-90.0)),
}
"""By a model's usual pitch: what captions end with, and the pose; plans are of what the others look at."""

_CENTRAL_PX, _NONCENTRAL_PX = (384, 512), (128, 192)
"""Widths of square images and of panoramas; captures of non-central cameras grow with their centres."""


def demo_cameras() -> dict[str, tuple[cameras.Camera, Pose]]:
    """Return an example of every registered model and its pose, by caption, as the contact sheet shows them.

    Mirrors hang above a camera that looks up at them, and show the ring of the room around it; central ones,
    which cost no further captures, are shown level, too.
    """
    found = {}
    for name in cameras.names():
        model = cameras.model(name)
        square, wide = _CENTRAL_PX if model.central else _NONCENTRAL_PX
        camera = model.example(square)
        camera = camera if camera.width < 2 * camera.height else model.example(wide)
        usual = model.typical_pitch_deg
        for pitch_deg in dict.fromkeys([0.0, usual] if model.central else [usual]):
            suffix, pose = _POSES[pitch_deg]
            found[name + suffix] = camera, pose
    return found


@dataclass
class DemoReport:
    """What a demo did."""

    out: Path
    sheets: list[Path] = field(default_factory=list)
    images: int = 0
    captures: int = 0
    compared: int = 0
    seconds: float = 0.0

    def lines(self) -> Iterator[str]:
        """Yield the lines to print."""
        yield f"{self.captures} captures over TCP, {self.images} images in {self.seconds:.0f} s"
        yield f"{self.compared} files recomposed from the recordings without the server: the same bytes"
        yield from (f"contact sheet: {sheet}" for sheet in self.sheets)


def run_demo(out: Path, progress: Report | None = None) -> DemoReport:
    """Serve each room, record and compose every camera in every mode, and recompose from the recording.

    Args:
        out: folder for the recordings, the images of each room, and the contact sheets.
        progress: called with how far the images have come.

    Raises:
        OmniscvError: an image recomposed from the recording differs from the one that was captured.
    """
    started = time.monotonic()
    report = DemoReport(out)
    meter = Meter(2 * len(ROOMS) * len(demo_cameras()), progress)
    for room in ROOMS:
        recording = out / f"{room}.sqlite"
        with open_source(f"mock://{room}") as live, record(live, recording) as source:
            images, files = _compose(source, out / room, meter)
            objects = source.objects()
        with TemporaryDirectory() as again, open_source(str(recording)) as replay:
            _, replayed = _compose(replay, Path(again), meter)
            report.compared += _compare(files, replayed)
        report.captures += sum(info(recording).captures.values())
        report.images += len(images) * len(MODES)
        report.sheets.append(
            contact_sheet(images, objects, out / f"{room}.png", f"omniscv: every camera in the room '{room}'")
        )
    report.seconds = time.monotonic() - started
    return report


def _compose(source: Source, out: Path, meter: Meter) -> tuple[dict[str, OmniImage], list[Path]]:
    renderer = Renderer(source)
    images: dict[str, OmniImage] = {}
    files: list[Path] = []
    for name, (camera, pose) in demo_cameras().items():
        images[name] = renderer.render(camera, pose, MODES, progress=meter.part())
        files += images[name].save(out, stem=name)
    return images, files


def _compare(captured: list[Path], replayed: list[Path]) -> int:
    """Return the number of image files that agree: all, or an error that names the first that does not."""
    pairs = [(a, b) for a, b in zip(captured, replayed, strict=True) if a.suffix != ".json"]
    for a, b in pairs:
        if a.read_bytes() != b.read_bytes():
            raise OmniscvError(f"{a}: expected the recomposed image to be the same, but its bytes differ")
    return len(pairs)
