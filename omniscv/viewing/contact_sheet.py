"""One picture of many images, for a person to look at: colours, and smaller what is true of them."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from omniscv.compose.image import OmniImage
from omniscv.compose.pictures import colored_depth, picture
from omniscv.sources.base import Color, ObjectTable

_Picture = NDArray[np.uint8]

_INK, _FAINT, _PAPER = (28, 35, 48), (91, 100, 114), (255, 255, 255)
_LAYERS = ("lit", "labels", "depth", "normals")
_LINE = 2
"""Between pictures of one image, px."""
_WIDE = 1.8
"""Width by height from which on an image is wide: two fill the sheet, four others do."""


def contact_sheet(images: Mapping[str, OmniImage], objects: ObjectTable, path: Path, title: str) -> Path:
    """Draw images with what is true of them, under headings: panoramas, other central cameras, the rest.

    Args:
        images: caption to image; each has lit, labels, depth and normals.
        objects: for the legend of the labels.
        path: the PNG to write.
        title: printed on top.

    Returns:
        ``path``.

    Raises:
        ValueError: an image lacks a layer.
    """
    if lacking := [name for name, image in images.items() if not {*_LAYERS} <= {*image.layers}]:
        raise ValueError(f"contact_sheet: expected {', '.join(_LAYERS)}; {lacking[0]} lacks some")
    sheet = _Sheet(max(image.camera.width for image in images.values()) * 8 // 3)
    farthest = _farthest(images.values())
    sheet.heading(title, 2.2)
    sheet.note("large: colour    beside it, downwards: labels, depth, normals")
    sections: dict[str, dict[str, OmniImage]] = {}
    for name, image in images.items():
        sections.setdefault(_section(image), {})[name] = image
    for heading, mine in sorted(sections.items(), key=lambda item: list(_SECTIONS).index(item[0])):
        sheet.heading(heading, 1.3)
        sheet.grid({name: tile(image, farthest) for name, image in mine.items()}, _SECTIONS[heading])
    sheet.depth_bar(farthest)
    sheet.legend(objects, _seen(images.values()))
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


def tile(image: OmniImage, farthest: float) -> _Picture:
    """Return (H, 4/3 W, 3) RGB: the colours, and a third as large labels, depth and normals beside them."""
    return beside(picture(image, "lit"), truths(image, farthest))


def beside(large: _Picture, small: Sequence[_Picture]) -> _Picture:
    """Return a picture with others below each other on its right, so small that they are as high together."""
    height, width = large.shape[:2]
    column = np.full((height, width // len(small) + _LINE, 3), _PAPER, np.uint8)
    edges = [round(k * (height + _LINE) / len(small)) for k in range(len(small) + 1)]
    for each, above, below in zip(small, edges, edges[1:], strict=False):
        size = column.shape[1] - _LINE, below - above - _LINE
        column[above : below - _LINE, _LINE:] = cv2.resize(each, size, interpolation=cv2.INTER_AREA)
    return np.hstack([large, column])


def truths(image: OmniImage, farthest: float) -> tuple[_Picture, _Picture, _Picture]:
    """Return (H, W, 3) RGB of an image's labels, depth and normals."""
    return picture(image, "labels"), picture(image, "depth", farthest), picture(image, "normals")


def _farthest(images: Iterable[OmniImage]) -> float:
    """The depth that the colours end at: all but the last percent of what is seen."""
    seen = [depth[np.isfinite(depth) & (depth > 0)] for depth in (image["depth"] for image in images)]
    values = np.concatenate(seen)
    return float(np.ceil(np.quantile(values, 0.99))) if values.size else 1.0


def _seen(images: Iterable[OmniImage]) -> set[int]:
    return {int(label) for image in images for label in np.unique(image["labels"])}


class _Sheet:
    """A page that grows downwards.

    Args:
        width: of what is on it, px.
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
        self._block(round(2.2 * size * self._em)).text(
            (self._gap, round(1.0 * size * self._em)), text, _INK, self._font(size)
        )

    def note(self, text: str) -> None:
        """Add a line of small type."""
        self._block(2 * self._em).text((self._gap, self._em // 2), text, _FAINT, self._font())

    def grid(self, tiles: Mapping[str, _Picture], columns: int) -> None:
        """Add pictures in rows, each under its caption; larger ones are made to fit."""
        cell = (self._inner - (columns - 1) * self._gap) // columns
        drawn = list(tiles.items())
        for start in range(0, len(drawn), columns):
            row = [(name, _fitted(each, cell)) for name, each in drawn[start : start + columns]]
            caption = 2 * self._em
            block = self._block(caption + max(fitted.height for _, fitted in row) + self._gap // 2)
            for k, (name, fitted) in enumerate(row):
                left = self._gap + k * (cell + self._gap)
                block.text((left, self._em // 2), name, _INK, self._font())
                self._blocks[-1].paste(fitted, (left, caption))

    def depth_bar(self, farthest: float) -> None:
        """Add the scale of depths."""
        width, em = self._inner // 3, self._em
        block = self._block(5 * em)
        metres = np.linspace(1e-3, farthest, width, dtype=np.float32)
        bar = colored_depth(np.tile(metres, (em, 1)), farthest)
        self._blocks[-1].paste(Image.fromarray(bar), (self._gap, 2 * em))
        for k in range(5):
            left = self._gap + k * width // 4
            block.text(
                (left, 3.2 * em), f"{farthest * k / 4:g} m", _INK, self._font(), anchor="ma" if k else "la"
            )
        block.text(
            (self._gap + width + 3 * em, 2 * em), "depth along the ray; white: sky", _FAINT, self._font()
        )

    def legend(self, objects: ObjectTable, seen: set[int]) -> None:
        """Add the colours of labels, of those that are seen."""
        shown = [(name, objects.colors[name]) for name in objects.names() if objects.label(name) in seen]
        columns, em = 5, self._em
        rows = -(-len(shown) // columns)
        block = self._block(2 * em * (rows + 1))
        for k, (name, color) in enumerate(shown):
            left, top = self._gap + k // rows * self._inner // columns, 2 * em * (k % rows) + em
            _swatch(block, left, top, em, color)
            block.text((left + 2 * em, top), name, _INK, self._font())

    def picture(self) -> Image.Image:
        """Return the page."""
        page = Image.new("RGB", (self._blocks[0].width, sum(block.height for block in self._blocks)), _PAPER)
        top = 0
        for block in self._blocks:
            page.paste(block, (0, top))
            top += block.height
        return page


def _fitted(picture: _Picture, width: int) -> Image.Image:
    height = round(picture.shape[0] * width / picture.shape[1])
    return Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS)


def _swatch(block: ImageDraw.ImageDraw, left: int, top: int, size: int, color: Color) -> None:
    block.rectangle((left, top, left + size, top + size), tuple(color), outline=_FAINT)
