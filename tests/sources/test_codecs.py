"""Captures as bytes and back: exact for every modality, also those of other packages."""

import io
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image
from support.cases import cases

import omniscv
from omniscv import modalities
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Pose
from omniscv.sources import Capabilities, Capture, ObjectTable, Request, Source, View, codecs
from omniscv.sources.recording.store import Store

VIEW = View(Pose.from_angles((0, 0, 0)), 90.0, 7, 5)
DELIVERED = [(row, dtype) for row in modalities.layers() if row.captured for dtype in row.dtypes]


def pixels_of(row, dtype):
    channels = (row.channels,) if row.channels else ()
    least = 0 if row.interpolation == "surface" or dtype == "uint8" else -1
    most = 255 if dtype == "uint8" else np.inf if row.interpolation == "surface" else 1
    if dtype == "uint8":
        numbers = st.integers(least, most)
    else:
        numbers = st.floats(least, most, width=32, allow_nan=False, allow_infinity=most == np.inf)
    return arrays(dtype, (VIEW.height, VIEW.width, *channels), elements=numbers)


@pytest.mark.parametrize("count", [200, 5])
def test_masks_in_a_png_with_a_palette_have_its_colours(count):
    """Of few colours the library writes 4 bits."""
    colors = np.random.default_rng(1).integers(0, 256, (count, 3), np.uint8)
    indices = np.random.default_rng(2).integers(0, count, (VIEW.height, VIEW.width), np.uint8)
    picture = Image.fromarray(indices, "P")
    picture.putpalette(colors.tobytes())
    picture.save(buffer := io.BytesIO(), "PNG")
    if count == 200:
        shown = codecs.decode(buffer.getvalue(), "png", "object_mask", VIEW)
        np.testing.assert_array_equal(shown, colors[indices])
    else:
        with pytest.raises(BadReplyError, match="expected an 8-bit PNG, not interlaced, got 4-bit"):
            codecs.decode(buffer.getvalue(), "png", "object_mask", VIEW)


@pytest.mark.parametrize(("row", "dtype"), DELIVERED, ids=[f"{row.name}-{dtype}" for row, dtype in DELIVERED])
@cases(12)
@given(data=st.data())
def test_there_and_back_is_exact(row, dtype, data):
    pixels = data.draw(pixels_of(row, dtype))
    payload, encoding = codecs.encode(pixels)
    again = codecs.decode(payload, encoding, row.name, VIEW)
    assert again.dtype == pixels.dtype
    assert not again.flags.writeable
    assert again.tobytes() == pixels.tobytes()
    assert codecs.picture_size(payload) == (VIEW.width, VIEW.height)


def test_instance_ids_in_place_of_mask_colours():
    ids = np.arange(35, dtype=np.uint16).reshape(5, 7) * 1872
    again = codecs.decode(*codecs.encode(ids), "object_mask", VIEW)
    assert again.dtype == np.uint16
    assert np.array_equal(again, ids)
    with pytest.raises(BadReplyError, match="at most 65535, got 63648000"):
        codecs.decode(*codecs.encode(ids.astype(np.uint32) * 1000), "object_mask", VIEW)


@pytest.fixture
def store(tmp_path):
    with closing(Store(tmp_path / "room.sqlite", write=True)) as store:
        yield store


def test_pixels_that_do_not_fit_are_not_recorded(store):
    """Neither with bytes of whoever says that they decode."""
    for mode, pixels, says in (
        ("lit", np.zeros((5, 7), np.uint8), r"lit of uint8 or float32, shape \(5, 7, 3\); got uint8, shape"),
        ("lit", np.zeros((7, 5, 3), np.uint8), r"shape \(5, 7, 3\); got uint8, shape \(7, 5, 3\)"),
        ("depth", np.zeros((5, 7)), r"depth of float32, shape \(5, 7\); got float64"),
        ("depth", np.full((5, 7), -1, np.float32), "35 of 35 values negative or NaN"),
        ("object_mask", np.zeros((5, 7), np.int64), "object_mask of uint8"),
        ("object_mask", np.zeros((5, 7, 3), np.float32), "object_mask of uint8"),
        ("lit", np.zeros((5, 7, 4), np.uint8), "lit of uint8"),
        ("depth", np.ones((5, 7), np.uint16), "depth of float32"),
    ):
        payloads = [{}] if "negative" in says else [{}, {"payload": b"x", "encoding": "npy"}]
        for payload in payloads:
            with pytest.raises(BadReplyError, match=says):
                store.add(Capture(Request(VIEW, mode), VIEW, pixels, **payload))
        assert list(store.rows()) == []


def test_bytes_of_an_unknown_encoding_are_replaced_and_provenance_is_plain_json(store):
    """A source may decode its bytes itself; a recording needs none of it to replay."""
    pixels = np.arange(105, dtype=np.uint8).reshape(5, 7, 3)
    request = Request(VIEW, "lit")
    store.add(Capture(request, VIEW, pixels, {}, b"raw", "my own"))
    assert np.array_equal(store.get(request).pixels, pixels)
    pixels = np.zeros((5, 7, 3), np.uint8)
    with pytest.raises(ArgumentError, match=r"provenance: expected plain JSON values, got .*time"):
        store.add(Capture(Request(VIEW, "lit"), VIEW, pixels, {"time": np.float32(3)}))


def pickled():
    stream = io.BytesIO()
    np.save(stream, np.array([{}], dtype=object), allow_pickle=True)
    return stream.getvalue()


def test_wrong_bytes_are_refused():
    for payload, encoding, says in (
        (b"", "png", "expected a PNG, got 0 bytes"),
        (b"GIF89a", "png", "expected a PNG, got 6 bytes that start with b'GIF89a'"),
        (codecs.encode(np.zeros((5, 8, 3), np.uint8))[0], "png", "PNG of 7 x 5, got 8-bit 8 x 5"),
        (codecs.encode(np.zeros((5, 7, 3), np.uint8))[0][:-1], "png", "do not add up"),
        (pickled(), "npy", "expected NPY of numbers"),
        (codecs.encode(np.zeros((5, 7, 3), np.float32))[0][:-4], "npy", "420 bytes of pixels, got 416"),
        (codecs.encode(np.zeros((7, 5, 3), np.float32))[0], "npy", "5 rows, 7 columns, got float32"),
        (codecs.encode(np.zeros((5, 7, 2), np.float32))[0], "npy", "expected 3 channels of lit"),
        (b"", "pickle", "expected one of png, npy"),
    ):
        with pytest.raises(BadReplyError, match=says):
            codecs.decode(payload, encoding, "lit", VIEW)


def test_modalities_and_encodings_of_other_packages_are_recorded_exactly(tmp_path, monkeypatch):
    monkeypatch.setattr(modalities, "_TABLE", dict(modalities._TABLE))
    monkeypatch.setattr(codecs, "_codecs", dict(codecs._codecs))
    modalities.register(modalities.Modality("flow", ("float32",), 2, aliases=("motion",)))
    modalities.register(modalities.Modality("steps", ("int16",)))
    modalities.register(modalities.Modality("seen", ("bool",), 1))
    codecs.register("upside down", lambda payload, mode, view: np.load(payload)[::-1])
    assert "upside down" in codecs.encodings()
    random = np.random.default_rng(0)
    pixels = {
        "flow": random.normal(size=(5, 7, 2)).astype(np.float32),
        "steps": random.integers(-99, 99, (5, 7)).astype(np.int16),
        "seen": random.integers(0, 2, (5, 7, 1)).astype(bool),
    }

    class Mine(Source):
        capabilities = Capabilities(frozenset(pixels))

        def capture(self, requests):
            for request in requests:
                yield Capture(request, request.view, pixels[request.mode])

        def objects(self):
            return ObjectTable({})

    requests = [Request(VIEW, mode) for mode in (*pixels, "motion")]
    with omniscv.record(Mine(), tmp_path / "mine.sqlite") as source:
        list(source.capture(requests))
    with omniscv.open_source(tmp_path / "mine.sqlite") as replay:
        for capture in replay.capture(requests):
            assert capture.pixels.dtype == pixels[capture.mode].dtype
            assert np.array_equal(capture.pixels, pixels[capture.mode])
        assert replay.capabilities.modes == set(pixels)
    for address, says in (
        ("scene://four-wall", "mode: expected one of .* of a scene, got 'flow'"),
        ("captures/four-wall.sqlite", "the recording holds no flow, only depth, lit, normals, object_mask"),
    ):
        with omniscv.open_source(address) as source, pytest.raises(omniscv.OmniscvError, match=says):
            next(source.capture(requests[:1]))
