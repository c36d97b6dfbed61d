"""One picture of many images: their colours, and smaller their labels, depth and normals."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from omniscv.compose.image import OmniImage
from omniscv.compose.pictures import (
    Picture,
    captioned,
    colored_depth,
    farthest,
    line_of_text,
    picture,
    resized,
    transfer_shown,
)
from omniscv.sources.base import ObjectTable

_PAPER = (255, 255, 255)
_LINE_PX = 2  # between pictures of one image
_WIDE = 1.8  # width by height of wide images
_SECTIONS = {
    "Panoramas": 2,
    "One optical centre: lenses, cube maps, mirrors seen from below": 4,
    "Many optical centres": 4,
}
"""Heading to the number of images in a row."""


def contact_sheet(images: Mapping[str, OmniImage], objects: ObjectTable, path: Path, title: str) -> Path:
    """Draw images with their truths, under headings: panoramas, other central cameras, non-central cameras.

    Args:
        images: caption to image; each has lit, labels, depth and normals.
        objects: for the legend of the labels.
        path: the PNG to write.
        title: printed on top.

    Returns:
        ``path``.

    Raises:
        ArgumentError: an image lacks a layer.
    """
    width = max(image.camera.width for image in images.values()) * 8 // 3
    em = max(8, width // 95)
    most = float(np.ceil(farthest(np.concatenate([image["depth"].ravel() for image in images.values()]))))
    blocks = [
        line_of_text(title, round(2.2 * em)),
        line_of_text("large: colour    beside it, downwards: labels, depth, normals", em),
    ]
    for heading, columns in _SECTIONS.items():
        cell = (width - (columns - 1) * em) // columns
        section = {name: image for name, image in images.items() if _section(image) == heading}
        tiles = {name: _scaled(tile(image, most), cell, image) for name, image in section.items()}
        if tiles:
            blocks += [line_of_text(heading, round(1.3 * em)), captioned(tiles, columns, em)]
    metres = np.linspace(1e-3, most, width // 2, dtype=np.float32)
    bar = colored_depth(np.tile(metres, (em, 1)), most)
    blocks.append(captioned({f"depth along the ray, 0 to {most:g} m; white: sky": bar}, 1, em))
    seen = {int(label) for image in images.values() for label in np.unique(image["labels"])}
    legend = {
        name: np.full((em, width // 6, 3), objects.colors[name], np.uint8)
        for name in objects.names()
        if objects.label(name) in seen
    }
    blocks.append(captioned(legend, 5, em))
    widest = max(block.shape[1] for block in blocks)
    padding = [((0, 0), (0, widest - block.shape[1]), (0, 0)) for block in blocks]
    page = [np.pad(block, pad, constant_values=255) for block, pad in zip(blocks, padding, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(page)).save(path, compress_level=3)
    return path


def _section(image: OmniImage) -> str:
    wide, one, many = _SECTIONS
    if image.camera.width >= _WIDE * image.camera.height:
        return wide
    return one if image.camera.central else many


def tile(image: OmniImage, most: float) -> Picture:
    """Return (H, 4/3 W, 3) RGB: the colours, and beside them, a third as large, labels, depth and normals."""
    return beside(picture(image, "lit"), truths(image, most))


def beside(large: Picture, small: Sequence[Picture]) -> Picture:
    """Return a picture with a column of others on its right, scaled to the same height together."""
    height, width = large.shape[:2]
    column = np.full((height, width // len(small) + _LINE_PX, 3), _PAPER, np.uint8)
    edges = [round(k * (height + _LINE_PX) / len(small)) for k in range(len(small) + 1)]
    for image, above, below in zip(small, edges, edges[1:], strict=False):
        size = column.shape[1] - _LINE_PX, below - above - _LINE_PX
        column[above : below - _LINE_PX, _LINE_PX:] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.hstack([large, column])


def truths(image: OmniImage, most: float) -> tuple[Picture, Picture, Picture]:
    """Return (H, W, 3) RGB of an image's labels, depth and normals."""
    return picture(image, "labels"), picture(image, "depth", most), picture(image, "normals")


def _scaled(pixels: Picture, width: int, image: OmniImage) -> Picture:
    """Return a picture of an image at another width."""
    height = round(pixels.shape[0] * width / pixels.shape[1])
    return resized(pixels, (width, height), transfer_shown(image))
