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
    mask = np.zeros((3000, 4000), bool)
    mask[7:2900, 1000:1300] = mask[:, 3500] = True
    mask[::7, 2000] = True
    encoded = run_lengths(mask)
    assert encoded["counts"] == library(mask)["counts"].decode("ascii")


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


def test_objects_have_the_class_of_their_name():
    labels = np.array([[1, 2, 3]], np.uint16)
    table = ClassTable({"chair": SemanticClass(5, "chair")}, {"Chair_1": "chair"})
    boxes = truth.boxes(labels, ["Chair_1", "Thing"], table)
    assert [(box["name"], box["class"]) for box in boxes] == [("Chair_1", "chair"), ("Thing", None)]


def test_the_distance_is_to_the_nearest_point():
    """Of a ball: that of its centre less its radius; of what has no surface there is none."""
    scene = mock_server.Scene("ball", {"objects": {"Ball": {"solids": [{"sphere": 0.5, "at": [3, 1, 0]}]}}})
    camera = omniscv.cameras.create("equirectangular", width=256, height=128)
    hits = scene.trace((0, 0, 0), camera.unproject().directions @ omniscv.Pose.from_angles((0, 0, 0)).R_w_c.T)
    (box,) = truth.boxes(hits.label, scene.objects, wrap=camera.wraps, depth=hits.distance.astype(np.float32))
    assert box["distance"] == pytest.approx(np.sqrt(10) - 0.5, abs=3e-3)  # half a pixel beside
    endless = np.full(hits.label.shape, np.inf, np.float32)
    assert truth.boxes(hits.label, scene.objects, depth=endless)[0]["distance"] is None


FULL = {"equirectangular", "cylindrical", "noncentral-panorama", "ods", "lidar"}


@pytest.mark.parametrize("name", omniscv.cameras.names())
def test_full_panoramas_wrap_and_nothing_else(name):
    camera = omniscv.cameras.model(name).example(32)
    turned = camera.unproject([(0.0, camera.height / 2), (camera.width, camera.height / 2)])
    assert camera.wraps == (name in FULL)
    assert not camera.wraps or np.allclose(*turned.directions)


def test_a_part_of_a_panorama_does_not_wrap():
    assert not omniscv.cameras.create("cylindrical", width=64, height=32, fov_h_deg=300).wraps
    assert omniscv.cameras.create("noncentral-panorama", width=64, height=32, radius=0.5).wraps
