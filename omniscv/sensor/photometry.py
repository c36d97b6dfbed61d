"""The photometric files of TUM's monocular visual odometry datasets, which DSO reads.

An image is ``I = G(t V B)``: irradiance B, vignette V, exposure time t, response G.

pcalib.txt     one line of 256 increasing numbers: the inverse response, light 0 to 255 of each code
vignette.png   grey, 16 bits when written, of the image's size: the vignette, relative to its largest value
times.txt      a line for each image: its name or number, its time in seconds, its exposure in milliseconds

Source: Engel, Usenko, Cremers, A photometrically calibrated benchmark for monocular visual odometry, 2016.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.errors import ArgumentError
from omniscv.geometry.arrays import Floats
from omniscv.light import light_of_codes
from omniscv.storage import png
from omniscv.storage.bounded import library_error
from omniscv.storage.local import whole_file, write_text

RESPONSE, VIGNETTE, TIMES = "pcalib.txt", "vignette.png", "times.txt"


def write_response(path: Path, transfer: str) -> Path:
    """Write the inverse response of a transfer of :mod:`omniscv.light`, and return the path."""
    light = light_of_codes(np.arange(256), transfer)
    return write_text(path, " ".join(f"{value:.9g}" for value in 255 * light / light[-1]) + "\n")


def read_vignette(path: Path, size: tuple[int, int] | None = None) -> Floats:
    """Return the vignette (H, W), relative to its largest value.

    Args:
        path: a grey picture of 8 or 16 bits.
        size: (H, W) that it must have.

    Raises:
        ArgumentError: the file cannot be read, or is no such picture.
    """
    import OpenImageIO

    source = OpenImageIO.ImageInput.open(str(path))
    pixels = None if source is None else source.read_image(0, 0, 0, 1, "uint16")
    if pixels is None:
        raise ArgumentError(
            f"{path}: expected a grey picture of 8 or 16 bits, got: {library_error(OpenImageIO)}"
        )
    if size is not None and pixels.shape[:2] != size:
        wanted = f"expected a vignette of the image's size, {size[1]} x {size[0]}"
        raise ArgumentError(f"{path}: {wanted}, got {pixels.shape[1]} x {pixels.shape[0]}")
    return np.asarray(pixels[..., 0] / np.float32(max(1, int(pixels.max()))), np.float32)


def write_vignette(path: Path, shading: Any) -> Path:
    """Write shares of light (H, W) as 16 bits of the largest, and return the path."""
    largest = float(np.max(shading)) or 1.0
    with whole_file(path) as part:
        part.write_bytes(png.encode(np.rint(65535 * np.asarray(shading) / largest).astype(np.uint16)))
    return path


def write_times(path: Path, frames: Iterable[tuple[str, float, float]]) -> Path:
    """Write ``times.txt`` of (name, seconds, exposure in seconds), and return the path."""
    lines = [f"{name} {time:.9f} {1e3 * exposure:.9g}\n" for name, time, exposure in frames]
    return write_text(path, "".join(lines))
