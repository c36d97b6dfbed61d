"""Normals as 16-bit RGB PNG: ``normals/STEM.png``, and ``normals/normals.json``, what the numbers mean.

Unit vectors in the camera frame (x right, y down, z forward), x in red, each component n as a number of 16
bits, by the option ``scale``:

``symmetric`` (default)
    ``32767.5 (1 + n)``: exact at both ends, half a step off at most.
``matterport``
    ``32768 (1 + n)``; n = 1, which would be 65536, is 65535, a step off.

(0, 0, 0), which is no unit vector, stands for none; ``normals.json`` counts them by frame.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import Reader, fields, one_of
from omniscv.cameras import Camera
from omniscv.compose.files import write_json, write_picture
from omniscv.frame import Frame
from omniscv.modalities import Modality
from omniscv.parallel import side_by_side

name = "normals_png"
needs = ("normals",)

SCALES = {"symmetric": 32767.5, "matterport": 32768.0}

_OPTIONS: dict[str, Reader] = {"scale": partial(one_of, words=SCALES)}
_ROW = Modality("normals", ("uint16",), 3)


def refuses(camera: Camera) -> str | None:
    """Return None: every camera has normals."""
    return None


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for a wrong option."""
    fields("", options, _OPTIONS)


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the normals of frames.

    Raises:
        ArgumentError: a frame without normals, or a wrong option.
    """
    scale = fields("", options, _OPTIONS).get("scale", "symmetric")
    folder = out / "normals"
    folder.mkdir(parents=True, exist_ok=True)

    def write_one(frame: Frame) -> tuple[Path, int]:
        pixels, none = encoded(frame.layer("normals"), SCALES[scale])
        return write_picture(folder / f"{frame.key}.png", pixels, _ROW), none

    done = side_by_side(write_one, frames)
    meaning = {
        "scale": scale, "half": SCALES[scale], "none": [0, 0, 0],
        "frame": "camera: x right, y down, z forward",
        "replaced": {frame.key: none for frame, (_, none) in zip(frames, done, strict=True)},
    }  # fmt: skip
    return [*(path for path, _ in done), write_json(folder / "normals.json", meaning)]


def encoded(normals: NDArray[np.float32], half: float) -> tuple[NDArray[np.uint16], int]:
    """Return (H, W, 3) normals as whole numbers around ``half``, and how many pixels have none."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)  # 0 or NaN where there is none
    known = length > 0
    codes = np.rint(half * (1 + np.where(known, normals, -1).astype(np.float64)))
    return np.minimum(codes, 65535).astype(np.uint16), int(np.count_nonzero(~known))
