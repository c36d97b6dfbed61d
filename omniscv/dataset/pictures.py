"""Pictures for other programs: colours, masks, and layers of the store ``fast``."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import within
from omniscv.cameras import Camera, from_dict
from omniscv.compose.files import write_layers, write_picture
from omniscv.compose.pictures import uint8_colors
from omniscv.frame import IMAGE, Frame, FrameFiles
from omniscv.frame.files import relative
from omniscv.modalities import Modality
from omniscv.pictures.forms import ARRAY
from omniscv.records import mapping
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, read_bytes
from omniscv.storage.local import whole_file

_READABLE = (".png", ".jpg", ".jpeg")
_MASK = Modality("mask", ("bool",))


def copy_lit(frame: Frame, folder: Path) -> Path:
    """Write a frame's colours into a folder as ``KEY.png``, or as the JPEG they are, and return the file."""
    lit = frame.files.get("lit")
    suffix = lit.suffix if lit is not None and lit.suffix in _READABLE else ".png"
    return write_color(folder / f"{frame.key}{suffix}", frame)


def write_color(path: Path, frame: Frame) -> Path:
    """Write the colours of a frame as the file's suffix has it, and return the path.

    The frame's file is copied if it has that suffix; floating point 0 to 1 becomes 0 to 255.
    """
    lit = frame.files.get("lit")
    if lit is None or lit.suffix != path.suffix:
        return write_pixels(path, uint8_colors(frame.layer("lit")))
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        shutil.copyfile(lit, part)
    return path


def reference(frame: Frame, kind: str, out: Path) -> str:
    """Return the name of a layer's picture as seen from a folder, or its URL.

    Args:
        frame: of a dataset.
        kind: the name of the layer.
        out: the folder. An array of the store ``fast`` is written as a picture into its ``images``.
    """
    if not isinstance(frame.files, FrameFiles):
        return relative(frame.files[kind], out)
    if not frame.files.entries[kind].path.endswith(f".{ARRAY}"):
        return frame.files.reference(kind, out)
    with within(frame.key):
        described = mapping(IMAGE, parse_json(read_bytes(frame.files[IMAGE], MOST_JSON_BYTES)))
    transfer = described.get("transfer", "unknown")
    written = write_layers(frame.layers(kind), out / "images", frame.key, transfer=transfer)
    return relative(written[kind], out)


def without_limit(camera: Camera) -> Camera:
    """Return a calibrated lens without its limit ``fov_deg``, which its mask holds; others as they are."""
    parameters = dict(camera.to_dict())
    if "fx" not in parameters or "fov_deg" not in parameters:
        return camera
    del parameters["fov_deg"]
    return from_dict(parameters)


def write_mask(valid: NDArray[np.bool_], path: Path) -> Path | None:
    """Write the mask ``valid`` (H, W) to ``path``, black where a pixel is not valid; None if all are."""
    if valid.all():
        return None
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_picture(path, np.asarray(valid), _MASK)


def write_pixels(path: Path, pixels: NDArray[Any]) -> Path:
    """Write ``pixels`` as the suffix of ``path`` says, and return the path.

    They are uint8 (H, W) or (H, W, 3), or uint16 (H, W).
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_picture(path, np.ascontiguousarray(pixels), Modality("pixels", (pixels.dtype.name,)))
