"""``objects.json`` of a folder with several images: each label keeps the object that it was saved with."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from omniscv.compose.files import write
from omniscv.errors import ArgumentError
from omniscv.sources import ObjectTable

LAYERS = {"labels": np.ones((4, 4), np.uint16)}
ROOM = ObjectTable({"Bed": (1, 0, 0), "Sofa": (2, 0, 0)})
AGREES = ObjectTable({**ROOM.colors, "Table": (3, 0, 0)})
OTHERS = {
    "another scene": ObjectTable({"Cat": (1, 0, 0), "Dog": (2, 0, 0)}),
    "an object more, which moves the labels": ObjectTable({**ROOM.colors, "Chair": (3, 0, 0)}),
    "an object less": ObjectTable({"Sofa": (2, 0, 0)}),
    "other mask colours": ObjectTable({"Bed": (1, 0, 0), "Sofa": (9, 0, 0)}),
}


def save(table, out, stem):
    write(LAYERS, {}, table, out, stem)


@pytest.mark.parametrize("tables", [(ROOM, AGREES), (AGREES, ROOM), (ROOM, ROOM)])
def test_objects_that_agree_are_merged(tables, tmp_path):
    for number, table in enumerate(tables):
        save(table, tmp_path, str(number))
    wanted = max(tables, key=lambda table: len(table.colors))
    listed = json.loads((tmp_path / "objects.json").read_text(encoding="utf-8"))
    found = {int(label): (entry["name"], tuple(entry["mask_color"])) for label, entry in listed.items()}
    assert found == {wanted.label(name): (name, color) for name, color in wanted.colors.items()}


@pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS)
def test_objects_of_another_scene_are_refused_before_anything_is_written(other, tmp_path):
    save(ROOM, tmp_path, "first")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ArgumentError, match=r"objects of the images in this .*save into another folder"):
        save(other, tmp_path, "second")
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
