"""Stores that lie, stall, or refuse: one line in bounded time and memory, and nothing false in the cache."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.stores import BUCKET, Failing, s3_application

from omniscv import cli, storage
from omniscv.errors import DamagedFileError, StorageError
from omniscv.storage import Folder, remote

CONTENT = bytes(range(256)) * 20


@pytest.fixture(scope="module")
def server() -> Iterator[Failing]:
    with s3_application(lambda number: "") as (application, client):
        client.put_object(Bucket=BUCKET, Key="held/room.bin", Body=CONTENT)
        yield application


@pytest.fixture
def place(server: Failing) -> Iterator[Folder]:
    yield storage.folder(f"s3://{BUCKET}/held")
    server.fault = lambda number: ""


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A twentieth of the time that requests are given."""
    monkeypatch.setattr(remote, "_ANSWER_S", 0.5)
    monkeypatch.setattr(remote, "_PATIENCE_S", 1.0)
    monkeypatch.setattr(remote, "_LISTING_S", 0.5)
    short = {"connect_timeout": 0.5, "read_timeout": 0.5, "retries": {"max_attempts": 0}}
    monkeypatch.setattr(remote, "_S3_CLIENT", short)


def test_patience_is_what_the_docs_say() -> None:
    assert remote._PATIENCE_S == 20
    assert remote._S3_CLIENT["read_timeout"] == remote._ANSWER_S < 20 / 2


@pytest.mark.timeout(60)
@pytest.mark.parametrize("operation", ["exists", "names", "read", "fetch", "put"])
def test_a_store_that_never_answers(operation: str, server: Failing, impatient: None, tmp_path: Path) -> None:
    """Its packages would wait a minute for each of many attempts: 418 s for one look."""
    place = storage.folder(f"s3://{BUCKET}/held")
    server.fault = lambda number: "silent"
    before = server.requests
    arguments = {"names": (), "put": ("new", b"x")}.get(operation, ("room.bin",))
    with pytest.raises(StorageError, match=r"got: .*(no answer|[Tt]ime)"):
        getattr(place, operation)(*arguments)
    assert server.requests - before <= 4
    server.fault = lambda number: ""


def by_checksum(place: Folder, tmp_path: Path) -> object:
    return place.fetch("room.bin", hashlib.sha256(CONTENT).hexdigest(), len(CONTENT))


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    "operation",
    [
        lambda place, tmp_path: place.read("room.bin", 1 << 22),
        lambda place, tmp_path: place.copy("room.bin", tmp_path / "copy"),
        lambda place, tmp_path: place.fetch("room.bin"),
        by_checksum,
    ],
)
def test_a_body_without_an_end_is_bounded(
    operation: Callable[[Folder, Path], object], server: Failing, place: Folder, cache: Path, tmp_path: Path
) -> None:
    server.fault = lambda number: "endless"
    with pytest.raises(DamagedFileError, match=r"expected at most|expected .* bytes, got"):
        operation(place, tmp_path)
    assert [path for path in cache.rglob("*") if path.is_file() and path.name != ".cleaned"] == []


def test_a_short_object_is_not_believed(server: Failing, place: Folder, cache: Path) -> None:
    """Half of a recording, sent as if it were all, was kept as the store's version for ever."""
    server.fault = lambda number: "short"
    with pytest.raises(DamagedFileError, match=f"expected {len(CONTENT)} bytes, got {len(CONTENT) // 2}"):
        place.fetch("room.bin")
    assert [path for path in cache.rglob("room.bin*") if path.is_file()] == []
    server.fault = lambda number: ""
    copy = place.fetch("room.bin")
    assert copy.read_bytes() == CONTENT
    copy.write_bytes(CONTENT[:100])
    copy.with_name("room.bin.sha256").write_text(hashlib.sha256(CONTENT[:100]).hexdigest())
    assert place.fetch("room.bin").read_bytes() == CONTENT


def test_a_cut_body_is_asked_for_again(server: Failing, place: Folder) -> None:
    for first in ("cut", "broken", "done", "refused"):
        start = server.requests
        server.fault = lambda number, first=first, start=start: first if number == start + 1 else ""
        assert place.read("room.bin") == CONTENT
        assert server.requests > start + 1


def test_expired_credentials_are_said(server: Failing, place: Folder) -> None:
    server.fault = lambda number: "expired"
    for operation in (lambda: place.exists("room.bin"), lambda: place.read("room.bin"), place.names):
        with pytest.raises(StorageError, match=r"check the store's credentials: .* have expired"):
            operation()


@pytest.mark.parametrize("command", ["dataset info room", "look room", "dataset export room --to coco"])
def test_a_deleted_working_folder_is_said(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert cli.run(command.split()) in (1, 2)
    (line,) = capsys.readouterr().err.splitlines()
    assert "working folder" in line
