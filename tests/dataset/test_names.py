"""Splits, classes and cameras with names that YAML, markup or file systems take for something else."""

import json

import pytest
from support.datasets import image

from omniscv import dataset
from omniscv.errors import ArgumentError
from omniscv.job import load
from omniscv.viewing.look import look

HARMLESS = ["x: y", 'a"b', "yes", "</script>", "日本"]
PORTABLE = ["yes", "x - y", "日本"]
NOT_PORTABLE = ["con", "LPT1", "nul.a", "a:b", "<script>", "a?", "a*", "a|b", "a\\b", "x ", " x", "x."]
REFUSED = ["x" * 10_000, "a\nb", "\u202eab", "\ud800", "a/b", "..", ""]

LENS = {"model": "pinhole", "width": 8, "height": 8}
JOB = {"source": "mock://four-wall", "cameras": {"a": LENS}, "poses": [{"position": [0, 0, 1]}]}


@pytest.fixture(scope="module")
def picture():
    return image(width=16)


def written(out, picture, split="train", name="chair", supercategory=""):
    rule = {"match": "*", "class": name, "supercategory": supercategory}
    with dataset.Writer(out, classes={"rules": [rule]}) as writer:
        writer.add("room", picture, split=split)
    return out


@pytest.mark.parametrize("name", HARMLESS)
def test_classes_are_read_back_by_their_names(name, picture, tmp_path):
    out = written(tmp_path / "out", picture, name=name, supercategory=name)
    assert dataset.check(out, deep=True) == []
    assert list(dataset.open(out)[0].classes.classes) == [name]
    (coco,) = dataset.export(out, "coco", tmp_path / "coco")[:1]
    assert [row["name"] for row in json.loads(coco.read_text(encoding="utf-8"))["categories"]] == [name]
    (page,) = look(out, tmp_path / "page.html")
    data = page.read_text(encoding="utf-8").partition('id="data">')[2].partition("</script>")[0]
    assert json.loads(data)["classes"]["1"]["name"] == name


@pytest.mark.parametrize("split", PORTABLE)
def test_splits_are_names_of_files(split, picture, tmp_path):
    out = written(tmp_path / "out", picture, split=split)
    assert dataset.check(out, deep=True) == []
    shard, _ = dataset.export(out, "webdataset", tmp_path / "shards")
    assert shard.name == f"{split}-000000.tar"


@pytest.mark.parametrize("name", REFUSED)
def test_names_that_no_file_can_have_are_refused(name, picture, tmp_path):
    if name:  # frames without a split
        with pytest.raises(ArgumentError, match="split: expected the start of a file name"):
            written(tmp_path / "split", picture, split=name)
    if name not in ("a/b", ".."):
        with pytest.raises(ArgumentError, match=r"class: expected a name of at most 200 printable"):
            written(tmp_path / "class", picture, name=name)


@pytest.mark.parametrize("name", NOT_PORTABLE)
def test_names_that_windows_cannot_have_are_refused_when_a_job_is_read(name, picture, tmp_path):
    """Cameras, cameras of a rig, worlds, splits, and the keys of frames."""
    for wrong in (
        {**JOB, "cameras": {name: LENS}},
        {**JOB, "rig": {"cameras": {name: {"camera": LENS}}}},
        {"cameras": JOB["cameras"], "poses": JOB["poses"], "worlds": {name: {"source": JOB["source"]}}},
        {**JOB, "split": {name: 1.0}},
    ):
        # A star in a world's name stands for files, which its source must name.
        is_pattern = "*" in name and "worlds" in wrong
        says = r"source: expected one \*" if is_pattern else "expected the start of a file name"
        with pytest.raises(ArgumentError, match=says):
            load(wrong)
    with pytest.raises(ArgumentError, match=r"key: expected the start of a file name"):
        dataset.Writer(tmp_path / "out").add(name, picture)


def test_names_that_differ_in_case_alone_are_refused(picture, tmp_path):
    with pytest.raises(ArgumentError, match=r"more than the case of letters, got Left and left"):
        load({**JOB, "cameras": {"Left": LENS, "left": LENS}})
    with pytest.raises(ArgumentError, match=r"more than the case of letters, got left and LEFT"):
        load({**JOB, "cameras": {"LEFT": LENS}, "rig": {"cameras": {"left": {"camera": LENS}}}})
    with dataset.Writer(tmp_path / "out") as writer:
        writer.add("Room", picture)
        with pytest.raises(ArgumentError, match="in any case of letters, got 'room' again"):
            writer.add("room", picture)


def test_names_that_differ_in_how_letters_are_composed_are_refused(picture, tmp_path):
    """Café in four characters and in five: one file on macOS."""
    composed = "Caf\u00e9"
    apart = "cafe\u0301"
    with pytest.raises(
        ArgumentError, match=r"how Unicode composes letters, got 'Caf\\xe9' and 'cafe\\u0301'"
    ):
        load({**JOB, "cameras": {composed: LENS, apart: LENS}})
    with dataset.Writer(tmp_path / "out") as writer:
        writer.add(composed, picture)
        with pytest.raises(ArgumentError, match="again"):
            writer.add(apart, picture)


def test_names_too_long_for_a_format_are_refused_there(picture, tmp_path):
    for key, to, says in (
        ("k" * 150, "webdataset", "expected names of files of at most 100 bytes"),
        ("with space", "colmap", "without spaces, for COLMAP, got"),
    ):
        with dataset.Writer(tmp_path / to) as writer:
            writer.add(key, picture)
        assert dataset.check(tmp_path / to, deep=True) == []
        with pytest.raises(ArgumentError, match=says):
            dataset.export(tmp_path / to, to, tmp_path / f"{to}-out")
