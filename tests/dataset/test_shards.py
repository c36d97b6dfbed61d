"""WebDataset shards: read by their own reader, deterministic; those of others as listed, or one line."""

import io
import json
import shutil
import tarfile
import warnings
from contextlib import closing
from dataclasses import asdict

import numpy as np
import pytest
import webdataset
from support.datasets import tree

from omniscv import dataset, storage
from omniscv.dataset.formats.webdataset import Shard, read_list
from omniscv.errors import DatasetError
from omniscv.frame import FileEntry

KINDS = ("lit", "labels", "depth", "depth_error", "unsure", "truth", "layout")


@pytest.fixture(scope="module")
def packed(whole, tmp_path_factory):
    """A folder with one shard."""
    out = tmp_path_factory.mktemp("packed")
    dataset.export(whole / "dataset", "webdataset", out)
    for line in (lines := json.loads((out / "shards.json").read_bytes()))["shards"][1:]:
        (out / line["path"]).unlink()
    lines["shards"] = lines["shards"][:1]
    (out / "shards.json").write_text(json.dumps(lines), encoding="utf-8")
    return out


@pytest.fixture
def shards(packed, tmp_path):
    return shutil.copytree(packed, tmp_path / "shards")


def read(folder, scratch):
    """All frames of a folder of shards, each with its layers read."""
    scratch.mkdir(exist_ok=True)
    manifest, listed = read_list(storage.folder(folder))
    for file, keys in listed.items():
        with closing(Shard(storage.folder(folder), file, manifest)) as shard:
            for key in keys:
                frame = shard.extract(key, KINDS, scratch)
                yield frame, frame.layers(*KINDS)


def repacked(folder, change):
    """Rewrite the shard, of which ``change(tar, member, data)`` writes each member, and list it as it is."""
    lines = json.loads((folder / "shards.json").read_bytes())
    path = folder / lines["shards"][0]["path"]
    with tarfile.open(path) as tar:
        members = [(member, tar.extractfile(member).read()) for member in tar]
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as tar:
        for member, data in members:
            change(tar, member, data)
    enter(folder, lines)


def enter(folder, lines):
    lines["shards"][0] |= asdict(FileEntry.of(folder / lines["shards"][0]["path"]))
    (folder / "shards.json").write_text(json.dumps(lines), encoding="utf-8")


def test_samples_are_the_frames_of_the_dataset(packed, whole, tmp_path):
    frames = {frame.key: frame for frame in dataset.open(whole / "dataset")}
    for frame, layers in read(packed, tmp_path / "scratch"):
        assert frame.to_dict()["pose"] == frames[frame.key].to_dict()["pose"]
        for name, pixels in layers.items():
            np.testing.assert_array_equal(pixels, frames[frame.key].layer(name))
        assert layers["unsure"].shape == layers["labels"].shape  # blank: without a file
        assert not layers["unsure"].any()


def samples(folder):
    shards = sorted(map(str, folder.glob("*.tar")))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # its readers leave tars to the collector
        return list(webdataset.WebDataset(shards, shardshuffle=False, empty_check=False))


@pytest.mark.parametrize(("options", "most"), [({"max_count": 2}, 2), ({"max_bytes": 1}, 1)])
def test_webdataset_reads_every_byte(options, most, whole, tmp_path):
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
    assert max(len(shard["keys"]) for shard in listed) == most


def test_shards_are_deterministic_and_plain(whole, tmp_path):
    for name in ("a", "b"):
        dataset.export(whole / "dataset", "webdataset", tmp_path / name, max_count=2)
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    for path in (tmp_path / "a").glob("*.tar"):
        with tarfile.open(path) as tar:
            members = tar.getmembers()
        assert {(tar.uid, tar.gid, tar.mtime, tar.uname, tar.gname) for tar in members} == {(0, 0, 0, "", "")}
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


def linked(type, target):
    def change(tar, member, data):
        if member.name.endswith(".depth.exr"):
            member = tarfile.TarInfo(member.name)
            member.type = type
            member.linkname = target or member.name
            data = b""
        tar.addfile(member, io.BytesIO(data))

    return change


def sparse(tar, member, data):
    """A depth of 64 GiB of zeros, in a few bytes."""
    if member.name.endswith(".depth.exr"):
        size = 64 << 30
        sparse = {"major": "0", "minor": "1", "size": str(size), "map": f"{size - 1},1"}
        member.pax_headers = {f"GNU.sparse.{key}": value for key, value in sparse.items()}
        member.size = 1
        data = b"x"
    tar.addfile(member, io.BytesIO(data))


def put(ending, change):
    """Other bytes in the members whose names end so."""

    def changed(tar, member, data):
        data = change(data) if member.name.endswith(ending) else data
        member.size = len(data)
        tar.addfile(member, io.BytesIO(data))

    return changed


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (linked(tarfile.SYMTYPE, ""), "expected files of samples, got 'lens-"),
        (linked(tarfile.LNKTYPE, "lens-0.lit.png"), "expected files of samples"),
        (linked(tarfile.FIFOTYPE, ""), "expected files of samples"),
        (sparse, "expected files of samples"),
        (put("-0.json", lambda _: b"[" * 100_000), "expected JSON"),
        (put("lit.png", lambda data: data[:-1] + b"?"), "lit.png: expected the bytes of its checksum"),
        (put("lit.png", lambda data: data + bytes(1000)), "lit.png: expected at most"),
    ],
)
def test_members_that_are_no_files_of_samples_are_refused(change, says, shards, tmp_path):
    repacked(shards, change)
    with pytest.raises(DatasetError, match=rf"\.tar: .*{says}"):
        list(read(shards, tmp_path / "scratch"))


def test_a_shard_is_a_regular_file_of_its_size(shards, tmp_path):
    lines = json.loads((shards / "shards.json").read_bytes())
    path = shards / lines["shards"][0]["path"]
    path.rename(tmp_path / "elsewhere.tar")
    path.symlink_to(tmp_path / "elsewhere.tar")
    with pytest.raises(DatasetError, match="expected a regular file, got a link"):
        list(read(shards, tmp_path / "scratch"))
    path.unlink()
    with path.open("wb") as file:
        file.truncate(64 << 30)
    with pytest.raises(DatasetError, match=r"expected \d+ bytes, got 68719476736"):
        list(read(shards, tmp_path / "scratch"))


@pytest.mark.parametrize("text", ["[" * 100_000, "5", '{"shards": 3}', '{"shards": [{"path": "../x"}]}', ""])
def test_a_list_of_another_form_is_one_line(text, shards):
    (shards / "shards.json").write_text(text)
    with pytest.raises(DatasetError, match=r"shards\.json: expected a list of shards"):
        read_list(storage.folder(shards))
