"""Captures of every kind that a source may bring: passed through as they are, or refused in one sentence."""

import io
from itertools import product

import cv2
import numpy as np
import pytest

import omniscv
from omniscv import modalities
from omniscv.cameras import create
from omniscv.errors import ArgumentError, BadReplyError, MissingCaptureError
from omniscv.geometry import Pose
from omniscv.sources.base import Capabilities, Capture, ObjectTable, Source, View
from omniscv.sources.codecs import decode

POSE = Pose.from_angles((0, 0, 0), yaw_deg=20)
CAMERA = create("equirectangular", width=64, height=32)
VIEW = View(POSE, 90.0, 6, 4)


class Made(Source):
    """Captures that a function makes of requests."""

    capabilities = Capabilities()

    def __init__(self, make):
        self.make = make

    def objects(self):
        return ObjectTable({})

    def capture(self, requests):
        for i, request in enumerate(requests):
            yield self.make(i, request)


def plain(value, dtype):
    def make(_, request):
        shape = (request.view.height, request.view.width, 3)
        return Capture(request, request.view, np.full(shape, value, dtype), b"", "npy")

    return make


@pytest.mark.parametrize(
    ("value", "dtype", "filter"),
    [(65535, np.uint16, "area"), (65535, np.uint16, "bicubic"), (1e5, np.float32, "bilinear"),
     (-0.25, np.float32, "area"), (-0.25, np.float32, "nearest"), (255, np.uint8, "bicubic")],
)  # fmt: skip
def test_values_and_types_pass_through(value, dtype, filter):
    """No rescaling to 8 bits or to 0..1, and no overflow at the top of a type's range."""
    for camera in (CAMERA, create("fisheye-equidistant", width=32, height=32, fov_deg=200)):
        image = omniscv.render(camera, POSE, Made(plain(value, dtype)), filter=filter, face_size=64)
        assert image.lit.dtype == dtype
        np.testing.assert_allclose(image.lit[image.valid], value, rtol=1e-6)
        assert (image.lit[~image.valid] == 0).all()


def faulty(fault):
    def make(i, request):
        view = request.view
        dtype = np.float32 if fault == "type" and i else np.uint8
        if fault == "size" and i == 3:
            view = View(view.pose, view.fov_deg, 50, 50)
        if fault == "direction":
            view = View(Pose.from_angles((0, 0, 0), yaw_deg=90), 90.0, view.width, view.height)
        return Capture(request, view, np.zeros((view.height, view.width, 3), dtype))

    return make


def test_faces_that_do_not_fit_together_are_refused():
    for fault, error, says in (
        ("size", BadReplyError, "captures of one size and type"),
        ("type", BadReplyError, "captures of one size and type"),
        ("direction", MissingCaptureError, "seen by none"),
    ):
        with pytest.raises(error, match=says):
            omniscv.render(CAMERA, POSE, Made(faulty(fault)))


def test_a_source_that_ends_early_is_refused():
    class Short(Made):
        def capture(self, requests):
            yield from list(super().capture(requests))[:-1]

    with pytest.raises(BadReplyError, match="expected 6 captures of a viewpoint, got 5"):
        omniscv.render(CAMERA, POSE, Short(plain(1, np.uint8)))


@pytest.mark.parametrize("mode", ["lit", "object_mask"])
def test_alpha_is_dropped_and_grey_becomes_colour(mode):
    bgr = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    alpha = np.dstack([bgr, np.arange(24, dtype=np.uint8).reshape(4, 6)])
    grey = bgr[..., 0]
    for pixels, wanted in ((bgr, bgr[..., ::-1]), (alpha, bgr[..., ::-1]), (grey, np.dstack([grey] * 3))):
        written = cv2.imencode(".png", pixels)[1].tobytes()
        np.testing.assert_array_equal(decode(written, "png", mode, VIEW), wanted)


def test_depth_that_cannot_be_and_encodings_for_another_mode_are_refused():
    for wrong, encoding in product((np.nan, -1.0, -np.inf), ("npy", "npy planar cm", "npy ray m")):
        depth = np.ones((4, 6), np.float32)
        stream = io.BytesIO()
        depth[2, 3] = wrong
        np.save(stream, depth)
        with pytest.raises(BadReplyError, match="1 of 24"):
            decode(stream.getvalue(), encoding, "depth", VIEW)
    for mode in modalities.names():
        with pytest.raises(BadReplyError, match=f"encoding of {mode}"):
            decode(b"", "npy ray m" if mode != "depth" else "png", mode, VIEW)


def test_a_mode_that_a_source_does_not_have_is_refused_before_anything_is_captured():
    def capture(_, request):
        raise AssertionError(f"{request.mode} was captured")

    source = Made(capture)
    source.capabilities = Capabilities(modes=frozenset({"lit", "depth"}))
    for modes, lacking in ((("lit", "normals"), "normals"), (("object_mask",), "object_mask")):
        with pytest.raises(ArgumentError, match=f"some of depth, lit, which .* delivers; got {lacking}"):
            omniscv.render(CAMERA, POSE, source, modes=modes)
