"""PNG files are read back by others, to the bit."""

import io

import cv2
import hypothesis.extra.numpy as arrays
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from PIL import Image

from omniscv.storage import png

sizes = st.tuples(st.integers(1, 9), st.integers(1, 9))
shapes = sizes.flatmap(lambda size: st.sampled_from((size, (*size, 1), (*size, 3), (*size, 4))))
pictures = st.sampled_from((np.uint8, np.uint16)).flatmap(lambda dtype: arrays.arrays(dtype, shapes))


@given(pictures, st.booleans())
def test_opencv_reads_the_pixels(pixels, mirrored):
    pixels = pixels[:, ::-1] if mirrored else pixels
    read = cv2.imdecode(np.frombuffer(png.encode(pixels), np.uint8), cv2.IMREAD_UNCHANGED)
    order = {3: [2, 1, 0], 4: [2, 1, 0, 3]}.get(read.shape[2] if read.ndim == 3 else 1)
    read = read[..., order] if order else read
    np.testing.assert_array_equal(read.reshape(pixels.shape), pixels, strict=True)


@given(pictures)
def test_what_is_written_is_read_back(pixels):
    payload = png.encode(pixels)
    found, depth = png.header(payload[: png.HEADER_BYTES]), 8 * pixels.itemsize
    assert (found.height, found.width, found.bits) == (*pixels.shape[:2], depth)
    read = png.decode(payload, depth)
    np.testing.assert_array_equal(read, pixels.reshape(read.shape), strict=True)
    assert read.shape[2] == found.channels


@pytest.mark.parametrize("channels", [(), (3,)])
def test_16_bits_that_opencv_wrote_are_read(channels):
    """Its rows have other filters than ours."""
    pixels = np.random.default_rng(3).integers(0, 999, (40, 50, *channels), np.uint16).cumsum(1, np.uint16)
    swapped = pixels[..., ::-1] if channels else pixels
    payload = cv2.imencode(".png", np.ascontiguousarray(swapped))[1].tobytes()
    np.testing.assert_array_equal(png.decode(payload, 16), pixels.reshape(40, 50, -1), strict=True)


@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_pillow_reads_a_large_picture(channels):
    """Larger than the window of 32 KiB, in which DEFLATE finds what it has had before."""
    pixels = np.random.default_rng(1).integers(0, 4, (300, 500, *channels), np.uint8)
    with Image.open(io.BytesIO(png.encode(pixels))) as read:
        read.verify()
    with Image.open(io.BytesIO(png.encode(pixels))) as read:
        np.testing.assert_array_equal(np.asarray(read), pixels, strict=True)


def test_the_same_pixels_make_the_same_bytes():
    pixels = np.random.default_rng(2).integers(0, 255, (64, 64, 3), np.uint8)
    assert png.encode(pixels) == png.encode(np.asfortranarray(pixels))
