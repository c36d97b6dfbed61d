"""The forms of picture files, a row for each suffix: how a file is opened and written.

Files are opened strictly: each has the form that its suffix says. :mod:`omniscv.pictures.foreign` reads
pictures that anybody may have made.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError, OmniscvError
from omniscv.modalities import SRGB, Modality
from omniscv.pictures import exr, npy, png
from omniscv.storage.bounded import MOST_PICTURE_BYTES, library_error, open_regular, read_bytes

ARRAY = "b2nd"
"""The suffix of layers in the store ``fast``."""

_NO_CLOCK = "1970:01:01 00:00:00"  # equal pixels give equal bytes, whenever they are written
_LAST_BUFFER = 1 << 16  # bytes, more than libraries buffer
_JPEG_QUALITY = 95  # 0 to 100
_JPEG_LARGEST_PX = 65500
_REC_709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
"""x and y of red, green, blue and white of floating-point colours."""
_DTYPES = {"half": "float16", "float": "float32", "double": "float64"}
"""By OpenImageIO's names; those of whole numbers are NumPy's."""

Pixels = NDArray[Any]
Writer = Callable[[Path, Pixels, Modality], None]
"""``writer(path, pixels, row)`` writes a layer (H, W) or (H, W, C) to a file."""


class Opened(NamedTuple):
    """A file of which only the header was read; ``pixels()`` reads (H, W) or (H, W, channels)."""

    width: int
    height: int
    channels: int
    dtype: str
    pixels: Callable[[], Pixels]


class Form(NamedTuple):
    """Files of a suffix.

    Attributes:
        write: None: only read.
        open: raises BadReplyError or ArgumentError for another file. None: by OpenImageIO.
        library: OpenImageIO's name of the form; it would open any other under this suffix, too.
        halves: whether bounds are half floats, else float32.
    """

    write: Writer | None = None
    open: Callable[[Path], Opened] | None = None
    library: str = ""
    halves: bool = False


def form_of(path: Path) -> Form:
    """Return the row of a file's suffix; one for OpenImageIO, if none has it."""
    return FORMS.get(path.suffix.lower().removeprefix("."), Form())


def open_picture(path: Path) -> Opened:
    """Return a file of the form of its suffix, else BadReplyError or ArgumentError; only its header is
    read."""
    form = form_of(path)
    return form.open(path) if form.open else _by_library(path, form.library)


def write_picture(path: Path, pixels: Pixels, row: Modality) -> None:
    """Write a layer to a file in the form of its suffix.

    Args:
        path: the file.
        pixels: (H, W) or (H, W, C); of bool, marks, 0 and 255 are written.
        row: of the layer: names of its channels, attributes.

    Raises:
        OmniscvError: pixels that the form does not have, or a file that cannot be written.
    """
    write = form_of(path).write
    assert write is not None, path
    try:
        write(path, pixels.view(np.uint8) * np.uint8(255) if pixels.dtype == np.bool_ else pixels, row)
    except ArgumentError as cause:
        raise OmniscvError(f"{path.name}: {cause}") from cause


def _head(path: Path, size: int) -> bytes:
    """Return the first bytes of a file."""
    with open_regular(path) as file:
        return file.read(size)


def _open_png(path: Path) -> Opened:
    """Open a PNG: only its header is read."""
    header = png.header(_head(path, png.HEADER_BYTES))

    def pixels() -> Pixels:
        return png.decode(read_bytes(path, MOST_PICTURE_BYTES), header.bits)

    return Opened(*header[:3], f"uint{header.bits}", pixels)


def _open_npy(path: Path) -> Opened:
    """Open an NPY: only its header is read."""
    shape, dtype, *_ = npy.layout(_head(path, npy.HEADER_BYTES))
    return _array(shape, dtype.name, lambda: npy.decode(read_bytes(path, MOST_PICTURE_BYTES)))


def _open_array(path: Path) -> Opened:
    """Open an array of Blosc2: only its header is read."""
    blosc2 = blosc2_package()
    data = read_bytes(path, MOST_PICTURE_BYTES)
    try:
        # Not blosc2.open, which makes other objects of files that ask for it.
        reader = blosc2.ndarray_from_cframe(data)
        shape = tuple(reader.shape)
        dtype = np.dtype(reader.dtype)
    except (RuntimeError, ValueError, TypeError, SyntaxError, MemoryError) as cause:
        raise ArgumentError(f"expected an array of Blosc2, got: {shown(str(cause))}") from cause
    # Decompressing takes memory for whole blocks of a chunk: less than twice the array on each side.
    if tuple(reader.chunks) != shape or (np.array(reader.blocks) > shape).any():
        chunks = f"{reader.chunks} in blocks of {reader.blocks}"
        raise ArgumentError(f"expected an array of {shape} in one chunk, got chunks of {chunks}")

    def pixels() -> Pixels:
        try:
            return np.asarray(reader[:])
        except (RuntimeError, ValueError, MemoryError) as cause:
            raise ArgumentError(f"expected an array of Blosc2, got: {shown(str(cause))}") from cause

    return _array(shape, dtype.name, pixels)


def _array(shape: tuple[int, ...], dtype: str, pixels: Callable[[], Pixels]) -> Opened:
    """Return an opened array; ArgumentError for one that is no picture."""
    if len(shape) not in (2, 3):
        raise ArgumentError(f"expected an array (H, W) or (H, W, C), got shape {shape}")
    return Opened(shape[1], shape[0], (*shape, 1)[2], dtype, pixels)


def _by_library(path: Path, library: str) -> Opened:
    """Open a picture by OpenImageIO, under whose name ``library`` it must be; any if that is empty."""
    import OpenImageIO

    open_regular(path).close()
    source = OpenImageIO.ImageInput.open(str(path))
    if source is None:
        raise BadReplyError(library_error(OpenImageIO))
    form = source.format_name()
    if library and form != library:
        raise ArgumentError(f"expected {path.suffix[1:].upper()}, as its name says, got {form}")

    def pixels() -> Pixels:
        read: Pixels | None = source.read_image("unknown")
        if read is None:
            raise BadReplyError(library_error(source))
        return read

    spec = source.spec()
    channels = spec.nchannels if spec.depth == 1 else 0
    return Opened(spec.width, spec.height, channels, _DTYPES.get(str(spec.format), str(spec.format)), pixels)


def encode_array(pixels: Pixels) -> bytes:
    """Return an array as the bytes of a file."""
    blosc2 = blosc2_package()
    whole = np.ascontiguousarray(pixels)
    halves = whole.dtype == np.float16  # bits of bounds: the same size in 0.4 of the time
    settings = blosc2.CParams(
        codec=blosc2.Codec.ZSTD,
        clevel=1,
        filters=[blosc2.Filter.BITSHUFFLE] if halves else [blosc2.Filter.SHUFFLE, blosc2.Filter.BYTEDELTA],
        filters_meta=[0] if halves else [0, whole.itemsize],
        nthreads=1,  # layers are written side by side
    )
    encoded: bytes = blosc2.asarray(whole, chunks=whole.shape, cparams=settings).to_cframe()
    return encoded


def blosc2_package() -> Any:
    """Return the module of Blosc2; OmniscvError if it is not installed."""
    try:
        import blosc2
    except ImportError as cause:
        raise OmniscvError("store: expected the package blosc2; pip install 'omniscv[fast]'") from cause
    return blosc2


def _write_png(path: Path, pixels: Pixels, row: Modality) -> None:
    """Write a PNG, with a tag where its colours are sRGB."""
    path.write_bytes(png.encode(pixels, srgb=SRGB.items() <= row.attributes.items()))


def _write_jpeg(path: Path, pixels: Pixels, row: Modality) -> None:
    """Write a JPEG of grey or RGB."""
    import cv2

    # Not by OpenImageIO: its library for JPEG ends the process where the disk is full.
    is_grey = pixels.ndim == 2
    is_picture = is_grey or pixels.shape[2:] == (3,)
    fits = pixels.size > 0 and max(pixels.shape) <= _JPEG_LARGEST_PX
    if pixels.dtype != np.uint8 or not is_picture or not fits:
        expected = f"expected uint8 pixels for JPEG, grey or RGB, {_JPEG_LARGEST_PX} a side at most"
        raise ArgumentError(f"{expected}; got {pixels.dtype} of shape {pixels.shape}; choose png")
    swapped = pixels if is_grey else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(".jpg", swapped, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    path.write_bytes(encoded.tobytes())


def _write_exr(path: Path, pixels: Pixels, row: Modality) -> None:
    """Write an EXR; 8-bit pixels as half floats of 0 to 1."""
    stored = (pixels / np.float32(255)).astype(np.float16) if pixels.dtype == np.uint8 else pixels
    names = row.channel_names if len(row.channel_names) == np.atleast_3d(stored).shape[2] else ()
    attributes: dict[str, Any] = dict(row.attributes)
    if row.doc:
        attributes["comments"] = row.doc
    if row.name == "lit":
        attributes["chromaticities"] = _REC_709
    path.write_bytes(exr.encode(stored, names, attributes))


def _write_tiff(path: Path, pixels: Pixels, row: Modality) -> None:
    """Write a TIFF; equal pixels give equal bytes."""
    import OpenImageIO

    planes = pixels if pixels.ndim == 3 else pixels[..., None]
    height, width, channels = planes.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, planes.dtype.name.removesuffix("32"))
    if len(row.channel_names) == channels:
        spec.channelnames = row.channel_names
    attributes: dict[str, Any] = {"DateTime": _NO_CLOCK, **row.attributes}
    if row.doc:
        attributes["ImageDescription"] = row.doc
    attributes["tiff:Predictor"] = 1  # that of floats is known to few readers
    for name, value in attributes.items():
        spec.attribute(name, value)
    output = OpenImageIO.ImageOutput.create(str(path))
    if output is None:
        raise ArgumentError(f"expected to write it, got: {library_error(OpenImageIO)}")
    written = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(planes))
    closed = output.close()
    with path.open("ab") as file:  # raises OSError where the disk is full, which the library may not say
        size = file.tell()
        file.write(bytes(_LAST_BUFFER))
        file.flush()
        file.truncate(size)
    if not (written and closed):
        raise ArgumentError(f"expected to write it, got: {library_error(output)}")


def _write_npy(path: Path, pixels: Pixels, row: Modality) -> None:
    """Write an NPY."""
    path.write_bytes(npy.encode(pixels))


def _write_array(path: Path, pixels: Pixels, row: Modality) -> None:
    """Write an array of Blosc2."""
    path.write_bytes(encode_array(pixels))


FORMS: dict[str, Form] = {
    "png": Form(_write_png, _open_png),
    "jpg": Form(_write_jpeg, library="jpeg"),
    "exr": Form(_write_exr, library="openexr", halves=True),
    "tiff": Form(_write_tiff, library="tiff"),
    "npy": Form(_write_npy, _open_npy),
    ARRAY: Form(_write_array, _open_array, halves=True),
    "jpeg": Form(library="jpeg"),
    "tif": Form(library="tiff"),
    "webp": Form(library="webp"),
    "bmp": Form(library="bmp"),
    "tga": Form(library="targa"),
    "hdr": Form(library="hdr"),
}
"""By suffix, without its dot."""
