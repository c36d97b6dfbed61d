"""Normals as 16-bit RGB PNG: ``normals/STEM.png``, and ``normals/normals.json``, which describes the numbers.

Unit vectors in the camera frame (x right, y down, z forward), x in red, each component n as a number of 16
bits, by the option ``scale``:

``symmetric`` (default)
    ``32767.5 (1 + n)``: exact at both ends, at most half a step off.
``matterport``
    ``32768 (1 + n)``; n = 1, which would be 65536, is 65535, a step off.

(0, 0, 0), which is no unit vector, stands for none; ``normals.json`` counts such pixels by frame.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import write_numbers
from omniscv.frame import Frame
from omniscv.records import checked, record

SCALES = {"symmetric": 32767.5, "matterport": 32768.0}


@record
class NormalsPngOptions:
    """Options of the format."""

    scale: str = checked(one_of, words=SCALES, default="symmetric", help="how numbers are scaled")


@register
class NormalsPng(Format):
    """See the module."""

    name = "normals_png"
    needs = ("normals",)
    options = NormalsPngOptions

    def write(self, frames: Sequence[Frame], out: Path, options: NormalsPngOptions) -> list[Path]:
        half = SCALES[options.scale]
        description = {
            "scale": options.scale,
            "half": half,
            "none": [0, 0, 0],
            "frame": "camera: x right, y down, z forward",
        }
        return write_numbers(
            frames, out / "normals", lambda frame: encode(frame.layer("normals"), half), description
        )


def encode(normals: NDArray[np.float32], half: float) -> tuple[NDArray[np.uint16], int]:
    """Return (H, W, 3) normals as whole numbers around ``half``, and how many pixels have none."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)  # 0 or NaN without a normal
    known = length > 0
    codes = np.rint(half * (1 + np.where(known, normals, -1).astype(np.float64)))
    return np.minimum(codes, 65535).astype(np.uint16), int(np.count_nonzero(~known))
