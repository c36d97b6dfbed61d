"""Datasets in an object store: opened, checked, counted, exported and packed as those in a folder are."""

import json
import shutil
import tarfile
from io import BytesIO

import numpy as np
import pytest
from support.command_line import ROOT
from support.datasets import made, tree
from support.stores import BUCKET, failing_store

from omniscv import cli, dataset, storage
from omniscv.dataset.checking import info
from omniscv.errors import ArgumentError, DatasetError, MissingFileError, StorageError
from omniscv.sources import recording
from omniscv.viewing.look import look


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("made")
    return made(place, more="export: [{format: webdataset, max_count: 2}, coco]\n")


@pytest.fixture(scope="module")
def url(s3, folder):
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            s3.upload_file(str(path), BUCKET, f"datasets/first/{path.relative_to(folder).as_posix()}")
    return f"s3://{BUCKET}/datasets/first"


@pytest.fixture
def held(folder, tmp_path):
    there = storage.folder(f"memory://{tmp_path.name}/dataset")
    for name, content in in_folder(folder).items():
        there.put(name, content)
    return str(there)


def in_store(place):
    there = storage.folder(place)
    return {name: there.read(name) for name in there.names()}


def in_folder(path):
    return {name: (path / name).read_bytes() for name in tree(path)}


def test_counts_and_frames_are_those_of_the_folder_and_there_are_no_faults(url, folder, cache, capsys):
    assert info(url) == info(folder)
    assert cli.run(["dataset", "check", url]) == 0
    assert capsys.readouterr().out == f"{url}: 6 frames, no faults\n"
    assert not cache.exists()  # a check of frames keeps nothing
    local = dataset.open(folder)
    remote = dataset.open(url)
    assert not cache.exists()  # fetched when they are used
    assert [frame.key for frame in remote] == [frame.key for frame in local]
    for mine, theirs in zip(remote, local, strict=True):
        assert set(mine.files) == set(theirs.files)
        for layer in ("lit", "depth"):
            assert np.array_equal(mine.layer(layer), theirs.layer(layer))
    held = {path.name for path in cache.rglob("[!.]*.*")}
    assert held == {f"{each.key}.{kind}" for each in local for kind in ("lit.png", "depth.exr")}


def shown(files):
    """The files that are not hidden: stores list no others."""
    return {name: content for name, content in files.items() if not name.startswith(".")}


def test_faults_are_those_of_the_folder(folder, tmp_path):
    damaged = tmp_path / "damaged"
    shutil.copytree(folder, damaged)
    (damaged / "lens-0.depth.exr").unlink()
    (damaged / "pano-1.lit.png").write_bytes(b"no picture")
    (damaged / "strange.json").write_text("{}")  # of somebody else
    there = storage.folder(f"memory://{tmp_path.name}")
    for name, content in in_folder(damaged).items():
        there.put(name, content)
    assert len(dataset.check(damaged)) == 2
    assert dataset.check(str(there)) == dataset.check(damaged)
    with pytest.raises(StorageError, match=r"pano-1\.lit\.png: expected the bytes of its checksum"):
        next(frame for frame in dataset.open(str(there)) if frame.key == "pano-1").layer("lit")


def test_a_checksum_is_no_path(held, tmp_path, cache):
    """The cache names folders by checksums: one with slashes would write a file of the store's anywhere."""
    victim = tmp_path / "private"
    victim.mkdir()
    there = storage.folder(held)
    lines = [json.loads(line) for line in there.read("frames.jsonl").splitlines()]
    for sha256 in (str(victim), "../../private", "0" * 63, "A" * 64, None):
        lines[0]["files"]["lit"]["sha256"] = sha256
        there.put("frames.jsonl", "".join(f"{json.dumps(line)}\n" for line in lines).encode())
        with pytest.raises(DatasetError, match="sha256: expected 64 hexadecimal digits"):
            dataset.open(held)[0].layer("lit")
    assert [*victim.iterdir()] == []


def test_exports_in_a_store_are_those_of_the_folder(held, folder, tmp_path):
    """Also below the dataset, where COCO names the pictures as seen from its file."""
    copied = tmp_path / "dataset"
    shutil.copytree(folder, copied)
    listed = {"files": ["stale/file.txt"], "options": {}, "cameras": [], "state": "", "of_job": False}
    stale = storage.folder(held).below("exports/ply")
    stale.put("stale/file.txt", b"of an earlier export")
    stale.put(".exported.json", json.dumps({"ply": listed}).encode())
    for place, to in ((copied, "coco"), (held, "coco"), (copied, "ply"), (held, "ply")):
        written = dataset.export(place, to)
        assert all(str(each).startswith(f"{place}/exports/{to}/") for each in written)
    for to in ("coco", "ply", "webdataset"):
        assert in_store(f"{held}/exports/{to}") == shown(in_folder(copied / "exports" / to))
    images = json.loads(storage.folder(held).read("exports/coco/annotations.json"))["images"]
    assert [each["file_name"] for each in images[:1]] == ["../../lens-0.lit.png"]
    assert dataset.check(held, deep=True) == []


def test_packs_are_written_anywhere(held, folder, tmp_path, s3):
    local = tmp_path / "local"
    remote = f"s3://{BUCKET}/{tmp_path.name}/shards"
    for place, out in ((folder, local), (held, tmp_path / "fetched"), (folder, remote)):
        assert cli.run(["dataset", "pack", str(place), "--as", "webdataset", "--out", str(out)]) == 0
    assert in_folder(tmp_path / "fetched") == in_folder(local)
    assert shown(in_folder(local)) == in_store(remote)
    shard = s3.get_object(Bucket=BUCKET, Key=f"{tmp_path.name}/shards/val-000000.tar")["Body"].read()
    with tarfile.open(fileobj=BytesIO(shard)) as tar:
        assert all(member.name.split(".")[0].startswith(("lens-", "pano-")) for member in tar)
    out = f"memory://{tmp_path.name}/coco"
    dataset.export(held, "coco", out)
    listed = json.loads(storage.folder(out).read("annotations.json"))["images"]
    assert [each["file_name"] for each in listed[:1]] == [f"{held}/lens-0.lit.png"]


def test_a_full_store_is_one_line_and_holds_no_half_file(folder, tmp_path):
    full = in_folder(folder)
    with failing_store(capacity=30_000):
        with pytest.raises(StorageError, match=r"failing://full/.*No space left on device; free space"):
            dataset.export(folder, "webdataset", "failing://full")
        for name, content in in_store("failing://full").items():
            assert content == full[f"exports/webdataset/{name}"]


def test_videos_are_written_to_a_url(held, tmp_path):
    import av

    out = storage.folder(f"memory://{tmp_path.name}")
    assert cli.run(["dataset", "video", held, "--camera", "pano", "--out", f"{out}/pano.mp4"]) == 0
    with av.open(BytesIO(out.read("pano.mp4"))) as video:
        assert sum(1 for _ in video.decode(video=0)) == 3


def test_a_page_of_a_url_is_that_of_the_folder(held, folder, tmp_path):
    assert folder.name == held.rpartition("/")[2]
    for place, page in ((folder, "local.html"), (held, "remote.html")):
        assert cli.run(["look", str(place), "--out", str(tmp_path / page)]) == 0
    assert (tmp_path / "remote.html").read_bytes() == (tmp_path / "local.html").read_bytes()
    recording.merge(f"memory://{tmp_path.name}/room.sqlite", [ROOT / "captures" / "four-wall.sqlite"])
    (page,) = look(f"memory://{tmp_path.name}/room.sqlite", tmp_path / "room.html", size=(64, 32))
    assert '"title":"room.sqlite"' in page.read_text(encoding="utf-8")
    with pytest.raises(MissingFileError, match=r"^memory://none/x: expected a file, it is missing"):
        look("memory://none/x", tmp_path / "none.html")


def test_what_is_no_dataset_is_one_line(url):
    with pytest.raises(ArgumentError, match=r"^s3://rooms/none: expected the folder of a dataset, got none"):
        dataset.open(f"s3://{BUCKET}/none")
    incomplete = storage.folder("memory://incomplete")
    incomplete.put("dataset.json", storage.folder(url).read("dataset.json"))
    with pytest.raises(DatasetError, match=r"^memory://incomplete: expected a complete dataset"):
        dataset.open("memory://incomplete")
