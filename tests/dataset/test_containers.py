"""WebDataset shards, read by their own reader; deterministic and whole."""

import json
import tarfile
import warnings

import pytest
import webdataset
from support.datasets import tree

from omniscv import dataset


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
