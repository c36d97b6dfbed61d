"""Layouts of rooms as HorizonNet and related programs read them; see :mod:`omniscv.truth.layout_labels`.

``horizonnet``: ``img/STEM.png`` and ``label_cor/STEM.txt``. Upright equirectangular panoramas in a room of
upright walls. Source: sunset1995/HorizonNet, README_PREPARE_DATASET.md.
"""

from collections.abc import Sequence
from pathlib import Path

from omniscv.arguments import one_of, within
from omniscv.cameras import Camera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import write_color
from omniscv.frame import Frame
from omniscv.records import checked, record
from omniscv.storage.local import write_text
from omniscv.truth import layout_labels


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
        """Write a panorama and the corners of each of ``frames`` into ``out``, as ``options`` name the form.

        ArgumentError, before anything is written: a camera that is not upright, or not in the room, or a room
        that is no prism.
        """
        texts = {}
        for frame in frames:
            with within(frame.key):
                texts[frame.key] = layout_labels.corner_lines(frame.layout, frame.camera, frame.pose)
        written = []
        for frame in frames:
            written.append(write_color(out / "img" / f"{frame.key}.{options.image_format}", frame))
            written.append(write_text(out / "label_cor" / f"{frame.key}.txt", texts[frame.key]))
        return written
