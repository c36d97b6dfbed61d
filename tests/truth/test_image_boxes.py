"""Boxes and masks of objects in an image, against pycocotools and exact tracing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pycocotools import mask as cocomask

import mock_server
import omniscv
from omniscv import truth
from omniscv.frame.classes import ClassTable, SemanticClass
from omniscv.truth.visibility import run_lengths

SHAPES = array_shapes(min_dims=2, max_dims=2, max_side=40)


def library(mask):
    return cocomask.encode(np.asfortranarray(mask.astype(np.uint8)))


@given(mask=arrays(bool, SHAPES))
def test_masks_are_encoded_as_pycocotools_does(mask):
    encoded = run_lengths(mask)
    assert encoded == {"size": list(mask.shape), "counts": library(mask)["counts"].decode("ascii")}


def test_long_runs_are_encoded_as_pycocotools_does():
    mask = np.zeros((3000, 400), bool)
    mask[7:2900, 100:130] = mask[::7, 200] = True
    assert run_lengths(mask)["counts"] == library(mask)["counts"].decode("ascii")


@given(arrays(np.uint16, SHAPES, elements=st.sampled_from([0, 0, 0, 1, 300, 65535])), st.integers(0, 39))
def test_boxes_turn_with_a_panorama(labels, by):
    """Rolled by some columns, boxes keep their size and go on over the seam; all else is pycocotools'."""
    names = {"A": 1, "B": 300, "C": 65535}
    width = labels.shape[1]
    before = truth.boxes(labels, names, wrap=True)
    after = truth.boxes(np.roll(labels, by, axis=1), names, wrap=True)
    held = [each for each in (1, 300, 65535) if (labels == each).any()]
    assert [box["instance_id"] for box in before] == held
    for a, b in zip(before, after, strict=True):
        mask = labels == a["instance_id"]
        assert a["bbox"] == cocomask.toBbox(library(mask)).tolist()
        assert a["area"] == cocomask.area(library(mask))
        x, y, w, h = a["bbox_wrap"]
        inside = np.zeros_like(mask)
        inside[y : y + h, np.arange(x, x + w) % width] = True
        assert (inside >= mask).all()
        assert w <= a["bbox"][2]
        assert w == width or mask[:, [x, (x + w - 1) % width]].any(axis=0).all()
        assert (b["bbox_wrap"][2:], b["bbox_wrap"][1]) == ([w, h], y)
        assert a["crosses_seam"] == (x + w > width or w == width)


def test_the_distance_is_to_the_nearest_point():
    """Of a ball: that of its centre less its radius; of what has no surface there is none."""
    scene = mock_server.Scene("ball", {"objects": {"Ball": {"solids": [{"sphere": 0.5, "at": [3, 1, 0]}]}}})
    camera = omniscv.cameras.create("equirectangular", width=256, height=128)
    hits = scene.trace((0, 0, 0), camera.unproject().directions @ omniscv.Pose.from_angles((0, 0, 0)).R_w_c.T)
    (box,) = truth.boxes(hits.label, scene.objects, wrap=camera.wraps, depth=hits.distance.astype(np.float32))
    assert box["distance"] == pytest.approx(np.sqrt(10) - 0.5, abs=3e-3)  # half a pixel beside
    endless = np.full(hits.label.shape, np.inf, np.float32)
    table = ClassTable({"toy": SemanticClass(5, "toy")}, {"Ball": "toy"})
    (box,) = truth.boxes(hits.label, scene.objects, table, depth=endless)
    assert (box["distance"], box["name"], box["class"]) == (None, "Ball", "toy")
    assert truth.boxes(hits.label, ["Other"], table)[0]["class"] is None


FULL = {"equirectangular", "cylindrical", "noncentral-panorama", "ods", "lidar"}


@pytest.mark.parametrize("name", omniscv.cameras.names())
def test_full_panoramas_wrap_and_nothing_else(name):
    camera = omniscv.cameras.model(name).example(32)
    turned = camera.unproject([(0.0, camera.height / 2), (camera.width, camera.height / 2)])
    assert camera.wraps == (name in FULL)
    assert not camera.wraps or np.allclose(*turned.directions)
    if name == "cylindrical":
        assert not omniscv.cameras.create(name, width=64, height=32, fov_h_deg=300).wraps
