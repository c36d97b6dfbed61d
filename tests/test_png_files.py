"""PNG: read and written as other programs do; bombs and damage are refused."""

import io
import struct
import time
import tracemalloc
import zlib
from contextlib import contextmanager

import cv2
import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from support.cases import cases

from omniscv.errors import BadReplyError
from omniscv.geometry import Pose
from omniscv.pictures import MAX_PIXELS
from omniscv.pictures import png as png_files
from omniscv.sources import View
from omniscv.sources.codecs import decode, picture_size

CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
"""By colour type."""


def view(width, height):
    return View(Pose.from_angles((0, 0, 0)), 90.0, width, height)


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(width, height, kind=6, data=b"", *, bits=8, interlaced=0, before=b"", after=b""):
    """A PNG of deflated data, with chunks before and after it."""
    header = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, interlaced)
    parts = (chunk(b"IHDR", header), before, chunk(b"IDAT", data), after, chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def rows(width, height, kind=6):
    return bytes(height * (1 + width * CHANNELS[kind]))


@cases(60)
@given(st.data(), st.sampled_from([*CHANNELS, 3]), st.integers(1, 9), st.integers(1, 7))
def test_any_colours_and_filters_are_read_as_another_reader_does(data, kind, width, height):
    row = width * CHANNELS.get(kind, 1)
    samples = st.binary(min_size=row, max_size=row)
    if kind == 3:  # indices are what is left of filtered bytes: unfiltered ones stay within the palette
        filtered = [b"\0" + bytes(data.draw(samples)) for _ in range(height)]
    else:
        filtered = [bytes([data.draw(st.integers(0, 4))]) + data.draw(samples) for _ in range(height)]
    palette = chunk(b"PLTE", bytes(range(256)) * 3) if kind == 3 else b""
    deflated = zlib.compress(b"".join(filtered))
    cut = data.draw(st.integers(0, len(deflated)))
    payload = png(width, height, kind, deflated[:cut], before=palette, after=chunk(b"IDAT", deflated[cut:]))
    with Image.open(io.BytesIO(payload)) as image:
        expected = np.asarray(image.convert("RGB"))
    assert np.array_equal(decode(payload, "png", "lit", view(width, height)), expected)


DEFLATER = zlib.compressobj(9)
START = DEFLATER.compress(bytes(1 << 20)) + DEFLATER.flush(zlib.Z_FULL_FLUSH)
MEGABYTE = DEFLATER.compress(bytes(1 << 20)) + DEFLATER.flush(zlib.Z_FULL_FLUSH)
BOMB = START + MEGABYTE * 1023 + DEFLATER.flush()
"""A gigabyte of zeros."""

GOOD = zlib.compress(rows(64, 64))


@contextmanager
def at_once():
    """Little time of the processor, and little memory."""
    tracemalloc.start()
    started = time.process_time()
    yield
    seconds = time.process_time() - started
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seconds < 1
    assert peak < 8 << 20


@pytest.mark.parametrize("size", [64, 16384])
def test_a_megabyte_that_inflates_to_a_gigabyte_is_refused_at_once(size):
    with at_once(), pytest.raises(BadReplyError, match=r"got more|picture of 1 to"):
        decode(png(size, size, data=BOMB), "png", "lit", view(64, 64))


@pytest.mark.parametrize("name", [b"iCCP", b"zTXt"])
def test_what_is_no_pixel_is_not_inflated(name):
    payload = png(64, 64, data=GOOD, before=chunk(name, b"a\0\0" + BOMB))
    with at_once():
        assert not decode(payload, "png", "lit", view(64, 64)).any()


@pytest.mark.parametrize("size", [(16384, 16384), (MAX_PIXELS + 1, 1), (0, 5), (999_999_999,) * 2])
def test_a_header_that_claims_too_many_pixels_or_none_is_refused(size):
    """Also where a server alone says how large its pictures are, as plugin 0.3.10 does."""
    array = b"{'descr': '|u1', 'fortran_order': False, 'shape': (%d, %d), }\n" % size
    for payload in (png(*size), b"\x93NUMPY\x01\0" + struct.pack("<H", len(array)) + array):
        with pytest.raises(BadReplyError, match=f"picture of 1 to {MAX_PIXELS} pixels, got"):
            picture_size(payload)


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (png(4, 3, 6, zlib.compress(rows(4, 2))), "expected 51 bytes of pixels in a PNG, got less"),
        (png(4, 3, 6, zlib.compress(rows(4, 3) + b"x")), "got more"),
        (png(4, 3, 6, zlib.compress(rows(4, 3))[:-2]), "got less"),
        (png(4, 3, 6, b"no stream"), "does not decode"),
        (png(4, 3, 6, zlib.compress(b"\x05" + rows(4, 3)[1:])), "unknown filter"),
        (png(4, 3, 5), "8-bit PNG, not interlaced, got 8-bit 4 x 3 of colour type 5"),
        (png(4, 3, 6, bits=16), "got 16-bit"),
        (png(4, 3, 6, interlaced=1), "not interlaced"),
        (png(4, 3, 6, after=png(4, 3)[8:33]), "expected the chunks of a PNG, got b'IHDR IDAT IHDR IEND'"),
        (png(4, 3, 3, zlib.compress(bytes(15))), "among the 0 of the palette"),
        (png(4, 3, 6, after=chunk(b"IDAT", b"x")).replace(b"IDATx", b"IDATy"), "wrong checksum"),
        (png(4, 3, 6, after=chunk(b"XYZW", b"")), "expected the chunks of a PNG"),
        (png(4, 3, 6, before=chunk(b"teXt", bytes(2 << 20))), "expected a PNG of 4 x 3, got 2097"),
    ],
)
def test_what_is_no_such_picture_is_refused_in_silence(payload, says, capfd):
    with pytest.raises(BadReplyError, match=says):
        decode(payload, "png", "lit", view(4, 3))
    assert capfd.readouterr() == ("", "")


sizes = st.tuples(st.integers(1, 9), st.integers(1, 9))
shapes = sizes.flatmap(lambda size: st.sampled_from((size, (*size, 1), (*size, 3), (*size, 4))))
pictures = st.sampled_from((np.uint8, np.uint16)).flatmap(lambda dtype: arrays.arrays(dtype, shapes))


@given(pictures, st.booleans())
def test_opencv_reads_the_pixels_and_so_do_we(pixels, mirrored):
    pixels = pixels[:, ::-1] if mirrored else pixels
    payload = png_files.encode(pixels)
    read = cv2.imdecode(np.frombuffer(payload, np.uint8), cv2.IMREAD_UNCHANGED)
    order = {3: [2, 1, 0], 4: [2, 1, 0, 3]}.get(read.shape[2] if read.ndim == 3 else 1)
    read = read[..., order] if order else read
    np.testing.assert_array_equal(read.reshape(pixels.shape), pixels, strict=True)
    found = png_files.header(payload[: png_files.HEADER_BYTES])
    depth = 8 * pixels.itemsize
    assert (found.height, found.width, found.bits) == (*pixels.shape[:2], depth)
    read = png_files.decode(payload, depth)
    np.testing.assert_array_equal(read, pixels.reshape(read.shape), strict=True)
    assert read.shape[2] == found.channels


@pytest.mark.parametrize("channels", [(), (3,)])
def test_16_bits_that_opencv_wrote_are_read(channels):
    pixels = np.random.default_rng(3).integers(0, 999, (40, 50, *channels), np.uint16).cumsum(1, np.uint16)
    swapped = pixels[..., ::-1] if channels else pixels
    payload = cv2.imencode(".png", np.ascontiguousarray(swapped))[1].tobytes()
    np.testing.assert_array_equal(png_files.decode(payload, 16), pixels.reshape(40, 50, -1), strict=True)


@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_pillow_reads_a_large_picture(channels):
    """Larger than the window of 32 KiB, in which DEFLATE finds what it has had before."""
    pixels = np.random.default_rng(1).integers(0, 4, (300, 500, *channels), np.uint8)
    written = io.BytesIO(png_files.encode(pixels))
    Image.open(written).verify()
    np.testing.assert_array_equal(np.asarray(Image.open(written)), pixels, strict=True)
