"""Images as people look at them: layers in colours, a sheet of all, one line of text."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import omniscv
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.job import load

ROOT = Path(__file__).parents[2]
POSE = omniscv.Pose.from_angles((0, 0, 1.5))


@pytest.fixture(scope="module")
def image():
    camera = create("fisheye-equidistant", width=64, height=48, fov_deg=190)
    with omniscv.open_source("scene://fence?traces=0") as source:
        return omniscv.render(camera, POSE, source, ("lit", "object_mask", "depth", "normals"), face_size=64)


def test_every_layer_is_a_picture_of_its_size_and_no_other(image):
    for layer in image.layers:
        picture = image.to_pil(layer)
        assert (picture.size, picture.mode) == ((64, 48), "RGB")
        outside = np.array(picture)[~image.valid]
        assert (outside == outside[0]).all()
    sheet = Image.open(BytesIO(image._repr_png_()))  # as a notebook shows all
    assert sheet.size == image.to_pil().size
    assert (sheet.width // 64) * (sheet.height // 48) >= len(image.layers)
    with pytest.raises(ArgumentError, match=r"layer: expected one of lit, .*got 'classes'"):
        image.to_pil("classes")


def test_near_is_red_far_is_blue_and_the_sky_is_white(image):
    shown = np.array(image.to_pil("depth")).astype(int)
    sky = np.isposinf(image.depth)
    assert (shown[sky & image.valid] == 255).all()
    seen = image.valid & ~sky
    order = np.argsort(image.depth[seen])
    red_less_blue = shown[seen][order][:, 0] - shown[seen][order][:, 2]
    count = len(order) // 10
    assert red_less_blue[:count].mean() > red_less_blue[-count:].mean() + 100


def test_the_systems_viewer_is_shown_the_picture(image, monkeypatch):
    shown = []
    monkeypatch.setattr(Image.Image, "show", lambda self: shown.append(self))
    image.show("depth")
    assert np.array_equal(np.array(shown[0]), np.array(image.to_pil("depth")))


def test_one_line_says_what_it_is(image, tmp_path):
    layers = "lit, object_mask, labels, depth, normals, unsure, depth_error, label_edge"
    assert repr(image) == f"<OmniImage fisheye-equidistant 64x48: {layers}>"
    with omniscv.open_source("scene://fence?traces=0") as source:
        assert repr(source) == "<SceneSource fence, scene, depth lit normals object_mask>"
    with omniscv.open_source(ROOT / "captures/four-wall.sqlite") as replay:
        assert repr(replay).startswith("<RecordedSource four-wall.sqlite: 268 views")
    with omniscv.dataset.Writer(tmp_path / "own") as writer:
        writer.add("a", image, split="train")
    (frame,) = omniscv.dataset.open(tmp_path / "own")
    assert repr(frame).startswith("<Frame a: fisheye-equidistant, train: depth, depth_error, ")
    job = load(ROOT / "examples/kitchen/kitchen.yaml")
    assert repr(job).startswith("<Job panorama, fisheye, ball at sampled poses, lit object_mask depth")
    for each in (image, replay, frame, job):
        assert "\n" not in repr(each)
