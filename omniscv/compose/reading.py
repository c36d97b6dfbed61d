"""Layers read from their files, strictly: a file is a picture or an array of its layer, or an error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.arguments import within
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.modalities import Modality
from omniscv.pictures.forms import Opened, open_picture


def read(path: Path, name: str) -> NDArray[Any]:
    """Return a layer from a file that :func:`omniscv.compose.files.write` wrote, as it was in memory.

    Args:
        path: the file.
        name: the layer's row of :mod:`omniscv.modalities`.

    Raises:
        ArgumentError: the file cannot be read, or is no such layer.
    """
    row = modalities.get(name)
    with within(path), _opened(path, row) as picture:
        pixels = picture.pixels().reshape(picture.height, picture.width, -1)
    pixels = pixels if row.channels else pixels[..., 0]
    if row.mark:
        return pixels > 0
    return pixels.astype(np.float32) if row.file == "bound" else pixels


def check_header(path: Path, name: str, size: tuple[int, int]) -> None:
    """Raise ArgumentError unless a file is a picture of a layer in this width and height, px.

    Only its header is read.
    """
    with _opened(path, modalities.get(name)) as picture:
        if size != (picture.width, picture.height):
            wanted = f"expected {size[0]}x{size[1]} px, as its camera has"
            raise ArgumentError(f"{wanted}, got {picture.width}x{picture.height}")


@contextmanager
def _opened(path: Path, row: Modality) -> Iterator[Opened]:
    """Yield the open picture of a layer, whose channels and type fit it."""
    try:
        picture = open_picture(path)
        dtypes = ("uint8",) if row.mark else row.dtypes
        dtypes = ("float16", "float32") if row.file == "bound" else dtypes
        if picture.channels != (row.channels or 1) or picture.dtype not in dtypes:
            got = f"{picture.dtype} of shape {(picture.height, picture.width, picture.channels)}"
            raise ArgumentError(f"expected {' or '.join(row.dtypes)} pixels of {row.name}, got {got}")
        yield picture
    except (OSError, BadReplyError) as fault:
        raise ArgumentError(f"expected a picture of {row.name}, got: {fault}") from fault
