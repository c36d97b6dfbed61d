"""Recordings in an object store: read by URL, joined there, divided there."""

import pickle
import re
from pathlib import Path

import pytest
from support.faces import face_requests
from support.recordings import contents
from support.stores import BUCKET, failing_store

import omniscv
from omniscv import cli, dataset, storage
from omniscv.errors import ArgumentError, MissingFileError, NotARecordingError
from omniscv.job import load
from omniscv.make import run
from omniscv.sources.recording import merge, split
from omniscv.sources.recording.inspection import info, verify

REQUESTS = face_requests(size=16, modes=("lit", "depth"))


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    path = tmp_path_factory.mktemp("room") / "room.sqlite"
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        list(source.capture(REQUESTS))
    return path


@pytest.fixture
def url(s3, room, tmp_path):
    s3.upload_file(str(room), BUCKET, f"{tmp_path.name}/room.sqlite")  # by another program
    return f"s3://{BUCKET}/{tmp_path.name}/room.sqlite"


def replayed(source):
    return [capture.payload for capture in source.capture(REQUESTS)]


def test_a_recording_on_s3_replays_as_its_file_does(url, room, cache, s3, capsys):
    with omniscv.open_source(room) as local, omniscv.open_source(url) as source:
        assert replayed(source) == replayed(local)
        with pickle.loads(pickle.dumps(source)) as again:  # noqa: S301
            assert replayed(again) == replayed(local)
    copies = list(cache.rglob("room.sqlite"))
    assert [each.read_bytes() for each in copies] == [room.read_bytes()]
    copies[0].write_bytes(b"damaged")
    with omniscv.open_source(url) as source:
        assert len(replayed(source)) == len(REQUESTS)
    assert info(url).captures == info(room).captures
    assert verify(url).ok
    assert cli.run(["recording", "check", url]) == 0
    assert capsys.readouterr().out == f"{url}: {len(REQUESTS)} captures, all as recorded\n"


def test_what_is_wrong_is_one_line_with_the_url(url, room):
    with pytest.raises(MissingFileError, match=r"^s3://rooms/none/room.sqlite: expected a file, it is"):
        omniscv.open_source(f"s3://{BUCKET}/none/room.sqlite")
    with pytest.raises(ArgumentError, match=r"options: expected .* for 's3://") as refused:
        omniscv.open_source(url.replace("://", "://user:secret@"), timeout_s=1.0)
    assert "secret" not in str(refused.value)
    with (
        omniscv.open_source(url) as source,
        pytest.raises(omniscv.OmniscvError, match=f"^{url}: expected a lit"),
    ):
        list(source.capture(face_requests(size=8, modes=("lit",))))
    storage.folder("memory://texts").put("a.sqlite", b"a text" * 1000)
    with pytest.raises(NotARecordingError):
        omniscv.open_source("memory://texts/a.sqlite")


def test_jobs_name_recordings_by_url(room, tmp_path):
    storage.folder("memory://jobs").put("room.sqlite", room)
    job = tmp_path / "job.yaml"
    text = """
      source: memory://jobs/room.sqlite
      cameras: {pano: {model: equirectangular, width: 16, height: 8}}
      poses: [{position: [0, 0, 1.5]}]
      face_size: 16
      """
    job.write_text(text)
    run(load(job))
    assert (tmp_path / "out" / "pano.lit.png").stat().st_size > 0
    job.write_text(f"{text}record: s3://rooms/room.sqlite\n")
    with pytest.raises(ArgumentError, match=r"record: expected a path on this machine, .* got s3://rooms"):
        load(job)
    with (
        omniscv.open_source(room) as source,
        pytest.raises(ArgumentError, match=r"recording: expected a path on this machine, got s3://rooms/a"),
    ):
        omniscv.record(source, "s3://rooms/a.sqlite")


@pytest.mark.parametrize("command", ["record", "render"])
def test_what_is_written_here_is_no_url(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options = ["--source", "scene://four-wall", "--set", "face_size=16", "--out", "s3://rooms/a.sqlite"]
    assert cli.run([command, *options]) == 2
    assert re.search("s3:/{1,2}rooms/a.sqlite", capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ArgumentError, match="got a Path of one"):
        dataset.open(Path("s3://rooms/first"))


def test_recordings_are_joined_and_divided_in_a_store(room, tmp_path):
    with failing_store(every=5):
        storage.folder("failing://parts").put("room.sqlite", room)
        out = "failing://whole/room.sqlite"
        assert merge(out, ["failing://parts/room.sqlite"]) == len(REQUESTS)
        assert merge(out, [room]) == 0
        ((name, _),) = split(out, "failing://places")
        for place, file in (("failing://whole", "room.sqlite"), ("failing://places", name)):
            assert storage.folder(place).names() == [file]
            assert contents(storage.folder(place).fetch(file)) == contents(room)


def test_a_merge_that_fails_leaves_the_store_as_it_was(room):
    with failing_store():
        with pytest.raises(NotARecordingError):
            merge("failing://whole/room.sqlite", [room, __file__])
        assert storage.folder("failing://whole").names() == []
