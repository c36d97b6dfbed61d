"""Parts of a dataset that is a URL: S3, one that is far away and fails, full ones, a full disk."""

import json
import subprocess
import sys
import threading
import time
from collections import Counter
from dataclasses import replace

import pytest
from support.datasets import job_file, tree
from support.full_disk import largest_file
from support.processes import OMNISCV
from support.stores import BUCKET, failing_store, s3_application, s3_server, tree_at, twelve_percent

import omniscv
from omniscv import Pose, cli
from omniscv.dataset import Writer
from omniscv.errors import OmniscvError
from omniscv.job import load
from omniscv.make import Part, make, run_part


def described(folder, **source):
    path = job_file(folder, more="export: [webdataset]\n", **source)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if "lens:" not in line))
    return path


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    folder = tmp_path_factory.mktemp("single")
    job = load(described(folder))
    make(replace(job, record=folder / "room.sqlite"))
    return folder


@pytest.fixture
def job(single, tmp_path, monkeypatch):
    """That job, from the recording: whatever is captured in vain is an error there."""
    monkeypatch.setenv("OMNISCV_CACHE", str(tmp_path / "cache"))
    return replace(load(single / "dataset.yaml"), source=str(single / "room.sqlite"))


def test_parts_on_s3_are_the_bytes_of_one_process(single, job, tmp_path):
    with s3_server() as client:
        url = f"s3://{BUCKET}/parted"
        there = replace(job, out=url)
        run_part(there, Part(1, 2))
        listed = client.list_objects_v2(Bucket=BUCKET, Prefix="parted/")["Contents"]
        latest = max(listed, key=lambda each: each["LastModified"])["LastModified"]
        (marker,) = [each for each in listed if each["Key"] == "parted/parts/1-of-2.json"]
        assert marker["LastModified"] == latest  # whose resolution is a second
        made = make(there, shard=(0, 2))
        assert (made.written, made.missing) == (1, 0)
        assert tree_at(url) == tree(single / "dataset")
        again = make(there, existing="resume")
        assert (again.written, again.kept) == (0, 3)
        assert tree_at(url) == tree(single / "dataset")
        with pytest.raises(OmniscvError, match="expected a new folder, got a dataset"):
            make(there, existing="refuse")


def test_a_store_that_is_far_away_and_fails_in_twelve_percent(single, job, tmp_path):
    """Requests wait beside each other, but not all at a time: a frame's files, frames that are looked for."""
    with s3_application(twelve_percent, latency_s=0.05) as (store, _):
        there = replace(job, out=f"s3://{BUCKET}/far")
        assert make(there, shard=(0, 1)).written == 3
        assert 4 <= store.most_waiting <= 64
        store.requests = 0
        store.fault = lambda number: ""
        assert make(there, existing="resume").kept == 3
        assert store.requests < 45
        assert tree_at(f"s3://{BUCKET}/far") == tree(single / "dataset")


def test_a_refused_put_ends_the_run_of_workers_in_one_line(tmp_path):
    """A key that may read only: one process and two workers say the same, at once."""
    path = tmp_path / "job.yaml"
    path.write_text(
        "source: scene://four-wall\n"
        "cameras: {pano: {model: equirectangular, width: 64, height: 32}}\n"
        "poses: [{position: [0, 0, 1.5]}, {position: [0.2, 0, 1.5]}]\n"
        f"modes: [lit]\nface_size: 16\nout: s3://{BUCKET}/refused\n"
    )
    said = []
    with s3_application(lambda number: "read_only"):
        for how in ((), ("--cluster", "local:2")):
            before_s = time.monotonic()
            done = subprocess.run(
                [sys.executable, *OMNISCV, "dataset", "make", str(path), *how],
                capture_output=True, text=True, timeout=120, check=False,
            )  # fmt: skip
            assert time.monotonic() - before_s < 60
            assert done.returncode == 1
            said += [line for line in done.stderr.splitlines() if line.startswith("omniscv: ")]
    assert len(said) == 2, said
    assert all("s3://rooms/refused" in line and "Access Denied" in line for line in said)


def test_a_late_frame_stops_no_other(monkeypatch):
    last = threading.Event()
    waited = []
    with failing_store() as store, omniscv.open_source("scene://four-wall") as source:
        camera = omniscv.cameras.create("equirectangular", 8, 4)
        image = omniscv.render(camera, Pose.from_angles((0, 0, 1.5)), source, ("depth",), face_size=8)
        put = store.put_file

        def put_file(self, local, remote, *values, **options):
            if "room-00.depth." in remote:
                waited.append(last.wait(20))
            put(self, local, remote, *values, **options)
            if remote.endswith("room-10.json"):
                last.set()

        monkeypatch.setattr(store, "put_file", put_file)
        with Writer("failing://bucket/rooms") as writer:
            for i in range(11):
                writer.add(f"room-{i:02d}", image)
            assert len(writer.frames([f"room-{i:02d}" for i in range(11)])) == 11
    assert waited == [True]


def test_a_full_store_is_one_line_and_goes_on_when_there_is_space(single, job, tmp_path, monkeypatch):
    looked = Counter[str]()
    with failing_store(capacity=40_000) as store:
        get = store.get_file

        def get_file(self, name, *values, **options):
            looked[name] += 1
            return get(self, name, *values, **options)

        monkeypatch.setattr(store, "get_file", get_file)
        there = replace(job, out="failing://bucket/parted")
        with pytest.raises(OmniscvError, match="No space left on device; free space there, and run again"):
            make(there, shard=(0, 1))
        assert [count for name, count in looked.items() if "/pano" in name] == [1] * 3
        kept = len([path for path in store.store if path.endswith(".json") and path.count(".") == 1]) - 1
        store.capacity = None
        made = make(there, shard=(0, 1))
        assert (made.written, made.kept) == (3 - kept, kept)
        assert 0 < kept < 3
        assert tree_at("failing://bucket/parted") == tree(single / "dataset")


def test_a_full_disk_is_one_line_and_leaves_no_half_file(single, job, tmp_path, capsys):
    path = described(tmp_path, source=job.source)
    out = tmp_path / "dataset"
    sizes = sorted(each.stat().st_size for each in (single / "dataset").glob("*-*.*"))
    for size in (4000, sizes[-1] + 100):  # EXR's last buffer is written without a check
        with largest_file(size):
            assert cli.run(["dataset", "make", str(path), "--shard", "0/1"]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert "write it, got: File too large; free space there" in line
        assert len(line) <= 310
        for each in out.glob("[!.]*.json"):
            json.loads(each.read_bytes())
        assert not (out / "frames.jsonl").exists()
    assert cli.run(["dataset", "make", str(path), "--shard", "0/1"]) == 0
    assert tree(out) == tree(single / "dataset")
