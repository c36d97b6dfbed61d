"""Pictures that people have: what the gate lets in is what other readers see, all else is one line."""

import io
import os
import warnings

import cv2
import numpy as np
import OpenImageIO
import pytest
from PIL import Image
from support.pictured import run

from omniscv.errors import ArgumentError
from omniscv.sources.pictures import DepthForm, read_picture

COLORS = np.random.default_rng(7).integers(0, 256, (12, 24, 3), np.uint8)


def exr(path, channels, **spec):
    pixels = np.stack([*channels.values()], axis=-1).astype(np.float32)
    described = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], "float")
    described.channelnames = tuple(channels)
    for key, value in spec.items():
        setattr(described, key, value)
    file = OpenImageIO.ImageOutput.create(str(path))
    assert file.open(str(path), described)
    assert file.write_image(pixels)
    file.close()


def encoded(suffix):
    if suffix in ("npy", "hdr", "png16"):
        floats = COLORS.astype(np.float32) / 99
        wide = COLORS.astype(np.uint16) * 257
        pixels = {"npy": COLORS, "hdr": floats, "png16": wide}
        if suffix != "npy":
            return cv2.imencode("." + suffix[:3], pixels[suffix])[1].tobytes()
        np.save(buffer := io.BytesIO(), COLORS)
        return buffer.getvalue()
    buffer = io.BytesIO()
    lossless = {"lossless": True} if suffix == "webp" else {}
    Image.fromarray(COLORS).save(buffer, suffix.replace("tga", "TGA"), **lossless)
    return buffer.getvalue()


def judged(data, suffix):
    """Pixels (H, W, 3) as Pillow, OpenCV or NumPy reads them."""
    if suffix == "npy":
        pixels = np.load(io.BytesIO(data), allow_pickle=False)
        colors = pixels.reshape(*pixels.shape[:2], -1)[..., :3]
        return np.repeat(colors, 1 if pixels.shape[2:] > (1,) else 3, axis=2)
    if suffix in ("hdr", "png16"):
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)[..., 2::-1]
    with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB"))


def changed(data, suffix, draw):
    """Bytes with one thing changed: a byte, the length, or the type, shape or order of an array."""
    way = draw.integers(0, 5 if suffix == "npy" else 3)
    at = int(draw.integers(0, len(data)))
    if way == 0:
        return data[:at] + bytes([data[at] ^ (1 << draw.integers(0, 8))]) + data[at + 1 :]
    if way in (1, 2):
        return data[:at] if way == 1 else data[:at] + bytes(draw.integers(0, 256, 3, np.uint8)) + data[at:]
    kind = draw.choice(["?", "i8", "u4", ">u2", ">f8", "c8", "f2", "O", "S3"])
    pixels = np.where(COLORS > 127, COLORS, 9).astype(kind if way == 3 else "u1")
    order = (np.asarray, np.asfortranarray, lambda a: a.transpose(2, 0, 1), lambda a: a[0, 0],
             lambda a: a[..., :2])  # fmt: skip
    np.save(buffer := io.BytesIO(), order[draw.integers(0, 5)](pixels))
    return buffer.getvalue()


def check_changed(count, seed, folder):
    draw = np.random.default_rng(seed)
    wrong = []
    taken = 0
    suffixes = ["png", "png16", "jpeg", "webp", "bmp", "tga", "tiff", "hdr", "npy"]
    valid = {suffix: encoded(suffix) for suffix in suffixes}
    for i in range(count):
        suffix = suffixes[i % len(suffixes)]
        data = changed(valid[suffix], suffix, draw)
        file = folder / f"a.{suffix[:3] if suffix == 'png16' else suffix}"
        file.write_bytes(data)
        try:
            pixels = read_picture(file).pixels
        except ArgumentError:  # of one line, as all of these are
            continue
        taken += 1
        try:
            judge = judged(data, suffix)
            same = pixels.shape == judge.shape and np.abs(pixels - judge.astype(np.float64)).max() <= 2
        except Exception as fault:
            judge = fault
            same = np.array_equal(pixels, judged(valid[suffix], suffix))
        if not same:
            wrong.append((i, suffix, judge if isinstance(judge, Exception) else np.shape(judge)))
    assert not wrong, wrong[:5]
    assert taken > count / 20


@pytest.mark.parametrize("count", [300, pytest.param(20_000, marks=pytest.mark.soak)])
def test_what_is_changed_at_random_is_right_or_one_line(count, tmp_path):
    check_changed(count, 1, tmp_path)


def saved(name, pixels, **kw):
    """A function that saves a picture in a folder, and returns its name; ``bits``: of a palette."""

    def make(folder):
        image = Image.fromarray(pixels)
        (image.quantize(16) if "bits" in kw else image).save(folder / name, **kw)
        return name

    return make


def array(pixels):
    return lambda folder: (np.save(folder / "a.npy", pixels), "a.npy")[1]


def written(name, **kw):
    return lambda folder: (exr(folder / name, **kw), name)[1]


def doubles(folder):
    """A TIFF of depth in numbers of 64 bits."""
    spec = OpenImageIO.ImageSpec(16, 8, 1, "double")
    output = OpenImageIO.ImageOutput.create(str(folder / "d.tif"))
    assert output.open(str(folder / "d.tif"), spec)
    assert output.write_image(np.full((8, 16, 1), 2.003, np.float64))
    output.close()
    return "d.tif"


def progressive(scans, more=0):
    """A progressive JPEG of its first scans, and some bytes of the next one, with an end marker."""

    def make(folder):
        Image.fromarray(COLORS).save(buffer := io.BytesIO(), "JPEG", progressive=True)
        parts = buffer.getvalue().split(b"\xff\xda")
        data = b"\xff\xda".join(parts[: scans + 1 + bool(more)])
        (folder / "p.jpg").write_bytes(data[: len(data) - more or None] + b"\xff\xd9")
        return "p.jpg"

    return make


RGB = dict(zip("RGB", np.ones((3, 8, 16)), strict=True))
BAD = RGB | {"G": np.where(np.eye(8, 16), np.nan, -1)}
TURNED = Image.Exif()
TURNED[0x0112] = 6
MM = DepthForm.parse("planar-mm")
DEPTH16 = np.full((8, 16), 2003, np.uint16)
REFUSED = [
    ("lit", lambda folder: (os.mkfifo(folder / "a.png"), "a.png")[1], "expected a regular file"),
    ("lit", written("z.exr", channels={"Z": np.ones((8, 16))}), "one part with channels R, G, B, got 0"),
    ("lit", written("w.exr", channels=RGB, full_width=32), "all of the display window"),
    ("lit", written("n.exr", channels=BAD), "got 128 of 384 other values; --clip"),
    ("lit", array(np.full((4, 4, 3), 1e300)), "got 48 of 48 other values"),
    ("lit", saved("e.jpg", COLORS, exif=TURNED), "an orientation in its EXIF"),
    ("lit", lambda folder: (Image.new("CMYK", (8, 8)).save(folder / "c.jpg"), "c.jpg")[1], "got CMYK"),
    ("lit", saved("a.webp", COLORS, save_all=True, append_images=[Image.new("RGB", (24, 12))]), "frames"),
    ("lit", progressive(2), "a progressive JPEG without its last scans"),
    ("lit", progressive(2, 40), "without its last scans|premature end"),
    ("lit", array(np.full((4, 4, 3), 70000, np.uint32)), "of 0 to 255, got uint32 of 70000"),
    ("lit", array(np.zeros(5)), "expected NPY of numbers"),
    ("lit", array(np.zeros((0, 4, 3))), "expected 1 to 134217728 pixels, got 4 x 0"),
    ("lit", array(np.zeros((4, 4, 3), bool)), "got bool of shape"),
    ("object_mask", saved("m.jpg", COLORS), "without loss, as PNG, got lossy jpeg"),
    ("object_mask", saved("m.webp", COLORS), "got lossy webp"),
    ("object_mask", lambda folder: (Image.new("1", (8, 8)).save(folder / "m.png"), "m.png")[1], "got 1,"),
    ("object_mask", array(np.ones((4, 4), np.float32)), "whole numbers of 0 to 65535, got float32"),
    ("depth", saved("d.png", DEPTH16), "the unit of whole numbers, such as --depth planar-mm"),
    ("depth", saved("d.png", COLORS), "got uint8 colours, which are no metres"),
    ("depth", array(np.full((4, 4), 1j)), "expected NPY of numbers, got the header"),
    ("depth", array(np.full((4, 4), -2.0)), "such as -2 m; if that is no surface, --missing -2"),
    ("normals", saved("n.png", COLORS), "normals, whose frame is not known"),
]


@pytest.mark.parametrize(("kind", "make", "says"), REFUSED, ids=[says for *_, says in REFUSED])
def test_what_cannot_be_right_is_refused(kind, make, says, tmp_path):
    with pytest.raises(ArgumentError, match=says):
        read_picture(tmp_path / make(tmp_path), kind)


RGBA = np.dstack([COLORS, np.zeros((12, 24), np.uint8)])
GREY = np.repeat(COLORS[..., :1], 3, axis=-1)
FAR = [0, 2, np.nan, np.inf, -np.inf, 65504, 1e10]  # Habitat, ROS, half floats, Blender
FULL = np.where(np.arange(16) == 3, 65535, DEPTH16).astype(np.uint16)
RARE = np.full((240, 320), 2003, np.uint16)
RARE[:5, :10] = 65535
CARLA = np.array([[[255, 255, 255], [254, 255, 255]]], np.uint8)
LAYERS = {f"View.Combined.{c}": plane for c, plane in RGB.items()} | {"View.Depth.Z": np.full((8, 16), 3.0)}
TAKEN = [
    ("lit", saved("a.png", RGBA), None, COLORS),
    ("lit", saved("a.tga", RGBA), None, COLORS),
    ("lit", saved("a.tif", RGBA), None, COLORS),
    ("lit", saved("a.webp", RGBA, lossless=True, exact=True), None, COLORS),
    ("lit", saved("a.bmp", COLORS), None, COLORS),
    ("lit", saved("a.png", COLORS[..., 0]), None, GREY),
    ("lit", saved("p.png", GREY, bits=4), None, None),
    ("lit", saved("a.png", DEPTH16), None, np.full((8, 16, 3), 2003)),
    ("lit", array(np.asfortranarray(COLORS.astype(np.int64))), None, COLORS),
    ("lit", written("m.exr", channels=LAYERS), None, np.ones((8, 16, 3))),
    ("depth", written("m.exr", channels=LAYERS), None, np.full((8, 16), 3.0)),
    ("depth", saved("d.png", DEPTH16), MM, np.full((8, 16), 2003 / np.float32(1000))),
    ("depth", saved("d.png", DEPTH16), DepthForm.parse("ray-1/512", (2003,)), np.full((8, 16), np.inf)),
    ("depth", doubles, None, np.full((8, 16), 2.003)),
    ("depth", array(np.array([FAR, FAR[::-1]])), None, np.where(np.array([FAR, FAR[::-1]]) == 2, 2, np.inf)),
    ("depth", array(np.array([FAR[:6]], "f2")), None, np.where(np.array([FAR[:6]]) == 2, 2, np.inf)),
    ("depth", array(np.full((2, 2), 70000.0)), MM, np.full((2, 2), 70)),
    ("depth", saved("d.png", FULL), MM, np.where(FULL == 65535, np.inf, np.float32(2.003))),
    ("depth", saved("d.png", RARE), MM, np.where(RARE == 65535, np.inf, np.float32(2.003))),
    ("depth", saved("d.png", FULL), DepthForm.parse("planar-mm", (0,)), FULL / np.float32(1000)),
    ("depth", array(np.array([[32767, 2003]], np.int16)), MM, np.array([[np.inf, np.float32(2.003)]])),
    (
        "depth",
        saved("d.png", CARLA),
        DepthForm.parse("carla"),
        np.array([[np.inf, 1000 - 1000 / (2**24 - 1)]]),
    ),
    ("object_mask", saved("m.png", RGBA), None, COLORS),
    ("object_mask", saved("m.png", DEPTH16), None, DEPTH16),
    ("object_mask", array(DEPTH16.astype(np.uint32)), None, DEPTH16),
]


@pytest.mark.parametrize(("kind", "make", "form", "expected"), TAKEN)
def test_what_is_right_in_another_form_is_taken(kind, make, form, expected, tmp_path):
    file = tmp_path / make(tmp_path)
    expected = judged(file.read_bytes(), "png") if expected is None else expected
    np.testing.assert_array_equal(read_picture(file, kind, form).pixels, np.asarray(expected, np.float32))


def test_negative_light_is_clipped_when_asked(tmp_path, capsys):
    exr(tmp_path / "n.exr", BAD)
    assert run(tmp_path / "n.exr", tmp_path / "a.sqlite", "--clip") == 0
    assert "128 negative or NaN values taken as 0" in capsys.readouterr().out
    picture = read_picture(tmp_path / "n.exr", clip=True)
    assert picture.clipped == 128
    np.testing.assert_array_equal(picture.pixels[0, 0], [1, 0, 1])
