"""Depth as PNG of whole numbers: ``depth/STEM.png``, and ``depth/depth.json``, which describes the numbers.

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

Planar depth is measured along the camera's axis, and exists for pinhole cameras only. Depth that the numbers
cannot hold becomes the preset's none; nothing is clamped. ``depth.json`` counts by frame what became none:
``beyond`` the numbers, ``infinite``, and ``outside`` the field of view. Half a step is rounded to even.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from omniscv.arguments import one_of, within
from omniscv.cameras import Camera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import PRESETS, Kind, encode, write_numbers
from omniscv.frame import Frame
from omniscv.records import checked, record


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
        options.kinds(cameras)

    def write(self, frames: Sequence[Frame], out: Path, options: DepthPngOptions) -> list[Path]:
        kinds = options.kinds({frame.camera_name: frame.camera for frame in frames})
        preset = PRESETS[options.scale]
        description = {"scale": options.scale, **asdict(preset), "kind": kinds}
        return write_numbers(
            frames,
            out / "depth",
            lambda frame: encode(frame.layer("depth"), frame.camera, preset),
            description,
        )
