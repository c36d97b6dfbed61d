"""``dataset check``: every fault is one line that names the file, and a dataset as it was made has none."""

import json

import numpy as np
import pytest
from support.datasets import enter

from omniscv import cli, dataset, modalities
from omniscv.compose.files import write_picture
from omniscv.errors import DatasetError


def test_a_dataset_as_it_was_made_has_no_faults(whole):
    assert dataset.check(whole / "dataset") == []
    assert dataset.check(whole / "dataset", deep=True) == []
    assert dataset.check(whole / "dataset", format="webdataset") == []


def replaced(old, new):
    return lambda data: data.replace(old.encode(), new.encode())


def without_its_last_line(data):
    return b"".join(data.splitlines(keepends=True)[:-1])


def other_split(data):
    """The split of the first frame, which is that of its place."""
    split = json.loads(data.splitlines()[0])["split"]
    return data.replace(f'"split": "{split}"'.encode(), b'"split": "other"', 1)


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("lens-0.depth.exr", None, "lens-0.depth.exr: expected a file, it is missing"),
        ("pano-1.labels.png", bytes.swapcase, "pano-1.labels.png: expected the bytes of its checksum"),
        ("frames.jsonl", without_its_last_line, "pano-2.json: expected a frame that frames.jsonl lists"),
        ("frames.jsonl", other_split, "of its place, got"),
        ("frames.jsonl", replaced("lens-0.lit.png", "../lens-0.lit.png"), "expected the name of a file"),
        ("frames.jsonl", replaced('"key": "lens-0"', '"key": "../x"'), "key: expected the start of a file"),
        ("dataset.json", replaced('"Ball": 1,', '"Bell": 1,'), "json: classes: expected what its rules"),
        ("dataset.json", replaced('"Books": 2,', '"Books": 1,'), "got: names: expected another id for each"),
        ("exports/webdataset", None, "exports/webdataset: expected an export to webdataset, it is missing"),
    ],
)
def test_a_fault_is_one_line_and_exit_code_1(name, change, says, copied, capsys):
    path = copied / name
    if change is None:
        path.rename(copied.parent / "elsewhere")
    else:
        path.write_bytes(change(path.read_bytes()))
    assert cli.run(["dataset", "check", str(copied)]) == 1
    assert says in capsys.readouterr().out


@pytest.mark.parametrize(
    ("layer", "where", "value", "says"),
    [
        ("labels", "inside", 999, "labels: expected instance ids of the dataset"),
        ("labels", "outside", 1, "labels: expected 0 outside the field of view"),
        ("labels", "inside", 999, "classes: expected the class of the object in labels"),
        ("classes", "one", 77, "classes: expected the class of the object in labels, got 1 other"),
        ("depth", "inside", np.nan, "depth: expected metres >= 0, or inf"),
        ("depth", "inside", 0, "depth: expected more than 0 m inside the field of view"),
        ("depth", "outside", np.inf, "depth: expected 0 outside the field of view"),
        ("normals", "inside", 2, "normals: expected unit vectors, or 0"),
    ],
)
def test_deep_faults_are_found_behind_right_checksums(layer, where, value, says, copied):
    (frame,) = (frame for frame in dataset.open(copied) if frame.key == "lens-1")
    pixels = frame.layer(layer).copy()
    valid = frame.valid
    pixels[{"inside": valid, "outside": ~valid, "one": tuple(np.argwhere(valid)[0])}[where]] = value
    write_picture(frame.files[layer], pixels, modalities.get(layer))
    enter(copied, "lens-1", layer)
    assert dataset.check(copied) == []
    found = dataset.check(copied, deep=True)
    assert any(line.startswith(f"lens-1: {says}") for line in found), found


def test_records_are_json_of_objects_that_the_dataset_has(copied):
    for text, says in (
        ('{"boxes": [{"instance_id": 777, "name": "Ball", "bbox": [0, 0, 1, 1]}]}', "got 'Ball' as 777"),
        ('{"boxes": [{"instance_id": 1, "name": "Ball"}]}', "boxes[0]: missing key 'bbox'"),
        ('{"boxes": [{"instance_id": 1, "name": "Ball", "bbox": [0, 0, 99, 9]}]}', "a box in the image"),
        ('{"boxes": [[[1]]]}', "boxes[0]: expected a mapping"),
        ('{"poses": {"Ball": {"position": "\\ud800", "rotation": 1}}}', "expected texts of Unicode"),
        ("5", "truth: expected a mapping, got 5"),
        ("[" * 100_000, "expected JSON"),
        ('{"boxes": [{"x": NaN}]}', "NaN, which JSON does not have"),
        ('{"boxes": [', "expected JSON"),
    ):
        (copied / "pano-0.truth.json").write_text(text, encoding="utf-8")
        enter(copied, "pano-0", "truth", "pano-0.truth.json")
        assert dataset.check(copied) == []
        (line,) = dataset.check(copied, deep=True)
        assert line.startswith("pano-0.truth.json: ")
        assert says in line
        with pytest.raises(DatasetError) as refused:
            dataset.export(copied, "coco")
        assert line in str(refused.value)


def test_an_incomplete_dataset_is_a_fault(copied, capsys):
    (copied / "frames.jsonl").unlink()
    assert cli.run(["dataset", "check", str(copied)]) == 1
    assert "'omniscv dataset make JOB' with its job completes it" in capsys.readouterr().out
    assert cli.run(["dataset", "export", str(copied), "--to", "coco"]) == 1


def test_an_export_without_a_check_of_its_own_is_made_again_and_compared(copied):
    dataset.export(copied, "coco")
    assert dataset.check(copied, format="coco") == []
    (copied / "exports" / "coco" / "annotations.json").write_text("mine", encoding="utf-8")
    (copied / "exports" / "coco" / "strange").touch()
    found = dataset.check(copied, format="coco")
    assert "exports/coco: annotations.json: expected what the frames give, got other bytes" in found
    assert "exports/coco: strange: expected no such file" in found
