"""One part made by two at a time, as where a worker that was taken for dead goes on: the same bytes."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier

from support.datasets import job_file, tree

from omniscv import dataset
from omniscv.dataset import writer
from omniscv.job import load
from omniscv.make import Part, finish, make, run_part
from omniscv.storage.local import scratch_folder


def test_two_makers_of_one_part(tmp_path):
    job = load(job_file(tmp_path))
    job = replace(job, poses=job.poses * 3, times=None, places=None)
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


def test_finishing_removes_scratch_of_killed_writers(tmp_path):
    job = load(job_file(tmp_path))
    make(replace(job, out=tmp_path / "single"))
    left = job.out / ".omniscv-0123456789abcdef"
    left.mkdir(parents=True)
    (left / "pano-0.lit.png").write_bytes(b"half")
    (job.out / ".dataset.0123456789abcdef.json").write_bytes(b"half")
    make(job, resume=True)
    assert tree(job.out) == tree(tmp_path / "single")
    assert not left.exists()


def test_hidden_files_of_the_user_stay(tmp_path):
    job = load(job_file(tmp_path))
    job.out.mkdir()
    mine = [job.out / ".settings.json", job.out / ".frames.jsonl.bak", job.out / ".dataset.backup.json"]
    for path in mine:
        path.write_text("mine")
    (job.out / ".omniscv-notes").mkdir()
    make(job)
    assert [path.read_text() for path in mine] == ["mine"] * 3
    assert (job.out / ".omniscv-notes").is_dir()


def test_a_writer_that_finishes_spares_the_scratch_folders_of_others(tmp_path):
    with scratch_folder(tmp_path, writer._SCRATCH) as mine:
        (mine / "pano-0.lit.png").write_bytes(b"half")
        with dataset.Writer(tmp_path):
            pass
        assert (mine / "pano-0.lit.png").read_bytes() == b"half"
    assert not mine.exists()
