"""The main job, once, without Unreal: serve, capture over TCP, record, compose, replay, compare, show."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mock_server
from omniscv import cameras
from omniscv.captures import open_source, record
from omniscv.captures.source import ObjectTable, Source
from omniscv.compose import Composer
from omniscv.errors import OmniscvError
from omniscv.geometry import Pose
from omniscv.output.image import OmniImage
from omniscv.output.sheet import contact_sheet
from omniscv.render import render

MODES = ("lit", "object_mask", "depth")
ROOMS = ("four-wall", "six-wall")
POSE = Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0)

_WIDE = {"width": 512, "height": 256}
_ROUND = {"width": 384, "height": 384}
_RINGS = {"width": 192, "height": 192}  # their captures grow with the rings
_EVERY_MODEL: dict[str, dict[str, Any]] = {
    "equirectangular": _WIDE,
    "cylindrical": {**_WIDE, "fov_h_deg": 360, "fov_v_deg": 120},
    "noncentral-panorama": {"width": 384, "height": 192, "radius": 1.0},
    "fisheye-equidistant": {**_ROUND, "fov_deg": 185},
    "fisheye-stereographic": {**_ROUND, "fov_deg": 220},
    "fisheye-equisolid": {**_ROUND, "fov_deg": 240},
    "fisheye-orthographic": {**_ROUND, "fov_deg": 180},
    "kannala-brandt": {
        **_ROUND, "fx": 122.0, "fy": 122.0, "cx": 192.0, "cy": 192.0,
        "k": [0.02, -0.008, 0.002, -0.0004], "fov_deg": 185,
    },
    "scaramuzza": {**_ROUND, "coefficients": [-122.0, 0.0, 0.0021, -3e-6, 1.2e-8], "fov_deg": 190},
    "catadioptric-parabolic": {**_ROUND, "semi_latus_rectum": 1.0, "focal": 150.0},
    "catadioptric-hyperbolic": {**_ROUND, "distance": 1.0, "semi_latus_rectum": 0.4},
    "catadioptric-planar": {**_ROUND, "fov_deg": 100},
    "noncentral-conical-mirror": {**_RINGS, "half_angle_deg": 55.0, "distance": 0.3},
    "noncentral-spherical-mirror": {**_RINGS, "mirror_radius": 0.3, "distance": 0.3, "fov_deg": 280},
    "pinhole": {**_ROUND, "fov_deg": 90},
}  # fmt: skip


def demo_cameras() -> dict[str, cameras.Camera]:
    """One camera of every model, as the contact sheet shows them."""
    return {name: cameras.create(name, **parameters) for name, parameters in _EVERY_MODEL.items()}


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
        """What a person wants to know of it."""
        yield f"{self.captures} captures over TCP, {self.images} images in {self.seconds:.0f} s"
        yield f"{self.compared} files recomposed from the records, the server gone: the same bytes"
        yield from (f"look at {sheet}" for sheet in self.sheets)


def run_demo(out: Path, progress: Callable[[int, int], None] | None = None) -> DemoReport:
    """Serves each room, records and composes every camera in every mode, and recomposes from the record.

    Args:
        out: folder for the records, the images of each room, and the contact sheets.
        progress: called with (images done, images in all).

    Raises:
        OmniscvError: an image recomposed from the record differs from the one that was captured.
    """
    started = time.monotonic()
    report = DemoReport(out)
    total = 2 * len(ROOMS) * len(_EVERY_MODEL)
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, total)

    for room in ROOMS:
        record_path = out / f"{room}.sqlite"
        with (
            mock_server.serve(mock_server.load_scene(room)) as server,
            open_source(server.uri) as live,
            record(live, record_path) as source,
        ):
            images, files = _compose(source, out / room, step)
            report.captures += server.statistics.total("vget /camera/")
            objects: ObjectTable = source.objects()
        with TemporaryDirectory() as again, open_source(str(record_path)) as replay:
            _, replayed = _compose(replay, Path(again), step)
            report.compared += _compare(files, replayed)
        report.images += len(images) * len(MODES)
        report.sheets.append(
            contact_sheet(images, objects, out / f"{room}.png", f"omniscv: every camera in the room '{room}'")
        )
    report.seconds = time.monotonic() - started
    return report


def _compose(source: Source, out: Path, step: Callable[[], None]) -> tuple[dict[str, OmniImage], list[Path]]:
    composer = Composer()
    images: dict[str, OmniImage] = {}
    files: list[Path] = []
    for name, camera in demo_cameras().items():
        image = render(camera, POSE, source, MODES, composer=composer)
        files += image.save(out, stem=name)
        images[name] = image
        step()
    return images, files


def _compare(captured: list[Path], replayed: list[Path]) -> int:
    """The number of image files that agree: all, or an error that names the first that does not."""
    pairs = [(a, b) for a, b in zip(captured, replayed, strict=True) if a.suffix != ".json"]
    for a, b in pairs:
        if a.read_bytes() != b.read_bytes():
            raise OmniscvError(f"{a}: expected the recomposed image to be the same, but its bytes differ")
    return len(pairs)
