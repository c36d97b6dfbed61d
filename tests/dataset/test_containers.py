"""WebDataset shards and Hugging Face folders, read by their own readers; deterministic and whole."""

import json
import tarfile
import warnings

import numpy as np
import pytest
import webdataset
from support.datasets import enter, tree

from omniscv import cli, dataset


def samples(folder):
    shards = sorted(map(str, folder.glob("*.tar")))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # its readers leave tars to the collector
        return list(webdataset.WebDataset(shards, shardshuffle=False, empty_check=False))


@pytest.mark.parametrize("options", [{}, {"max_count": 2}, {"max_bytes": 1}])
def test_webdataset_reads_every_byte(options, whole, tmp_path):
    frames = {frame.key: frame for frame in dataset.open(whole / "dataset")}
    dataset.export(whole / "dataset", "webdataset", tmp_path / "shards", **options)
    found = samples(tmp_path / "shards")
    assert sorted(sample["__key__"] for sample in found) == sorted(frames)
    for sample in found:
        files = {path.name.partition(".")[2]: path for path in frames[sample["__key__"]].files.values()}
        assert {name for name in sample if not name.startswith("__")} == set(files)
        for name, path in files.items():
            assert sample[name] == path.read_bytes()
        assert f"/{frames[sample['__key__']].split}-" in sample["__url__"]
    listed = json.loads((tmp_path / "shards" / "shards.json").read_text(encoding="utf-8"))["shards"]
    largest = max(len(shard["keys"]) for shard in listed)
    assert largest == {"max_count": 2, "max_bytes": 1}.get(next(iter(options), ""), 4)


def test_shards_are_deterministic_and_plain(whole, tmp_path):
    for name in ("a", "b"):
        dataset.export(whole / "dataset", "webdataset", tmp_path / name, max_count=2)
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    for path in (tmp_path / "a").glob("*.tar"):
        with tarfile.open(path) as tar:
            members = tar.getmembers()
        assert {(each.uid, each.gid, each.mtime, each.uname, each.gname) for each in members} == {
            (0, 0, 0, "", "")
        }
        assert [each.name for each in members] == sorted(each.name for each in members)
        assert path.read_bytes()[257:263] == b"ustar\0"


def test_a_damaged_shard_is_named(copied):
    shard = next((copied / "exports" / "webdataset").glob("*.tar"))
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    (fault,) = dataset.check(copied, format="webdataset")
    assert shard.name in fault
    assert "checksum" in fault


@pytest.fixture
def datasets(monkeypatch, tmp_path):
    """The library, offline."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_HOME", str(tmp_path / "home"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import datasets

        datasets.disable_progress_bars()
        yield datasets


def test_hugging_face_reads_every_row(copied, datasets, tmp_path):
    out = tmp_path / "hf"
    with_boxes(copied)
    assert cli.run(["dataset", "pack", str(copied), "--as", "hf", "--out", str(out)]) == 0
    frames = {frame.key: frame for frame in dataset.open(copied)}
    found = datasets.load_dataset("imagefolder", data_dir=str(out), cache_dir=str(tmp_path / "cache"))
    named = datasets.load_dataset(str(out), cache_dir=str(tmp_path / "named"))
    assert sorted(len(rows) for rows in found.values()) == [2, 4]
    assert {split: rows["key"][:] for split, rows in named.items()} == {
        split: rows["key"][:] for split, rows in found.items()
    }
    for split, rows in found.items():
        for row in rows:
            frame = frames.pop(row["key"])
            assert {"train": "train", "validation": "val"}[split] == frame.split
            for column, layer in (("image", "lit"), ("labels", "labels"), ("classes", "classes")):
                np.testing.assert_array_equal(np.asarray(row[column]), frame.layer(layer))
            assert (out / split / row["depth_path"]).read_bytes() == frame.files["depth"].read_bytes()
            assert row["position"] == frame.pose.position.tolist()
            assert row["objects"] == {"bbox": [[1, 2, 3, 4]], "categories": [5], "instances": [4]}
    assert frames == {}


def with_boxes(out):
    """Give every frame a record of a box."""
    for frame in dataset.open(out):
        (name,) = [name for name, number in frame.instances.items() if number == 4]
        box = {"instance_id": 4, "name": name, "class": "chair", "bbox": [1, 2, 3, 4]}
        (out / f"{frame.key}.truth.json").write_text(json.dumps({"boxes": [box]}), encoding="utf-8")
        enter(out, frame.key, "truth", f"{frame.key}.truth.json")
