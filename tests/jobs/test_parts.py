"""Parts of a job: pure, exhaustive, without captures that are made twice, and joined into the same bytes."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import groupby, pairwise
from threading import Barrier
from typing import ClassVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.datasets import job_file, made, tree

import omniscv
from omniscv import dataset
from omniscv.dataset.beginning import SCRATCH
from omniscv.dataset.manifest import FRAMES
from omniscv.errors import ArgumentError, DatasetError
from omniscv.geometry import Pose
from omniscv.job import load
from omniscv.make import Part, finish, make, run_part
from omniscv.sources.base import SourceWrapper
from omniscv.sources.recording import part_file
from omniscv.sources.recording.inspection import info
from omniscv.sources.registry import open_source
from omniscv.storage.local import scratch_folder


class Counted(SourceWrapper):
    requests: ClassVar = Counter()

    def capture(self, requests):
        for capture in super().capture(requests):
            Counted.requests[capture.request] += 1
            yield capture


@pytest.fixture
def counted():
    omniscv.sources.register("counted", lambda address: Counted(open_source("scene://four-wall")))
    Counted.requests.clear()
    return Counted.requests


def job_of(folder, **fields):
    first = (0, 0, 1.5)
    second = (0.5, 0.2, 1.5)
    third = (-1, 0.5, 1)
    turns = ((first, 0), (second, 40), (second, 130), (third, 0), (third, 90))
    poses = tuple(Pose.from_angles(position, yaw_deg=yaw) for position, yaw in turns)
    times_ns = (0, 500, 600, 1000, 2000)
    known = {"times_ns": times_ns, "places": ("middle", "middle", "middle", "corner", "corner")}
    job = load(job_file(folder, source="counted:room"))
    return replace(job, poses=poses, modes=("lit", "object_mask"), **known, **fields)


AT = [Pose.from_angles((place, 0, 0)) for place in range(4)]


@settings(max_examples=50)
@given(st.lists(st.integers(0, 3), max_size=40), st.integers(1, 50))
def test_every_pose_is_in_one_part_and_one_position_in_as_few_as_can_hold_it(places, count):
    poses = [AT[place] for place in places]
    found = [Part(i, count).poses(poses) for i in range(count)]
    assert [i for each in found for i in each] == list(range(len(poses)))
    runs = [len(list(run)) for _, run in groupby(places)]
    run_of = [length for length in runs for _ in range(length)]
    for before, after in pairwise(each for each in found if each):
        if places[before[-1]] == places[after[0]]:
            assert run_of[after[0]] > len(poses) // count  # one part cannot hold it
    assert all(len(each) <= 2 * -(-len(poses) // count) for each in found)
    with pytest.raises(ArgumentError, match=r"part\.(index|count): expected a whole number"):
        Part(count, count)


def test_parts_make_the_captures_and_bytes_of_one_process(counted, tmp_path):
    job = job_of(tmp_path)
    make(replace(job, out=tmp_path / "single"))
    single = Counter(counted)
    wanted = tree(tmp_path / "single")
    counted.clear()
    parted = replace(job, out=tmp_path / "parted")
    parts = [Part(i, 3) for i in (2, 0, 1)]
    assert sum(run_part(parted, part).written for part in parts) == len(job)
    assert counted == single
    counted.clear()
    assert sum(run_part(parted, part).kept for part in parts) == len(job)
    assert not counted
    for _ in range(2):  # another process may be just as late
        finish(parted, 3)
        assert tree(parted.out) == wanted
    assert dataset.check(parted.out, deep=True) == []


def test_damaged_markers_and_lost_files_are_made_again(counted, tmp_path):
    job = job_of(tmp_path)
    for i in range(2):
        run_part(job, Part(i, 2))
    make(replace(job, out=tmp_path / "single"))
    marker = job.out / "parts" / "1-of-2.json"
    whole = marker.read_bytes()
    for damaged in (whole[:-9], whole.replace(b'"split"', b'"split "', 1), b"[]", b""):
        marker.write_bytes(damaged)
        with pytest.raises(DatasetError, match="part 1 has none; make it again with --shard 1/2"):
            finish(job, 2)
        counted.clear()
        assert run_part(job, Part(1, 2)).written == 0  # its frames are whole
        assert not counted
        assert marker.read_bytes() == whole
    (job.out / "lens-0.labels.png").unlink()
    assert run_part(job, Part(0, 2)).written == 1
    finish(job, 2)
    assert tree(job.out) == tree(tmp_path / "single")


def test_a_shard_of_a_complete_dataset_leaves_it_complete(tmp_path):
    out = made(tmp_path)
    before = tree(out)
    job = load(tmp_path / "dataset.yaml")
    for shard in ((0, 3), (2, 5)):
        done = make(job, shard=shard)
        assert (done.written, done.missing) == (0, 0)
        assert tree(out) == before
    with pytest.raises(ArgumentError, match="expected"):  # of another world
        make(replace(job, source="scene://six-wall"), shard=(0, 3))


def test_parts_record_into_files_of_their_own(counted, tmp_path):
    """Poses at one position share captures in a recording: all parts capture what one process does."""
    job = job_of(tmp_path, record=tmp_path / "room.sqlite")
    make(replace(job, out=tmp_path / "single"))
    single = Counter(counted)
    counted.clear()
    for i in range(3):
        run_part(job, Part(i, 3))
    assert counted == single
    each = [info(path).captures["lit"] for path in (part_file(job.record, i, 3) for i in range(3))]
    assert sum(each) == info(job.record).captures["lit"]


def test_two_makers_of_one_part(tmp_path):
    job = load(job_file(tmp_path))
    make(replace(job, out=tmp_path / "single"))
    together = Barrier(2)

    def run(_):
        together.wait(60)
        return run_part(job, Part())

    with ThreadPoolExecutor(2) as both:
        made = list(both.map(run, range(2)))
    assert all(each.written + each.kept == len(job) for each in made)
    finish(job, 1)
    assert tree(job.out) == tree(tmp_path / "single")
    assert dataset.check(job.out, deep=True) == []


def test_files_that_a_killed_writer_had_moved_are_its_own_and_those_of_others_are_not(tmp_path):
    """A frame's files are moved before its ``KEY.json``: if that is left behind, it lists them."""
    out = (job := load(job_file(tmp_path))).out
    make(job)
    before = tree(out)
    last = next(path for path in sorted(out.glob("*.json")) if path.name.startswith("pano"))
    record = last.read_bytes()
    for name in (FRAMES, last.name):
        (out / name).unlink()
    with pytest.raises(ArgumentError, match=rf"{last.stem}\.\w+\.\w+"):
        make(job, existing="resume")
    scratch = out / ".omniscv-0123456789abcdef"
    scratch.mkdir()
    (scratch / last.name).write_bytes(record)
    make(job, existing="resume")
    assert tree(out) == before


def test_finishing_removes_what_killed_writers_left_and_nothing_else(tmp_path):
    out = (job := load(job_file(tmp_path))).out
    left = [out / ".omniscv-0123456789abcdef/pano-0.lit.png", out / ".dataset.0123456789abcdef.json"]
    mine = [".settings.json", ".frames.jsonl.bak", ".dataset.backup.json", ".omniscv-notes/mine"]
    for path in (*left, *(out / name for name in mine)):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(path.name)
    make(job, existing="resume")
    assert not any(path.exists() for path in (*left, left[0].parent))
    assert [(out / name).read_text() for name in mine] == [name.rpartition("/")[2] for name in mine]
    assert dataset.check(out) == []
    with scratch_folder(tmp_path, SCRATCH) as other:  # of a writer that is not dead
        (other / "pano-0.lit.png").write_bytes(b"half")
        with dataset.Writer(tmp_path):
            pass
        assert (other / "pano-0.lit.png").read_bytes() == b"half"
