"""Traced views of a scene, their pixels in each mode, and the plugin's bytes: PNG, BMP, NPY and EXR."""

import struct
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Projection = tuple[float, float, float, float]

LARGEST_HALF = 65504.0
"""The largest half float: depth saturates there, also the sky's."""


def pinhole_rays(
    R_w_c: Array,
    fov_deg: float,
    size: tuple[int, int],
    *,
    rows: slice = slice(None),
    projection: Projection | None = None,
) -> tuple[Array, Array]:
    """Return (H, W, 3) unit directions in the world frame, and (H, W) ray lengths per metre of depth.

    Args:
        R_w_c: (3, 3) rotation from the camera (x right, y down, z forward) to the world.
        fov_deg: horizontal field of view; without effect if a projection is given.
        size: width and height of the view, px.
        rows: those of the view for which rays are returned.
        projection: fx, fy, cx, cy in px; None for square pixels around the middle.
    """
    width, height = size
    focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
    fx, fy, cx, cy = projection or (focal, focal, width / 2, height / 2)
    x = (np.arange(width) + 0.5 - cx) / fx
    y = ((np.arange(height) + 0.5 - cy) / fy)[rows]
    length = np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    rays = np.empty((*length.shape, 3))
    for axis, (right, below, ahead) in enumerate(R_w_c):  # a short last axis is slow in NumPy
        rays[..., axis] = (x * right + (y * below)[:, None] + ahead) / length
    return rays, length


def normals(normal: Array) -> Bytes:
    """Return (H, W, 3) ``0.5 n + 0.5`` of the normals in Unreal's world axes; middle grey for the sky."""
    return np.round(255 * (0.5 + 0.5 * normal * (1, -1, 1))).astype(np.uint8)


def gray_depth(depth: Array) -> Bytes:
    """Return (H, W, 3) grey levels as the depth view mode shows planar depth (metres): 100 m is white."""
    return _gray(np.minimum(100 * depth / 10_000.0, 1.0))


def rescaled(distance: Array) -> Bytes:
    """Return (H, W, 3) grey levels of distances, white at the image's largest: for display only."""
    limited = np.minimum(distance, LARGEST_HALF)
    return _gray(limited / limited.max())


def stored(depth: Array, half: bool) -> NDArray[np.float32]:
    """Return depth as in the engine's buffers: float32; with ``half``, rounded to half floats."""
    limited = np.minimum(depth, LARGEST_HALF)
    return (limited.astype(np.float16) if half else limited).astype(np.float32)


def through_vertex_colors(colors: Bytes) -> Bytes:
    """Return vertex colours as displayed: converted to 8-bit linear light and back (reference, 5.2)."""
    linear = np.floor((colors / 255.0) ** 2.2 * 255.999)
    return np.asarray(np.round((linear / 255.0) ** (1 / 2.2) * 255), dtype=np.uint8)


def png(rgb: Bytes) -> bytes:
    """Return an 8-bit RGBA PNG, alpha 255."""
    bgra = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGRA)
    return bytes(cv2.imencode(".png", bgra, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def bmp(rgb: Bytes) -> bytes:
    """Return a 32-bit top-down BMP; the plugin repeats the byte count between header and pixels."""
    height, width = rgb.shape[:2]
    count = 4 * width * height
    header = struct.pack("<2sIHHI", b"BM", 54 + count, 0, 0, 54)
    info = struct.pack("<IiiHHIIiiII", 40, width, -height, 1, 32, 0, 0, 1024, 1024, 0, 0)
    return header + info + struct.pack("<i", count) + bytes(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGRA).tobytes())


def npy(array: NDArray[np.generic]) -> bytes:
    """Return NPY 1.0 as the plugin writes it: header a multiple of 16, 16 more where it fits exactly."""
    shape = ", ".join(map(str, array.shape))
    kind = array.dtype.str.replace("|", "<")
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}"
    text += " " * (15 - (10 + len(text)) % 16) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + array.tobytes()


def exr(rgb: NDArray[np.float32]) -> bytes:
    """Return an EXR of half floats, uncompressed, RGBA with alpha 1; one channel is repeated."""
    import OpenImageIO

    rgba = np.ones((*rgb.shape[:2], 4), dtype=np.float32)
    rgba[..., :3] = rgb
    buffer = OpenImageIO.ImageBuf(rgba)
    buffer.specmod().attribute("compression", "none")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.exr"
        buffer.write(str(path), OpenImageIO.HALF)
        return path.read_bytes()


def _gray(share: Array) -> Bytes:
    return np.repeat(np.round(255 * share).astype(np.uint8)[..., None], 3, axis=2)
