"""Layouts of rooms as CFL and HorizonNet read them; see :mod:`omniscv.truth.layout_labels`.

``cfl``: ``RGB/STEM.jpg``, ``EM_gt/STEM_EM.jpg`` of edges, ``CM_gt/STEM_CM.jpg`` of corners. CFL pairs the
files by their order. Source: cfernandezlab/CFL, test_CFL.py.

``horizonnet``, which related programs read too: ``img/STEM.png`` and ``label_cor/STEM.txt``. Upright
equirectangular panoramas in a room of upright walls. Source: sunset1995/HorizonNet,
README_PREPARE_DATASET.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from omniscv.arguments import one_of, within
from omniscv.cameras import Camera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import write_color, write_pixels
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.records import checked, record
from omniscv.render_options import MapOptions
from omniscv.storage.local import write_text
from omniscv.truth import layout_labels
from omniscv.truth.layout_labels import exact_maps, original_maps


@record
class CflOptions(MapOptions):
    """Options of the format, with those of exact maps.

    Raises:
        ArgumentError: an option of exact maps for the original recipe.
    """

    image_format: str = checked(
        one_of,
        words=("jpg", "png"),
        default="jpg",
        help="jpg, the only one that CFL reads, or png, which is exact",
    )
    recipe: str = checked(one_of, words=("exact", "original"), default="exact", help="exact or original maps")

    def __post_init__(self) -> None:
        if self.recipe == "original" and (maps := self.maps()):
            raise ArgumentError(
                "recipe: expected the original recipe, which has its own numbers, without others; got "
                f"{', '.join(maps)}"
            )

    def maps(self) -> dict[str, Any]:
        """Return the options of exact maps that are given."""
        values = {option.name: getattr(self, option.name) for option in fields(MapOptions)}
        return {name: value for name, value in values.items() if value is not None}


@register
class Cfl(Format):
    """See the module."""

    name = "cfl"
    needs = ("layout", "lit")
    options = CflOptions

    def write(self, frames: Sequence[Frame], out: Path, options: CflOptions) -> list[Path]:
        """Write frames; ArgumentError for an image that the original recipe has no maps for."""
        suffix, maps, written = options.image_format, options.maps(), []
        for frame in frames:
            with within(frame.key):
                if options.recipe == "original":
                    edges, corners = original_maps(frame.layout, frame.camera, frame.pose)
                else:
                    edges, corners = exact_maps(frame.layout, frame.camera, **maps)
            written.append(write_color(out / "RGB" / f"{frame.key}.{suffix}", frame))
            written.append(write_pixels(out / "EM_gt" / f"{frame.key}_EM.{suffix}", edges))
            written.append(write_pixels(out / "CM_gt" / f"{frame.key}_CM.{suffix}", corners))
        return written


@record
class HorizonNetOptions:
    """Options of the format."""

    image_format: str = checked(one_of, words=("png", "jpg"), default="png", help="of panoramas: png or jpg")


@register
class HorizonNet(Format):
    """See the module."""

    name = "horizonnet"
    needs = ("layout", "lit")
    options = HorizonNetOptions

    def refuses(self, camera: Camera) -> str | None:
        return layout_labels.refuses(camera)

    def write(self, frames: Sequence[Frame], out: Path, options: HorizonNetOptions) -> list[Path]:
        """Write frames; ArgumentError for a camera that is not upright or not in the room, or a room that is
        no prism, before anything is written."""
        texts = {}
        for frame in frames:
            with within(frame.key):
                texts[frame.key] = layout_labels.corner_lines(frame.layout, frame.camera, frame.pose)
        written = []
        for frame in frames:
            written.append(write_color(out / "img" / f"{frame.key}.{options.image_format}", frame))
            written.append(write_text(out / "label_cor" / f"{frame.key}.txt", texts[frame.key]))
        return written
