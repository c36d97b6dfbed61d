"""Pictures in files, and panoramas as six faces."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose, cube_rotations, pinhole
from omniscv.sources import codecs
from omniscv.sources.base import View

Pixels = NDArray[Any]


def read_picture(file: Path) -> Pixels:
    """Return (H, W, 3) of colours, (H, W) or (H, W, C) of others; uint8, uint16 or float32."""
    import OpenImageIO

    with within(file.name):
        if file.suffix == ".npy":
            pixels = np.load(file, allow_pickle=False)
            return np.asarray(pixels, np.float32) if pixels.dtype.kind == "f" else pixels
        source = OpenImageIO.ImageInput.open(str(file))
        if source is None:
            raise ArgumentError(f"expected a picture, got: {shown(OpenImageIO.geterror())}")
        spec = source.spec()
        if not 0 < spec.width * spec.height <= codecs.MAX_PIXELS:
            raise ArgumentError(
                f"expected at most {codecs.MAX_PIXELS} pixels, got {spec.width} x {spec.height}"
            )
        formats = {"uint8": "uint8", "uint16": "uint16"}
        pixels = source.read_image(0, 0, 0, min(spec.nchannels, 3), formats.get(str(spec.format), "float"))
        if pixels is None:
            raise ArgumentError(f"expected a picture, got: {shown(source.geterror())}")
        return pixels if pixels.shape[-1] == 3 else np.repeat(pixels[..., :1], 3, axis=-1)


def to_faces(picture: Pixels, mode: str, of_openexr: int = 0) -> list[tuple[Pixels, Array, float, bytes]]:
    """Return six faces of a panorama (H, W, 3), twice as fine as its equator: as importing.Faces has them.

    Colours are bilinear; depth along the ray is the nearest pixel's, and becomes planar (h, w).
    """
    import cv2

    height, width = picture.shape[:2]
    edge = width // 2
    wrapped = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="wrap")
    wrapped[0], wrapped[-1] = wrapped[1], wrapped[-2]  # beyond a pole, its own row
    faces = []
    for _, R_w_c in cube_rotations():
        pixels = np.stack(np.meshgrid(*[np.arange(edge) + 0.5] * 2), axis=-1)
        x, y, z = np.moveaxis(pinhole.rays(pixels, pinhole.Projection(*4 * [edge / 2])) @ R_w_c.T, -1, 0)
        u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
        v = np.arctan2(np.hypot(x, y), z) / np.pi
        # Columns: centres at +0.5; OpenEXR's first and last are the same meridian.
        u_px = u * (width - 1) if of_openexr else u * width - 0.5
        v_px = v * (height - 1) if of_openexr else v * height - 0.5
        maps = (np.float32(u_px + 1), np.float32(v_px + 1))
        filter_ = cv2.INTER_LINEAR if mode == "lit" else cv2.INTER_NEAREST
        face: Pixels = cv2.remap(wrapped, *maps, filter_)
        if mode == "depth":
            lengths = View(Pose(np.zeros(3), R_w_c), 90, edge, edge).ray_lengths()
            face = np.asarray(face[..., 0] / lengths, np.float32)
        faces.append((face, R_w_c, 90.0, b""))
    return faces
