"""Files of local folders and of object stores: one contract for all of them."""

import hashlib
import multiprocessing
import os
import pickle
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from support.stores import BUCKET, FailingStore, failing_store

from omniscv import storage
from omniscv.errors import ArgumentError, MissingFileError, StorageError
from omniscv.storage import Folder
from omniscv.storage.local import folder_beside, replace_folder


@pytest.fixture(params=["path", "file", "memory", "s3", "failing"])
def place(request, tmp_path):
    if request.param in ("path", "file"):
        yield storage.folder(f"file://{tmp_path}/here" if request.param == "file" else tmp_path / "here")
    elif request.param == "memory":
        yield storage.folder(f"memory://{tmp_path.name}")
    elif request.param == "s3":
        request.getfixturevalue("s3")
        yield storage.folder(f"s3://{BUCKET}/{tmp_path.name}")
    else:
        with failing_store(every=3):
            yield storage.folder("failing://here")


def test_contract(place: Folder, tmp_path: Path) -> None:
    assert not place.exists("a.txt")
    assert place.names() == []
    assert place.put("a.txt", b"one")
    assert place.put("inner/b.bin", _file(tmp_path / "source", b"two" * 1000))
    assert place.put("inner/c.txt", b"")
    assert place.names() == ["a.txt", "inner/b.bin", "inner/c.txt"]
    assert place.names("inner/") == ["inner/b.bin", "inner/c.txt"]
    assert place.names("inner/b") == ["inner/b.bin"]
    assert place.below("inner").names() == ["b.bin", "c.txt"]
    assert place.exists("inner/b.bin")
    assert not place.exists("inner")
    assert place.read("a.txt") == b"one"
    assert place.put("a.txt", b"another")
    assert not place.put("a.txt", b"late", first=True)
    assert place.read("a.txt") == b"another"
    assert place.put("first", b"1", first=True)
    assert place.put("second", tmp_path / "source", first=True)
    assert place.read("inner/b.bin") == place.read("second")
    assert place.read("inner/c.txt") == b""
    place.copy("inner/b.bin", tmp_path / "copy")
    assert (tmp_path / "copy").read_bytes() == b"two" * 1000
    assert place.fetch("inner/b.bin").read_bytes() == b"two" * 1000
    assert place.fetch("inner/b.bin").suffix == ".bin"
    place.put("inner/b.bin", b"changed")
    assert place.fetch("inner/b.bin").read_bytes() == b"changed"
    place.remove("a.txt")
    place.remove("a.txt")
    assert not place.exists("a.txt")
    same = pickle.loads(pickle.dumps(place))  # noqa: S301
    assert same == place
    assert same.read("first") == b"1"


def test_missing_files(place: Folder) -> None:
    for use in (place.read, place.fetch, partial(_copied, place)):
        with pytest.raises(MissingFileError, match=r"nothing\.txt: expected a file, it is missing"):
            use("nothing.txt")


@pytest.mark.parametrize("name", ["", "/etc/passwd", "../up", "a/../../b", "a//b", "a/./b", "a\0b", "a\\b"])
def test_names_stay_below_the_folder(name: str, tmp_path: Path) -> None:
    for place in (storage.folder(tmp_path), storage.folder("memory://names")):
        uses = (place.read, place.exists, place.fetch, place.below, place.remove)
        for use in (*uses, partial(_copied, place)):
            with pytest.raises(ArgumentError, match="name: expected"):
                use(name)
        with pytest.raises(ArgumentError, match="name: expected"):
            place.put(name, b"")


def test_the_first_of_many_writers_wins(place: Folder) -> None:
    """Whoever wins, what is there is whole and stays; at most one writer is told that it wrote."""
    contents = [bytes([each]) * 5000 for each in range(6)]
    with ThreadPoolExecutor(6) as pool:
        wrote = list(pool.map(lambda content: place.put("race", content, first=True), contents))
    assert place.read("race") in contents
    if place.local or "s3" in str(place):  # these decide in one step
        assert sum(wrote) == 1
        assert place.read("race") == contents[wrote.index(True)]


def test_damaged_copies_are_fetched_again(place: Folder) -> None:
    place.put("room.bin", b"whole")
    checksum = hashlib.sha256(b"whole").hexdigest()
    for given in ("", checksum):
        copy = place.fetch("room.bin", given)
        if place.local:
            assert copy == place.local / "room.bin"
            continue
        copy.write_bytes(b"wHole")
        assert place.fetch("room.bin", given).read_bytes() == b"whole"
        assert not [each for each in copy.parent.iterdir() if each.name.startswith(".")]


def test_processes_share_a_cache(cache: Path) -> None:
    """Two fetch at once, from copies of one store in memory; the cache begins with a damaged copy."""
    place = storage.folder("memory://shared")
    content = bytes(range(256)) * 4000
    place.put("room.bin", content)
    place.fetch("room.bin").write_bytes(b"damaged")
    with multiprocessing.get_context("fork").Pool(2) as pool:
        found = pool.map(_fetched, ["memory://shared"] * 4, chunksize=1)
    assert found == [hashlib.sha256(content).hexdigest()] * 4
    assert sorted(path.name for path in cache.rglob("[!.]*.*")) == ["room.bin", "room.bin.sha256"]


def test_a_cache_keeps_to_its_limit(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was used longest ago goes first; what was used within a day stays, and what is no copy."""
    place = storage.folder("memory://limited")
    hour = 3600.0
    for name in ("new", "used", "old", "oldest"):
        place.put(name, name.encode() * 100)
    copies = {name: place.fetch(name) for name in ("old", "oldest", "used")}
    (cache / "notes" / "mine").mkdir(parents=True)
    for name, hours in {"old": 30, "oldest": 40, "used": 50}.items():
        for each in copies[name].parent.iterdir():
            os.utime(each, times=(0, time.time() - hours * hour))
    assert place.fetch("used") == copies["used"]  # again

    def left(limit_gb: float) -> set[str]:
        monkeypatch.setenv("OMNISCV_CACHE_GB", f"{limit_gb:.12f}")
        (cache / ".cleaned").unlink(missing_ok=True)  # the last look was long ago
        shutil.rmtree(place.fetch("new").parent)
        place.fetch("new")
        return {name for name, copy in copies.items() if copy.exists()}

    assert left(1.0) == {"old", "oldest", "used"}
    assert left(1500e-9) == {"old", "used"}
    assert left(0.0) == {"used"}
    assert (cache / "notes" / "mine").is_dir()
    assert place.fetch("old").read_bytes() == b"old" * 100
    monkeypatch.setenv("OMNISCV_CACHE_GB", "much")
    shutil.rmtree(copies["old"].parent)
    with pytest.raises(ArgumentError, match="OMNISCV_CACHE_GB: expected a finite number >= 0, got 'much'"):
        place.fetch("old")


def test_a_store_that_always_fails_is_one_line() -> None:
    with failing_store(every=1):
        with pytest.raises(StorageError, match=r"^failing://down/a: expected to read or write it") as raised:
            storage.folder("failing://down").put("a", b"")
        assert FailingStore.requests < 20
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "url",
    ["s3://user:secret@bucket/rooms", "memory://rooms?token=secret", "gs://b/x?X-Goog-Signature=secret"],
)
def test_credentials_are_not_shown(url: str) -> None:
    assert "secret" not in storage.without_secrets(f"expected {url}, got nothing")
    with pytest.raises(ArgumentError, match="without user and query") as refused:
        storage.folder(url)
    assert "secret" not in str(refused.value)


def test_urls_of_files() -> None:
    assert str(storage.file_at("s3://bucket/a/b.sqlite").folder) == "s3://bucket/a"
    assert storage.file_at("memory://b.sqlite").name == "b.sqlite"
    assert storage.file_at("file:///a%20b/c").folder.local == Path("/a b")
    for wrong in ("s3://bucket", "s3://bucket/a/", "file://host/a"):
        with pytest.raises(ArgumentError, match="expected"):
            storage.file_at(wrong)
    with pytest.raises(ArgumentError, match="nosuch://a: expected the URL of a store"):
        storage.folder("nosuch://a").exists("b")


def _copied(place: Folder, name: str) -> None:
    place.copy(name, Path("never"))


def _fetched(url: str) -> str:
    return hashlib.sha256(storage.folder(url).fetch("room.bin").read_bytes()).hexdigest()


def _file(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def test_writers_of_one_export_spare_each_others_folders(tmp_path: Path) -> None:
    """The last to end wins."""
    target = tmp_path / "coco"
    with folder_beside(target) as one, folder_beside(target) as other:
        for part in (one, other):
            (part / "file").write_text(part.name)
        names = one.name, other.name
        replace_folder(other, target)
        replace_folder(one, target)
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["coco"]
    assert (target / "file").read_text() == names[0]
