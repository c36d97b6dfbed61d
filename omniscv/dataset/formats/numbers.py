"""Depth as PNG of whole numbers: ``depth/STEM.png``, and ``depth/depth.json``, which describes the numbers.

The option ``scale`` names one of ``PRESETS``; ``mm`` is that of nerfstudio, too. Planar depth is measured
along the camera's axis, and exists for pinhole cameras only. ``depth.json`` counts by frame what became none.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of, within
from omniscv.cameras import Camera, Pinhole
from omniscv.compose.files import write_json
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.parallel import side_by_side
from omniscv.records import checked, record

Kind = Literal["planar", "ray"]


@dataclass(frozen=True)
class Preset:
    """How metres become whole numbers.

    Attributes:
        per_metre: steps.
        none: the number that stands for no depth.
        kind: along the camera's axis or along the ray; None: planar for pinholes, else along the ray.
        bits: of a number; 24 are three bytes, the lowest first.
    """

    per_metre: float
    none: int
    kind: Kind | None
    bits: int = 16

    def kind_of(self, camera: Camera) -> Kind:
        """Return the kind of depth for a camera; ArgumentError for planar depth of one that is no pinhole."""
        pinhole = isinstance(camera, Pinhole)
        if self.kind == "planar" and not pinhole:
            raise ArgumentError(
                "scale: expected a preset of depth along the ray (mm, stanford2d3d, tof360) for "
                f"{camera.name}, which has no planar depth"
            )
        return self.kind or ("planar" if pinhole else "ray")


PRESETS = {
    "matterport": Preset(4000, 0, "planar"),
    "stanford2d3d": Preset(512, 65535, None),
    "mm": Preset(1000, 0, None),
    "kitti": Preset(256, 0, "planar"),
    "tum": Preset(5000, 0, "planar"),
    "tof360": Preset(512, 0, "ray"),
    "shift": Preset(2**24 / 1000, 2**24 - 1, "planar", 24),
}


def encode(depth: NDArray[np.float32], camera: Camera, preset: Preset) -> tuple[NDArray[Any], dict[str, int]]:
    """Return ``depth`` (H, W), metres along the rays of a ``camera``, as the numbers of a ``preset``.

    Half a step is rounded to even. Nothing is clamped: a depth that the numbers cannot hold becomes none.

    Returns:
        pixels, (H, W) uint16 or (H, W, 3) uint8; counts of ``beyond`` the numbers, ``infinite``, and
        ``outside`` the field of view.
    """
    metres = depth.astype(np.float64)
    if preset.kind_of(camera) == "planar":
        metres *= _axis_cosines(camera)
    codes = np.rint(metres * preset.per_metre)
    fits = (codes >= 0) & (codes < 1 << preset.bits) & (codes != preset.none) & (depth > 0)
    codes = np.where(fits, codes, preset.none).astype(np.uint32)
    infinite = np.isposinf(depth)
    outside = depth == 0
    counts = {
        "beyond": int(np.count_nonzero(~fits & ~infinite & ~outside)),
        "infinite": int(np.count_nonzero(infinite)),
        "outside": int(np.count_nonzero(outside)),
    }
    pixels = codes.astype(np.uint16)
    if preset.bits == 24:
        pixels = np.stack([codes & 255, codes >> 8 & 255, codes >> 16 & 255], axis=-1).astype(np.uint8)
    return pixels, counts


@lru_cache(maxsize=4)
def _axis_cosines(camera: Camera) -> NDArray[np.float64]:
    """(H, W) the cosine between rays and the camera's axis; 0 where not valid."""
    return np.nan_to_num(camera.unproject().directions[..., 2])


@record
class DepthPngOptions:
    """Options of the format."""

    scale: str = checked(one_of, words=PRESETS, default="mm", help="preset of the numbers")

    def kinds(self, cameras: Mapping[str, Camera]) -> dict[str, Kind]:
        """Return the kind of depth of each camera; ArgumentError for planar depth without a plane."""
        kinds = {}
        for name, camera in cameras.items():
            with within(name):
                kinds[name] = PRESETS[self.scale].kind_of(camera)
        return kinds


@register
class DepthPng(Format):
    """See the module."""

    name = "depth_png"
    needs = ("depth",)
    options = DepthPngOptions

    def check_options(self, options: DepthPngOptions, cameras: Mapping[str, Camera]) -> None:
        """Raise ArgumentError if ``options`` name planar depth, and one of ``cameras`` has none."""
        options.kinds(cameras)

    def write(self, frames: Sequence[Frame], out: Path, options: DepthPngOptions) -> list[Path]:
        """Write the depth of each of ``frames`` into ``out/depth``, with the scale of ``options``."""
        kinds = options.kinds({frame.camera_name: frame.camera for frame in frames})
        preset = PRESETS[options.scale]

        def write(frame: Frame) -> tuple[Path, Any]:
            pixels, replaced = encode(frame.layer("depth"), frame.camera, preset)
            return write_pixels(folder / f"{frame.key}.png", pixels), replaced

        folder = out / "depth"
        folder.mkdir(parents=True, exist_ok=True)
        paths = []
        replaced = {}
        for frame, (path, counts) in zip(frames, side_by_side(write, frames), strict=True):
            paths.append(path)
            replaced[frame.key] = counts
        content = {"scale": options.scale, **asdict(preset), "kind": kinds, "replaced": replaced}
        return [*paths, write_json(folder / "depth.json", content)]
