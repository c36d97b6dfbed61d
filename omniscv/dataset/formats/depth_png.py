"""Depth as PNG of whole numbers: ``depth/STEM.png``, and ``depth/depth.json``, what the numbers mean.

The option ``scale`` names a preset (default ``mm``):

=============  ========  ===============  ==========================================================
preset         per m     none             kind
=============  ========  ===============  ==========================================================
matterport     4000      0                planar
stanford2d3d   512       65535            planar for pinholes, else along the ray
mm             1000      0                planar for pinholes, else along the ray (Structured3D, nerfstudio)
kitti          256       0                planar
tum            5000      0                planar
tof360         512       0                along the ray
shift          2^24/1000 2^24 - 1         planar; 24 bits in RGB, red the lowest
=============  ========  ===============  ==========================================================

Planar depth is measured along the camera's axis: of pinhole cameras only. A depth that the numbers cannot
hold, like no depth at all, becomes the preset's none; nothing is clamped. ``depth.json`` counts, by frame,
what became none: ``beyond`` the numbers, ``infinite``, and ``outside`` the field of view. Half a step is
rounded to even.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import fields, one_of, within
from omniscv.cameras import Camera, Pinhole
from omniscv.compose.files import write_json, write_picture
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.modalities import Modality
from omniscv.parallel import side_by_side

name = "depth_png"
needs = ("depth",)

Kind = Literal["planar", "ray"]


@dataclass(frozen=True)
class Preset:
    """How metres become whole numbers.

    Attributes:
        per_metre: steps.
        none: the number that stands for no depth.
        kind: what is measured; None: planar for pinholes, else along the ray.
        bits: of a number; 24 are three bytes, the lowest first.
    """

    per_metre: float
    none: int
    kind: Kind | None
    bits: int = 16

    def kind_of(self, camera: Camera) -> Kind:
        """Return what is measured with a camera.

        Raises:
            ArgumentError: planar depth of a camera that is no pinhole.
        """
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

_ROW = Modality("depth", ("uint16", "uint8"))


def refuses(camera: Camera) -> str | None:
    """Return None: every camera has depth along its rays, and ``scale`` has presets for it."""
    return None


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> dict[str, Kind]:
    """Return what is measured with each camera.

    Raises:
        ArgumentError: a preset of planar depth for a camera that is no pinhole, or a wrong option.
    """
    given = fields("", options, {"scale": partial(one_of, words=PRESETS)})
    preset, kinds = PRESETS[given.get("scale", "mm")], {}
    for camera_name, camera in cameras.items():
        with within(camera_name):
            kinds[camera_name] = preset.kind_of(camera)
    return kinds


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the depth of frames.

    Raises:
        ArgumentError: a frame without depth, or as :func:`check_options`.
    """
    kinds = check_options(options, {frame.camera_name: frame.camera for frame in frames})
    scale = options.get("scale", "mm")
    preset = PRESETS[scale]
    folder = out / "depth"
    folder.mkdir(parents=True, exist_ok=True)

    def write_one(frame: Frame) -> tuple[Path, dict[str, int]]:
        pixels, counts = encoded(frame.layer("depth"), frame.camera, preset)
        return write_picture(folder / f"{frame.key}.png", pixels, _ROW), counts

    done = side_by_side(write_one, frames)
    meaning = {
        "scale": scale, **asdict(preset), "kind": kinds,
        "replaced": {frame.key: counts for frame, (_, counts) in zip(frames, done, strict=True)},
    }  # fmt: skip
    return [*(path for path, _ in done), write_json(folder / "depth.json", meaning)]


def encoded(
    depth: NDArray[np.float32], camera: Camera, preset: Preset
) -> tuple[NDArray[Any], dict[str, int]]:
    """Return depth as a preset's numbers, and how many pixels became none, by the reason.

    Args:
        depth: (H, W) metres along the rays.
        camera: whose.
        preset: how.

    Returns:
        pixels, (H, W) uint16 or (H, W, 3) uint8; counts of ``beyond``, ``infinite``, ``outside``.
    """
    metres = depth.astype(np.float64)
    if preset.kind_of(camera) == "planar":
        metres *= _along_axis(camera)
    codes = np.rint(metres * preset.per_metre)
    fits = (codes >= 0) & (codes < 1 << preset.bits) & (codes != preset.none) & (depth > 0)
    codes = np.where(fits, codes, preset.none).astype(np.uint32)
    infinite, outside = np.isposinf(depth), depth == 0
    counts = {"beyond": ~fits & ~infinite & ~outside, "infinite": infinite, "outside": outside}
    pixels = codes.astype(np.uint16)
    if preset.bits == 24:
        pixels = np.stack([codes >> shift & 255 for shift in (0, 8, 16)], axis=-1).astype(np.uint8)
    return pixels, {why: int(np.count_nonzero(each)) for why, each in counts.items()}


@lru_cache(maxsize=4)
def _along_axis(camera: Camera) -> NDArray[np.float64]:
    """(H, W) the cosine between rays and the camera's axis; 0 where not valid."""
    return np.nan_to_num(camera.unproject().directions[..., 2])
