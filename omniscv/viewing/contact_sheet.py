"""One picture of many images: their colours, and smaller their labels, depth and normals."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from omniscv.compose.image import OmniImage
from omniscv.compose.pictures import colored_depth, farthest, picture, resized, transfer_shown
from omniscv.sources.base import ObjectTable

_Picture = NDArray[np.uint8]

_INK, _FAINT, _PAPER = (28, 35, 48), (91, 100, 114), (255, 255, 255)
_LINE = 2  # px between pictures of one image
_WIDE = 1.8  # width by height of wide images: two in a row, others four


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
    sheet = _Sheet(max(image.camera.width for image in images.values()) * 8 // 3)
    most = _farthest(images.values())
    sheet.heading(title, 2.2)
    sheet.note("large: colour    beside it, downwards: labels, depth, normals")
    sections: dict[str, dict[str, OmniImage]] = {}
    for name, image in images.items():
        sections.setdefault(_section(image), {})[name] = image
    for heading, columns in _SECTIONS.items():
        if heading in sections:
            sheet.heading(heading, 1.3)
            tiles = {name: tile(image, most) for name, image in sections[heading].items()}
            sheet.grid(tiles, columns, transfer_shown(next(iter(images.values()))))
    sheet.depth_bar(most)
    sheet.legend(objects, {int(label) for image in images.values() for label in np.unique(image["labels"])})
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.picture().save(path, compress_level=3)
    return path


_SECTIONS = {
    "Panoramas": 2,
    "One optical centre: lenses, cube maps, mirrors seen from below": 4,
    "Many optical centres": 4,
}
"""Heading to the number of images in a row."""


def _section(image: OmniImage) -> str:
    wide, one, many = _SECTIONS
    if image.camera.width >= _WIDE * image.camera.height:
        return wide
    return one if image.camera.central else many


def tile(image: OmniImage, most: float) -> _Picture:
    """Return (H, 4/3 W, 3) RGB: the colours, and beside them, a third as large, labels, depth and normals."""
    return beside(picture(image, "lit"), truths(image, most))


def beside(large: _Picture, small: Sequence[_Picture]) -> _Picture:
    """Return a picture with a column of others on its right, scaled to the same height together."""
    height, width = large.shape[:2]
    column = np.full((height, width // len(small) + _LINE, 3), _PAPER, np.uint8)
    edges = [round(k * (height + _LINE) / len(small)) for k in range(len(small) + 1)]
    for image, above, below in zip(small, edges, edges[1:], strict=False):
        size = column.shape[1] - _LINE, below - above - _LINE
        column[above : below - _LINE, _LINE:] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.hstack([large, column])


def truths(image: OmniImage, most: float) -> tuple[_Picture, _Picture, _Picture]:
    """Return (H, W, 3) RGB of an image's labels, depth and normals."""
    return picture(image, "labels"), picture(image, "depth", most), picture(image, "normals")


def _farthest(images: Iterable[OmniImage]) -> float:
    """Return where the colours of depth end, in whole metres."""
    return float(np.ceil(farthest(np.concatenate([image["depth"].ravel() for image in images]))))


class _Sheet:
    """A page of blocks, one below the other.

    Args:
        width: of its content, px.
    """

    def __init__(self, width: int) -> None:
        self._em = max(8, width // 95)
        self._gap, self._inner = self._em, width
        self._blocks: list[Image.Image] = []

    def _block(self, height: int) -> ImageDraw.ImageDraw:
        block = Image.new("RGB", (self._inner + 2 * self._gap, height), _PAPER)
        self._blocks.append(block)
        return ImageDraw.Draw(block)

    def _font(self, size: float = 1.0) -> Any:
        return ImageFont.load_default(round(size * self._em))

    def heading(self, text: str, size: float) -> None:
        """Add a line of large type, with room above."""
        block = self._block(round(2.2 * size * self._em))
        block.text((self._gap, round(size * self._em)), text, _INK, self._font(size))

    def note(self, text: str) -> None:
        """Add a line of small type."""
        self._block(2 * self._em).text((self._gap, self._em // 2), text, _FAINT, self._font())

    def grid(self, tiles: Mapping[str, _Picture], columns: int, transfer: str) -> None:
        """Add pictures in rows, each below its caption, scaled to the columns as their transfer asks for."""
        cell = (self._inner - (columns - 1) * self._gap) // columns
        scaled = [(name, _scaled(pixels, cell, transfer)) for name, pixels in tiles.items()]
        for start in range(0, len(scaled), columns):
            row, caption = scaled[start : start + columns], 2 * self._em
            block = self._block(caption + max(image.height for _, image in row) + self._gap // 2)
            for k, (name, image) in enumerate(row):
                left = self._gap + k * (cell + self._gap)
                block.text((left, self._em // 2), name, _INK, self._font())
                self._blocks[-1].paste(image, (left, caption))

    def depth_bar(self, most: float) -> None:
        """Add the scale of depths, up to ``most`` metres."""
        width, em = self._inner // 3, self._em
        block = self._block(5 * em)
        metres = np.linspace(1e-3, most, width, dtype=np.float32)
        bar = colored_depth(np.tile(metres, (em, 1)), most)
        self._blocks[-1].paste(Image.fromarray(bar), (self._gap, 2 * em))
        for k in range(5):
            left = self._gap + k * width // 4
            anchor = "ma" if k else "la"
            block.text((left, 3.2 * em), f"{most * k / 4:g} m", _INK, self._font(), anchor=anchor)
        note = self._gap + width + 3 * em, 2 * em
        block.text(note, "depth along the ray; white: sky", _FAINT, self._font())

    def legend(self, objects: ObjectTable, seen: set[int]) -> None:
        """Add the colours of the labels that are seen."""
        shown = [(name, objects.colors[name]) for name in objects.names() if objects.label(name) in seen]
        columns, em = 5, self._em
        rows = -(-len(shown) // columns)
        block = self._block(2 * em * (rows + 1))
        for k, (name, color) in enumerate(shown):
            left, top = self._gap + k // rows * self._inner // columns, 2 * em * (k % rows) + em
            block.rectangle((left, top, left + em, top + em), tuple(color), outline=_FAINT)
            block.text((left + 2 * em, top), name, _INK, self._font())

    def picture(self) -> Image.Image:
        """Return the page."""
        page = Image.new("RGB", (self._blocks[0].width, sum(block.height for block in self._blocks)), _PAPER)
        top = 0
        for block in self._blocks:
            page.paste(block, (0, top))
            top += block.height
        return page


def _scaled(pixels: _Picture, width: int, transfer: str) -> Image.Image:
    height = round(pixels.shape[0] * width / pixels.shape[1])
    return Image.fromarray(resized(pixels, (width, height), transfer))
