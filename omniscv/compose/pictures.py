"""Layers of an image as pictures for a person to look at: depth and labels in colours, all on one sheet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from omniscv import light

if TYPE_CHECKING:
    from PIL.Image import Image

    from omniscv.sources.base import ObjectTable

Picture = NDArray[np.uint8]

OUTSIDE = (230, 233, 238)
"""The colour of pixels outside the field of view."""
_INK = (28, 35, 48)
_TILE_PX = 480
_EM_PX = 13
_LEFT_PX = 8


class Layered(Protocol):
    """What is shown of an image."""

    @property
    def layers(self) -> Mapping[str, NDArray[Any]]: ...
    @property
    def valid(self) -> NDArray[np.bool_]: ...
    @property
    def objects(self) -> ObjectTable | None: ...
    @property
    def transfer(self) -> str: ...


def picture(image: Layered, layer: str, most: float | None = None) -> Picture:
    """Return (H, W, 3) uint8 RGB of a layer.

    Labels have the colours of their masks; depth goes from red (near) to blue, white is no surface; normals
    are ``127.5 (1 + n)``; marks are white where they are set.

    Args:
        image: with the layer.
        layer: its name.
        most: metres at which the colours of depth end; :func:`farthest` of the layer if not given.
    """
    values = image.layers[layer]
    if layer == "labels" and image.objects is not None:
        colors = [(0, 0, 0), *(image.objects.colors[name] for name in image.objects.names())]
        shown = np.array(colors, np.uint8)[values]
    elif layer == "normals":
        shown = np.round(127.5 * (1 + values)).astype(np.uint8)
    elif layer in ("depth", "depth_error"):
        shown = colored_depth(values, most or farthest(values[image.valid]))
    else:
        shown = _plain(values)
    return np.where(image.valid[..., None], shown, np.array(OUTSIDE, np.uint8))


def uint8_colors(colors: NDArray[Any]) -> Picture:
    """Return colours (...) as uint8: floats are light, and become sRGB; NaN becomes 0."""
    return colors if colors.dtype == np.uint8 else light.encode(colors, "srgb")


def _plain(values: NDArray[Any]) -> Picture:
    """Return RGB as uint8, and other values as grey, from black at 0 to white at the largest."""
    if values.ndim == 3 and values.shape[2] == 3:
        return uint8_colors(values)
    grey = np.where(np.isfinite(values), values, 0).astype(np.float64)
    grey = grey if grey.ndim == 2 else grey[..., 0]
    scaled = np.round(255 * grey / (grey.max() or 1)).clip(0, 255).astype(np.uint8)
    return np.repeat(scaled[..., None], 3, axis=-1)


def colored_depth(depth: NDArray[np.float32], most: float) -> Picture:
    """Return (H, W, 3) RGB of depth (H, W): red is near, blue is ``most`` metres, white no surface."""
    import cv2

    near = 1 - np.clip(np.where(np.isfinite(depth), depth, most) / most, 0, 1)
    colors = cv2.applyColorMap(np.round(255 * near).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(np.isinf(depth)[..., None], np.uint8(255), colors)


def farthest(depth: NDArray[np.float32]) -> float:
    """Return the 99 % quantile of finite depths, at which colours end; 1 without any."""
    seen = depth[np.isfinite(depth) & (depth > 0)]
    return float(np.quantile(seen, 0.99)) if seen.size else 1.0


def transfer_shown(image: Layered) -> str:
    """Return what the codes of an image's colours say of light, as :func:`picture` shows them."""
    return image.transfer if image.layers["lit"].dtype == np.uint8 else "srgb"


def resized(picture: Picture, size: tuple[int, int], transfer: str) -> Picture:
    """Return a picture (H, W, 3) at another size (width, height): the mean of light, where ``transfer`` says
    what its codes are as light."""
    import cv2
    from PIL import Image

    if light.known(transfer, picture):
        small = cv2.resize(light.decode(picture, transfer), size, interpolation=cv2.INTER_AREA)
        return light.encode(np.asarray(small, np.float32), transfer)
    return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))


def sheet(image: Layered) -> Image:
    """Return all layers of an image, each under its name: two in a row if they are wide, else three."""
    from PIL import Image

    height, width = image.valid.shape
    size = min(_TILE_PX, width), max(1, round(height * min(1, _TILE_PX / width)))
    tiles = {}
    for layer in image.layers:
        transfer = transfer_shown(image) if layer == "lit" else "unknown"
        tiles[layer] = resized(picture(image, layer), size, transfer)
    columns = 2 if width > 1.5 * height else 3
    return Image.fromarray(captioned(tiles, min(len(tiles), columns), _EM_PX))


def captioned(tiles: Mapping[str, Picture], columns: int, em: int) -> Picture:
    """Return a page of pictures in rows, each below its caption.

    Args:
        tiles: (h, w, 3) RGB by caption, all of one width.
        columns: pictures in a row.
        em: px of the type, and between pictures.
    """
    from PIL import Image, ImageDraw, ImageFont

    across = em + max(tile.shape[1] for tile in tiles.values())
    captions = list(tiles)
    rows = []
    for start in range(0, len(captions), columns):
        row = captions[start : start + columns]
        height = max(tiles[caption].shape[0] for caption in row)
        page = Image.new("RGB", (columns * across + em, 2 * em + height), "white")
        for k, caption in enumerate(row):
            left = em + k * across
            ImageDraw.Draw(page).text((left, em // 2), caption, _INK, ImageFont.load_default(em))
            page.paste(Image.fromarray(tiles[caption]), (left, 2 * em))
        rows.append(np.asarray(page))
    return np.concatenate(rows)


def line_of_text(text: str, em: int) -> Picture:
    """Return a line of ``text`` in type of ``em`` px, with room above."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(em)
    page = Image.new("RGB", (round(font.getlength(text)) + 2 * _LEFT_PX, 2 * em), "white")
    ImageDraw.Draw(page).text((_LEFT_PX, em // 2), text, _INK, font)
    return np.asarray(page)
