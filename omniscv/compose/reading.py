"""Layers read from their files, strictly: a file is a picture or an array of its layer, or an error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.arguments import within
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.sources import codecs
from omniscv.storage import b2nd, png
from omniscv.storage.bounded import MOST_PICTURE_BYTES, library_error, read_bytes

ARRAY = "b2nd"
"""The suffix of layers in the store ``fast``."""

_FORMS = {"jpg": "jpeg", "jxl": "jpegxl", "exr": "openexr", "tiff": "tiff"}
"""Names of OpenImageIO, which would read any other form under these suffixes, too."""

_SPARE_BYTES = 1 << 20


def read(path: Path, name: str) -> NDArray[Any]:
    """Return a layer from a file that :func:`write` wrote, as it was in memory.

    Args:
        path: the file.
        name: the layer's row of :mod:`omniscv.modalities`.

    Raises:
        ArgumentError: the file cannot be read, or is no such layer.
    """
    row = modalities.get(name)
    with within(path):
        pixels = _readers.get(path.suffix, _other_pixels)(path, row)
        if row.mark:
            pixels = pixels > 0
        if row.file == "bound":
            pixels = pixels.astype(np.float32)
        if not row.fits(pixels):
            got = f"{pixels.dtype} of shape {pixels.shape}"
            raise ArgumentError(f"expected {' or '.join(row.dtypes)} pixels of {name}, got {got}")
    return pixels


def check_header(path: Path, name: str, size: tuple[int, int]) -> None:
    """Raise ArgumentError unless a file is a picture of a layer in this width and height, px.

    Only its header is read.
    """
    row = modalities.get(name)
    if path.suffix == ".png":
        header = _png_header(path, row)
        width, height = header.width, header.height
    elif path.suffix == f".{ARRAY}":
        height, width = _opened_array(path, row).shape[:2]
    elif path.suffix == ".npy":
        height, width = _npy_shape(path, row)[:2]
    else:
        spec = _opened(path, row).spec()
        width, height = spec.width, spec.height
    if size != (width, height):
        wanted = f"expected {size[0]}x{size[1]} px, as its camera has"
        raise ArgumentError(f"{wanted}, got {width}x{height}")


def _png_header(path: Path, row: modalities.Modality) -> png.Header:
    """Return the header of a layer's PNG. Not by OpenImageIO: its library prints what is wrong with a PNG."""
    try:
        with path.open("rb") as file:
            header = png.header(file.read(png.HEADER_BYTES))
    except (OSError, BadReplyError) as fault:
        raise ArgumentError(f"expected a picture of {row.name}, got: {fault}") from fault
    _check_kind(row, header.channels, f"uint{header.bits}", header.width, header.height)
    return header


def _png_pixels(path: Path, row: modalities.Modality) -> NDArray[Any]:
    header = _png_header(path, row)
    try:
        payload = read_bytes(
            path, _SPARE_BYTES + header.channels * header.bits * header.width * header.height // 4
        )
        pixels = png.decode(payload, header.bits)
    except BadReplyError as fault:
        raise ArgumentError(f"expected a picture of {row.name}, got: {fault}") from fault
    return pixels if row.channels else pixels[..., 0]


def _array_pixels(path: Path, row: modalities.Modality) -> NDArray[Any]:
    return _opened_array(path, row).pixels()


def _opened_array(path: Path, row: modalities.Modality) -> b2nd.Stored:
    """Return a layer's array, which fits its row and is not decompressed yet."""
    array = b2nd.opened(read_bytes(path, MOST_PICTURE_BYTES))
    dtypes = ("uint8",) if row.mark else ("float16",) if row.file == "bound" else row.dtypes
    channels = (row.channels,) if row.channels else ()
    if len(array.shape) != 2 + len(channels) or array.shape[2:] != channels or array.dtype not in dtypes:
        got = f"{array.dtype} of shape {array.shape}"
        raise ArgumentError(f"expected {' or '.join(dtypes)} pixels of {row.name}, got {got}")
    return array


def _npy_pixels(path: Path, row: modalities.Modality) -> NDArray[Any]:
    _npy_shape(path, row)
    try:
        return codecs.npy_array(read_bytes(path, MOST_PICTURE_BYTES))
    except BadReplyError as fault:
        raise ArgumentError(f"expected an array of {row.name}, got: {fault}") from fault


def _npy_shape(path: Path, row: modalities.Modality) -> tuple[int, ...]:
    """Return the shape in the header of a layer's NPY, which fits its row."""
    try:
        with path.open("rb") as file:
            shape, dtype, *_ = codecs.npy_layout(file.read(_SPARE_BYTES))
    except (OSError, BadReplyError) as fault:
        raise ArgumentError(f"expected an array of {row.name}, got: {fault}") from fault
    _check_kind(row, shape[2] if len(shape) == 3 else 1, dtype.name, shape[1], shape[0])
    return shape


def _other_pixels(path: Path, row: modalities.Modality) -> NDArray[Any]:
    import OpenImageIO

    pixels: NDArray[Any] | None = _opened(path, row).read_image("unknown")
    if pixels is None:
        raise ArgumentError(f"expected a picture of {row.name}, got: {library_error(OpenImageIO)}")
    return pixels if row.channels else pixels[..., 0]


def _opened(path: Path, row: modalities.Modality) -> Any:
    """Return the open picture of a layer, of which only the header was read: no pixels take memory yet."""
    import OpenImageIO

    source = OpenImageIO.ImageInput.open(str(path))
    if source is None:
        raise ArgumentError(f"expected a picture of {row.name}, got: {library_error(OpenImageIO)}")
    suffix, spec = path.suffix.removeprefix("."), source.spec()
    if (form := source.format_name()) != _FORMS.get(suffix, form):
        raise ArgumentError(f"expected {suffix.upper()}, as its name says, got {form}")
    channels = spec.nchannels if spec.depth == 1 else 0
    _check_kind(row, channels, str(spec.format), spec.width, spec.height)
    return source


def _check_kind(row: modalities.Modality, channels: int, dtype: str, width: int, height: int) -> None:
    if channels != (row.channels or 1):
        got = f"{dtype} of shape {(height, width, channels)}"
        raise ArgumentError(f"expected {' or '.join(row.dtypes)} pixels of {row.name}, got {got}")


_readers = {".png": _png_pixels, ".npy": _npy_pixels, f".{ARRAY}": _array_pixels}
"""By suffix; OpenImageIO reads the others."""
