"""Labels: looked up, counted as unknown, never guessed; and the names of theirs in ``objects.json``."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.exact import cameras_at, float_source

import omniscv
from mock_server import load_scene
from omniscv.compose.files import write
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.sources.base import ObjectTable
from omniscv.sources.labels import labels_of, labels_of_ids

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
SOURCE = float_source(load_scene("four-wall"))
SMALL = cameras_at(64)


@pytest.mark.parametrize(
    ("name", "filter"), [("equirectangular", "bicubic"), ("noncentral-panorama", "area")]
)
def test_every_output_colour_is_an_input_colour_and_has_its_label(name, filter):
    camera = SMALL[name]
    aim = {} if camera.central else {"accuracy": 0.1}
    image = omniscv.render(camera, POSE, SOURCE, ("object_mask",), filter=filter, face_size=96, **aim)
    shown = set(map(tuple, image.object_mask[image.valid].tolist()))
    known = {color: SOURCE.objects().label(name) for name, color in SOURCE.objects().colors.items()}
    assert shown <= set(known) | {(0, 0, 0)}
    for color in shown:
        where = image.valid & (image.object_mask == color).all(axis=-1)
        assert (image.labels[where] == known.get(color, 0)).all()
    assert (image.labels[~image.valid] == 0).all()
    assert image.unknown_colors == {}


@given(
    st.lists(st.tuples(*[st.integers(0, 255)] * 3), min_size=1, max_size=20, unique=True),
    st.integers(0, 5),
    st.randoms(use_true_random=False),
)
def test_a_colour_is_its_objects_or_nobodys(colors, tolerance, random):
    """Off by no more than the tolerance, and no other object's colour as near: else unknown."""
    table = ObjectTable({f"object{i:02d}": color for i, color in enumerate(colors)}, tolerance)
    own = np.array(colors)
    shown = np.array([[v + random.randint(-6, 6) for v in color] for color in colors]).clip(0, 255)
    labels, unknown = labels_of(shown[None].astype(np.uint8), table)
    for label, color in zip(labels[0], shown, strict=True):
        off = np.abs(own - color).max(axis=1)
        if (off == 0).any():
            assert off[label - 1] == 0
        elif color.any() and np.count_nonzero(off <= tolerance) == 1:
            assert off[label - 1] <= tolerance
        else:
            assert label == 0
            assert not color.any() or tuple(color.tolist()) in unknown


def test_instance_ids_have_the_labels_of_their_names():
    table = ObjectTable({}, ids={"Table": 40, "Chair": 65535})
    labels, mask = labels_of_ids(np.array([[40, 65535, 3]], np.uint16), table)
    assert labels.tolist() == [[2, 1, 0]]
    assert [tuple(color) for color in mask[0].tolist()] == [
        table.colors["Table"], table.colors["Chair"], (0, 0, 0),
    ]  # fmt: skip


def test_unknown_colours_and_those_of_two_objects_are_counted_and_black_is_not():
    table = ObjectTable({"Chair": (200, 10, 10), "Table": (10, 200, 10)}, tolerance=3)
    mask = np.array([[[200, 10, 10], [90, 90, 90], [0, 0, 0], [90, 90, 90], [202, 9, 11]]], dtype=np.uint8)
    labels, unknown = labels_of(mask, table)
    assert labels.tolist() == [[1, 0, 0, 0, 1]]
    assert unknown == {(90, 90, 90): 2}
    table = ObjectTable({"A": (50, 60, 70), "B": (50, 60, 70), "C": (51, 60, 70)})
    labels, unknown = labels_of(np.array([[[50, 60, 70], [51, 60, 70]]], dtype=np.uint8), table)
    assert labels.tolist() == [[0, 3]]
    assert unknown == {(50, 60, 70): 1}


LAYERS = {"labels": np.ones((4, 4), np.uint16)}
ROOM = ObjectTable({"Bed": (1, 0, 0), "Sofa": (2, 0, 0)})
AGREES = ObjectTable({**ROOM.colors, "Table": (3, 0, 0)})


def save(table, out, stem):
    write(LAYERS, {}, table, out, stem)


@pytest.mark.parametrize("tables", [(ROOM, AGREES), (AGREES, ROOM)])
def test_objects_that_agree_are_merged(tables, tmp_path):
    for number, table in enumerate(tables):
        save(table, tmp_path, str(number))
    listed = json.loads((tmp_path / "objects.json").read_text(encoding="utf-8"))
    found = {int(label): (entry["name"], tuple(entry["mask_color"])) for label, entry in listed.items()}
    assert found == {AGREES.label(name): (name, color) for name, color in AGREES.colors.items()}


def test_objects_of_another_scene_are_refused_before_anything_is_written(tmp_path):
    save(ROOM, tmp_path, "first")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for other in (
        {"Cat": (1, 0, 0), "Dog": (2, 0, 0)},
        {**ROOM.colors, "Chair": (3, 0, 0)},  # moves the labels
        {"Sofa": (2, 0, 0)},
        {"Bed": (1, 0, 0), "Sofa": (9, 0, 0)},
    ):
        with pytest.raises(ArgumentError, match=r"objects of the images in this .*save into another folder"):
            save(ObjectTable(other), tmp_path, "second")
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_list_that_is_none_is_kept(tmp_path):
    for text in ("", "[]", '{"1": 3}', '{"1": {"name": ["a"]}}', "[" * 5000, '{"1": null}'):
        (tmp_path / "objects.json").write_text(text)
        with pytest.raises(ArgumentError, match="expected"):
            save(ROOM, tmp_path, "first")
        assert [path.name for path in tmp_path.iterdir()] == ["objects.json"]
        assert (tmp_path / "objects.json").read_text() == text


def test_threads_that_save_into_one_folder_lose_nothing(tmp_path):
    colors = {f"Object{k:02d}": (k, 0, 0) for k in range(1, 25)}
    tables = [ObjectTable(dict([*colors.items()][:count])) for count in range(1, 25)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda item: save(item[1], tmp_path, str(item[0])), enumerate(tables)))
    listed = json.loads((tmp_path / "objects.json").read_text(encoding="utf-8"))
    assert [entry["name"] for entry in listed.values()] == tables[-1].names()
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
