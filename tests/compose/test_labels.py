"""Labels: looked up, snapped by the known curve, or counted as unknown; never guessed."""

import numpy as np
import pytest
from exact import cameras_at
from hypothesis import given
from hypothesis import strategies as st

import omniscv
from mock_server import load_scene
from omniscv.captures.gamma import bent
from omniscv.captures.source import ObjectTable
from omniscv.chart.truth import TracedSource, traced
from omniscv.compose.labels import labels_of
from omniscv.geometry import Pose

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
SOURCE = TracedSource(load_scene("four-wall"))
CAMERAS = cameras_at(256)


@pytest.mark.parametrize("filter", ["bilinear", "bicubic", "area"])
@pytest.mark.parametrize("name", CAMERAS)
def test_every_output_colour_is_an_input_colour_and_has_its_label(name, filter):
    camera = CAMERAS[name]
    image = omniscv.render(camera, POSE, SOURCE, ("object_mask",), filter=filter)
    shown = set(map(tuple, image.object_mask[image.valid].tolist()))
    known = {color: SOURCE.objects().label(name) for name, color in SOURCE.objects().colors.items()}
    assert shown <= set(known) | {(0, 0, 0)}
    for color in shown:
        where = image.valid & (image.object_mask == color).all(axis=-1)
        assert (image.labels[where] == known.get(color, 0)).all()
    assert (image.labels[~image.valid] == 0).all()
    assert image.layers.unknown_colors == {}


@pytest.mark.parametrize("name", CAMERAS)
def test_labels_are_those_of_the_pixels_own_rays(name):
    """The rest are pixels at edges, where the nearest face pixel's centre lies on the other side."""
    camera = CAMERAS[name]
    image = omniscv.render(camera, POSE, SOURCE, ("object_mask",), face_size=1024 if camera.central else 512)
    truth = traced(SOURCE.scene, camera, POSE).label
    assert (image.labels == truth)[image.valid].mean() >= 0.995


def test_the_curve_is_that_of_the_protocol_reference():
    """Section 5.2 lists what the palette's values become."""
    listed = {23: 21, 31: 28, 47: 46, 55: 53, 63: 61, 71: 70, 79: 78, 103: 102, 119: 118, 35: 34, 120: 119}
    exact = [39, 87, 95, 111, *(v for v in range(122, 256) if v != 145)]
    for value, shown in {**listed, **{v: v for v in exact}, 20: 0, 15: 0, 7: 0}.items():
        assert bent(np.array([value]))[0] == shown


@given(st.lists(st.tuples(*[st.integers(24, 255)] * 3), min_size=1, max_size=20, unique=True))
def test_bent_colours_come_back_where_they_can_be_told_apart(colors):
    """Every colour that the curve makes of a table is given to its object, or to none if two are alike."""
    table = ObjectTable({f"object{i:02d}": color for i, color in enumerate(colors)})
    own = np.array(colors)
    shown = bent(own)
    labels, unknown = labels_of(shown[None].astype(np.uint8), table)
    for i, (label, color) in enumerate(zip(labels[0], shown, strict=True)):
        if label != i + 1:
            off = np.minimum(np.abs(own - color).max(axis=1), np.abs(shown - color).max(axis=1))
            assert np.count_nonzero(off <= 3) > 1  # not alone: another object's colour is as near
            if label == 0:
                assert tuple(color.tolist()) in unknown


def test_unknown_colours_are_counted_and_black_is_not():
    table = ObjectTable({"Chair": (200, 10, 10), "Table": (10, 200, 10)})
    mask = np.array([[[200, 10, 10], [90, 90, 90], [0, 0, 0], [90, 90, 90], [202, 9, 11]]], dtype=np.uint8)
    labels, unknown = labels_of(mask, table)
    assert labels.tolist() == [[1, 0, 0, 0, 1]]
    assert unknown == {(90, 90, 90): 2}


def test_two_objects_of_one_colour_are_told_from_none():
    table = ObjectTable({"A": (50, 60, 70), "B": (50, 60, 70), "C": (51, 60, 70)})
    labels, unknown = labels_of(np.array([[[50, 60, 70], [51, 60, 70]]], dtype=np.uint8), table)
    assert labels.tolist() == [[0, 3]]
    assert unknown == {(50, 60, 70): 1}
