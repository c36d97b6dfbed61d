"""PNG: what comes from servers and files is read strictly, within a bound, in silence; writing is fast.

libpng prints its complaints on the standard error, and inflates what lies behind the picture to its end: a
megabyte can stand for a gigabyte. Here nothing is inflated beyond the size in the header.

A PNG is a signature and chunks: a header, the rows as one zlib stream, and the end. Each row starts with the
number of its filter, which says what was subtracted from its bytes.
"""

import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from omniscv.compiled import njit
from omniscv.errors import ArgumentError, BadReplyError

_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""By colour type: grey, RGB, palette, grey with alpha, RGBA."""

_PALETTE = 3  # colour type
_UP = 2  # filter: the difference to the pixel above
_SPARE = 1 << 20  # bytes that a small PNG may have beyond twice its pixels: profiles, texts

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOR_TYPE = {(): 0, (1,): 0, (3,): 2, (4,): 6}
_LEVEL = 2
"""Of zlib-ng. Level 1 takes six tenths of the time, but a frame is a quarter larger."""

Pixels = NDArray[np.uint8]
HEADER_BYTES = 33
"""Of a PNG, which hold its size."""


class Header(NamedTuple):
    """Width and height, px; channels, and bits of each; whether its rows are interlaced."""

    width: int
    height: int
    channels: int
    bits: int
    interlaced: bool = False


def header(start: bytes) -> Header:
    """Return the header of a PNG, from its first ``HEADER_BYTES``.

    Raises:
        BadReplyError: no PNG.
    """
    if start[:8] != SIGNATURE or len(start) < HEADER_BYTES or start[12:16] != b"IHDR":
        beginning = f"{len(start)} bytes that start with {bytes(start[:24])!r}"
        raise BadReplyError(f"expected a PNG, got {beginning}")
    width, height, bits, kind, _, _, interlaced = struct.unpack_from(">IIBBBBB", start, 16)
    return Header(width, height, 3 if kind == _PALETTE else _CHANNELS.get(kind, 0), bits, bool(interlaced))


def decode(payload: bytes, depth: int = 8) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the pixels (H, W, C) of a PNG: grey, grey with alpha, RGB or RGBA; a palette gives RGB.

    Memory is taken for the size in the header, which the caller has checked, with the signature.

    Args:
        payload: the bytes of the file.
        depth: bits of a channel, 8 or 16.

    Raises:
        BadReplyError: another kind of PNG, a wrong checksum, or data for less or more than the picture.
    """
    width, height, bits, kind, *methods = struct.unpack_from(">IIBBBBB", payload, 16)
    if bits != depth or kind not in _CHANNELS or (kind == _PALETTE and depth != 8) or any(methods):
        other = f"{bits}-bit {width} x {height} of colour type {kind}, methods {methods}"
        wanted = "an 8-bit PNG" if depth == 8 else "a 16-bit PNG"
        raise BadReplyError(f"expected {wanted}, not interlaced, got {other}")
    step = _CHANNELS[kind] * depth // 8
    row = 1 + width * step
    if len(payload) > 2 * height * row + _SPARE:
        raise BadReplyError(f"expected a PNG of {width} x {height}, got {len(payload)} bytes")
    data, palette = _content(payload)
    rows = np.frombuffer(_inflated(data, height * row), dtype=np.uint8).reshape(height, row)
    padded = np.zeros((height + 1, step + width * step), dtype=np.uint8)
    if not _unfilter(rows, step, padded):
        raise BadReplyError("expected a PNG, got one with an unknown filter")
    pixels = padded[1:, step:].reshape(height, width, step)
    if depth == 16:
        return np.ascontiguousarray(pixels).view(">u2").astype(np.uint16)
    return _colored(pixels, palette) if kind == _PALETTE else pixels


def check(payload: bytes) -> None:
    """Raise BadReplyError for a PNG whose chunks are not whole; their data may still not decode."""
    for _ in chunks(payload):
        pass


def _content(payload: bytes) -> tuple[bytes, bytes]:
    """Return the data of the pixels, deflated, and the palette; empty if there is none."""
    names = []
    pixels = []
    palette = []
    for name, data in chunks(payload):
        if name[:1].isupper():  # a decoder must know it
            names.append(name)
        if name == b"IDAT":
            pixels.append(data)
        elif name == b"PLTE":
            palette.append(data)
    expected = [b"IHDR"]
    if palette:
        expected.append(b"PLTE")
    expected += [b"IDAT"] * len(pixels)
    expected.append(b"IEND")
    if names != expected:
        raise BadReplyError(f"expected the chunks of a PNG, got {b' '.join(names[:8])!r}")
    return b"".join(pixels), b"".join(palette)


def chunks(payload: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """Yield names and data of the chunks, which must end where the payload does."""
    view = memoryview(payload)
    at = 8  # behind the signature
    name = b""
    while name != b"IEND" and at + 12 <= len(payload):
        length, name = struct.unpack_from(">I4s", payload, at)
        end = at + 8 + length
        if end + 4 <= len(payload):
            if struct.unpack_from(">I", payload, end) != (zlib_ng.crc32(view[at + 4 : end]),):
                raise BadReplyError(f"expected a PNG, got one with a wrong checksum of its chunk {name!r}")
            yield name, view[at + 8 : end]
        at = end + 4
    if at != len(payload) or name != b"IEND":
        raise BadReplyError(f"expected a PNG, got one whose chunks do not add up to its {len(payload)} bytes")


def _inflated(data: bytes, size: int) -> bytes:
    """Return the ``size`` bytes of a zlib stream; BadReplyError for less or more, or what is none."""
    stream = zlib_ng.decompressobj()
    try:
        inflated = stream.decompress(data, size + 1)
    except zlib_ng.error as cause:  # type: ignore[misc]  # its stub says an instance
        raise BadReplyError(f"expected a PNG, got one that does not decode: {cause}") from cause
    if len(inflated) != size or not stream.eof or stream.unused_data:
        amount = "more" if len(inflated) > size or stream.unused_data else "less"
        raise BadReplyError(f"expected {size} bytes of pixels in a PNG, got {amount}")
    return inflated


def _colored(indices: Pixels, palette: bytes) -> Pixels:
    """Return the colours (H, W, 3) of indices (H, W, 1) of a palette, three bytes a colour."""
    colors = np.frombuffer(palette[: len(palette) // 3 * 3], dtype=np.uint8).reshape(-1, 3)
    if indices.max() >= len(colors):
        raise BadReplyError(f"expected colours among the {len(colors)} of the palette, got {indices.max()}")
    return np.asarray(colors[indices[..., 0]])


@njit("uint8[:, ::1], int64, out uint8[:, ::1] -> bool", nogil=True)
def _unfilter(rows: Any, step: int, padded: Any) -> bool:  # noqa: C901, PLR0912 - a kernel
    """Undo the filters of rows, whose first byte is the filter; return whether all are known.

    ``padded`` has a row of zeros above the pixels, and ``step`` columns of zeros, a pixel's, to their left.
    """
    for y in range(rows.shape[0]):
        kind, row, above, out = rows[y, 0], rows[y, 1:], padded[y], padded[y + 1]
        if kind == 0:
            for x in range(row.size):  # an assignment of slices compiles numba's text of its errors, 2 s
                out[x + step] = row[x]
        elif kind == 1:
            for x in range(row.size):
                out[x + step] = row[x] + out[x]
        elif kind == 2:
            for x in range(row.size):
                out[x + step] = row[x] + above[x + step]
        elif kind == 3:
            for x in range(row.size):
                out[x + step] = row[x] + (int(out[x]) + int(above[x + step])) // 2
        elif kind == 4:
            for x in range(row.size):
                left, up, corner = np.int32(out[x]), np.int32(above[x + step]), np.int32(above[x])
                to_left, to_up, to_corner = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
                nearest = up if to_up <= to_corner else corner
                if to_left <= to_up and to_left <= to_corner:
                    nearest = left
                out[x + step] = row[x] + nearest
        else:
            return False
    return True


def deflated(data: NDArray[np.uint8]) -> bytes:
    """Return a zlib stream, the same bytes on every machine: of PNG and of the blocks of EXR.

    Parts of a dataset are made on several machines, and one that is resumed must be as if it had not been
    stopped. Of a frame of 1920x960, 16.6 MB of rows of PNG and 11.1 MB of blocks of EXR, on one core:

    ============== ======== ====== ======== ====== ===========================================
    level          PNG, ms  MB     EXR, ms  MB     bytes
    ============== ======== ====== ======== ====== ===========================================
    zlib-ng 2      13.2     0.55   38.7     2.40   equal on six kinds of x86-64, and on ARM64
    libdeflate 1   43.1     0.52   35.3     2.35   the same
    isal 2         5.4      0.62   11.4     2.46   equal on x86-64, others on ARM64
    isal 3         31.5     0.64   26.9     2.48   others with SSE, AVX2, AVX-512, and on ARM64
    ============== ======== ====== ======== ====== ===========================================
    """
    return zlib_ng.compress(data, _LEVEL)


def encode(pixels: NDArray[np.uint8] | NDArray[np.uint16], srgb: bool = False) -> bytes:
    """Return the bytes of a PNG.

    Args:
        pixels: uint8 or uint16: grey (H, W) or (H, W, 1), RGB (H, W, 3) or RGBA (H, W, 4).
        srgb: whether the file says that they are sRGB.
    """
    kind = _COLOR_TYPE.get(pixels.shape[2:])
    if kind is None or pixels.dtype not in (np.uint8, np.uint16) or not pixels.size:
        wanted = "expected uint8 or uint16 pixels, grey, RGB or RGBA, for PNG"
        raise ArgumentError(f"{wanted}; got {pixels.dtype} of shape {pixels.shape}")
    height, width = pixels.shape[:2]
    stored = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder(">")).reshape(height, -1).view(np.uint8)
    rows = np.empty((height, 1 + stored.shape[1]), np.uint8)
    rows[:, 0] = _UP  # what lies above is mostly the same
    rows[0, 1:] = stored[0]
    np.subtract(stored[1:], stored[:-1], out=rows[1:, 1:])
    bits = 8 * pixels.itemsize
    chunks = [_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0))]
    if srgb:
        chunks.append(_chunk(b"sRGB", b"\0"))
        chunks.append(_chunk(b"gAMA", struct.pack(">I", 45455)))
    chunks.append(_chunk(b"IDAT", deflated(rows)))
    chunks.append(_chunk(b"IEND", b""))
    return SIGNATURE + b"".join(chunks)


def _chunk(name: bytes, data: bytes) -> bytes:
    """Return a chunk: the length of its data, its name, its data, and their checksum."""
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib_ng.crc32(name + data))
