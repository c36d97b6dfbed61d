"""Pictures that people have: what the gate lets in is what other readers see, all else is one line."""

import io
import json
import os
import warnings

import cv2
import numpy as np
import OpenImageIO
import pytest
from PIL import Image

import omniscv
from mock_server import load_scene
from omniscv import cli
from omniscv.chart.truth import traced
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Pose
from omniscv.sources import View
from omniscv.sources.base import Capture, Request
from omniscv.sources.pictures import DepthForm, read_picture
from omniscv.sources.recording.importing import import_pictures

SCENE = load_scene("four-wall")
AT = (0.3, -0.2, 1.45)
FACES = {
    "front": (0, 0),
    "right": (-90, 0),
    "back": (180, 0),
    "left": (90, 0),
    "up": (0, 90),
    "down": (0, -90),
}
DRAW = np.random.default_rng(7)
COLORS = DRAW.integers(0, 256, (12, 24, 3), np.uint8)


def seen(view):
    """Colours, planar depth and labels of a view, traced."""
    pixels = np.stack(np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5), axis=-1)
    fx, fy, cx, cy = view.projection
    rays = np.concatenate([(pixels - (cx, cy)) / (fx, fy), np.ones((*pixels.shape[:2], 1))], axis=-1)
    hits = SCENE.trace(view.pose.position, rays @ view.pose.R_w_c.T)
    planar = hits.distance / np.linalg.norm(rays, axis=-1)
    return np.uint8(255 * hits.color + 0.5), planar.astype(np.float32), hits.label


def six(folder, draw, suffix="png", edge=48):
    """Write six faces that a function draws from a view."""
    folder.mkdir(parents=True)
    for name, (yaw, pitch) in FACES.items():
        pixels = draw(View(Pose.from_angles(AT, yaw, pitch), 90, edge, edge))
        lossless = {"lossless": True, "exact": True} if suffix == "webp" else {}
        Image.fromarray(pixels).save(folder / f"{name}.{suffix}", **lossless)
    return folder


def run(*words):
    return cli.run(["recording", "import", *map(str, words)])


# -- The gate --------------------------------------------------------------------------------------------


def exr(path, channels, **spec):
    """Write float channels by name."""
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
    """Bytes of a valid picture."""
    if suffix in ("npy", "hdr", "png16"):
        pixels = {
            "npy": COLORS,
            "hdr": COLORS.astype(np.float32) / 99,
            "png16": COLORS.astype(np.uint16) * 257,
        }
        if suffix != "npy":
            return cv2.imencode("." + suffix[:3], pixels[suffix])[1].tobytes()
        np.save(buffer := io.BytesIO(), COLORS)
        return buffer.getvalue()
    buffer = io.BytesIO()
    Image.fromarray(COLORS).save(
        buffer, suffix.replace("tga", "TGA"), **({"lossless": True} if suffix == "webp" else {})
    )
    return buffer.getvalue()


def judged(data, suffix):
    """Pixels (H, W, 3) as Pillow, OpenCV or NumPy reads them."""
    if suffix == "npy":
        pixels = np.load(io.BytesIO(data), allow_pickle=False)
        return np.repeat(
            pixels.reshape(*pixels.shape[:2], -1)[..., :3], 1 if pixels.shape[2:] > (1,) else 3, axis=2
        )
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
    order = [
        lambda a: a,
        np.asfortranarray,
        lambda a: a.transpose(2, 0, 1),
        lambda a: a[0, 0],
        lambda a: a[..., :2],
    ]
    np.save(buffer := io.BytesIO(), order[draw.integers(0, 5)](pixels))
    return buffer.getvalue()


def check_changed(count, seed, folder):
    draw, wrong, taken = np.random.default_rng(seed), [], 0
    suffixes = ["png", "png16", "jpeg", "webp", "bmp", "tga", "tiff", "hdr", "npy"]
    valid = {suffix: encoded(suffix) for suffix in suffixes}
    for i in range(count):
        suffix = suffixes[i % len(suffixes)]
        data = changed(valid[suffix], suffix, draw)
        file = folder / f"a.{suffix[:3] if suffix == 'png16' else suffix}"
        file.write_bytes(data)
        try:
            pixels = read_picture(file).pixels
        except ArgumentError as error:
            assert "\n" not in str(error)
            continue
        taken += 1
        try:
            judge = judged(data, suffix)
            same = pixels.shape == judge.shape and np.abs(pixels - judge.astype(np.float64)).max() <= 2
        except Exception as fault:
            judge, same = fault, np.array_equal(pixels, judged(valid[suffix], suffix))
        if not same:
            wrong.append((i, suffix, judge if isinstance(judge, Exception) else np.shape(judge)))
    assert not wrong, wrong[:5]
    assert taken > count / 20


def test_what_is_changed_at_random_is_right_or_one_line(tmp_path):
    check_changed(300, 1, tmp_path)


@pytest.mark.soak
def test_what_is_changed_at_random_20000_times(tmp_path):
    check_changed(20_000, 2, tmp_path)
