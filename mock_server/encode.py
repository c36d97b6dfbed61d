"""Pictures as the plugin's bytes: PNG with alpha, BMP with its four extra bytes, NPY."""

from __future__ import annotations

import struct
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def png(rgb: NDArray[np.uint8]) -> bytes:
    """8-bit RGBA PNG, alpha 255."""
    bgra = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGRA)
    return bytes(cv2.imencode(".png", bgra, _PNG)[1])


def bmp(rgb: NDArray[np.uint8]) -> bytes:
    """32-bit top-down BMP; the plugin writes the byte count once more between header and pixels."""
    height, width = rgb.shape[:2]
    count = 4 * width * height
    header = struct.pack("<2sIHHI", b"BM", 54 + count, 0, 0, 54)
    info = struct.pack("<IiiHHIIiiII", 40, width, -height, 1, 32, 0, 0, 1024, 1024, 0, 0)
    return header + info + struct.pack("<i", count) + bytes(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGRA).tobytes())


def npy(array: NDArray[np.generic]) -> bytes:
    """NPY 1.0 as the plugin writes it: header a multiple of 16, one block more when it fits exactly."""
    shape = ", ".join(map(str, array.shape))
    kind = array.dtype.str.replace("|", "<")
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}"
    padding = 16 - (10 + len(text)) % 16
    text += " " * (padding - 1) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + array.tobytes()


def exr(rgb: NDArray[np.float32]) -> bytes:
    """EXR of half floats, uncompressed, RGBA with alpha 1; one channel is repeated."""
    import OpenImageIO

    height, width = rgb.shape[:2]
    rgba = np.ones((height, width, 4), dtype=np.float32)
    rgba[..., :3] = rgb
    buffer = OpenImageIO.ImageBuf(rgba)
    buffer.specmod().attribute("compression", "none")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.exr"
        buffer.write(str(path), OpenImageIO.HALF)
        return path.read_bytes()
