"""Datasets of version 0.2.0, which kept no record of what they are made of, are read and continued."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from support.datasets import image, tree

from omniscv import Pose, dataset
from omniscv.errors import ArgumentError
from omniscv.job import load
from omniscv.make import make

MADE = Path(__file__).parent / "made_by_0_2"


@pytest.fixture
def made(tmp_path):
    """A copy of them, with the scene and the jobs."""
    shutil.copytree(MADE, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.parametrize("name", ["job", "moving", "written"])
def test_they_are_read_and_checked(name, made):
    assert dataset.check(made / name, deep=True) == []
    assert all(frame.layer("lit").shape[2] == 3 for frame in dataset.open(made / name))


@pytest.mark.parametrize("name", ["job", "moving"])
def test_a_job_that_is_complete_changes_no_frame(name, made):
    before = tree(made / name)
    done = make(load(made / f"{name}.yaml"), existing="resume")
    assert (done.written, done.missing) == (0, 0)
    after = tree(made / name)
    changed = {key for key in after if after[key] != before.get(key)}
    assert changed <= {"dataset.json", "exports/coco/.exported.json"}
    assert dataset.check(made / name, deep=True) == []


def test_a_pose_is_appended(made):
    job = load(made / "job.yaml")
    poses = (*job.poses, Pose.from_angles((1.4, -1.2, 1.3)))
    done = make(replace(job, poses=poses), existing="resume")
    assert (done.written, done.kept) == (2, 6)
    assert dataset.check(made / "job", deep=True) == []
    assert len(dataset.manifest.read(made / "job").origin.runs) == 1  # the same version


def test_whether_it_watched_is_not_known(made):
    job = load(made / "job.yaml")
    watched = replace(job, recipe=replace(job.recipe, watch="mark"))
    for _ in range(2):
        assert make(watched, existing="resume").written == 0
    with pytest.raises(ArgumentError, match="watch is 'mark', in the job None"):
        make(job, existing="resume")


def test_one_that_was_interrupted_is_finished(made):
    complete = tree(made / "job")
    for path in [*(made / "job").glob("pano-2.*"), made / "job" / "frames.jsonl"]:
        path.unlink()
    shutil.rmtree(made / "job" / "exports")
    done = make(load(made / "job.yaml"), existing="resume")
    assert (done.written, done.kept) == (2 - 1, 5)
    after = tree(made / "job")
    assert {key: after[key] for key in complete if "pano-2" not in key and key != "dataset.json"} == {
        key: complete[key] for key in complete if "pano-2" not in key and key != "dataset.json"
    } | {"frames.jsonl": after["frames.jsonl"]}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"modes": ("object_mask", "depth")},
            r"options.modes is \['lit', .*in the job \['object_mask', 'depth'\]",
        ),
        ({"source": "scene://four-wall"}, r"frame lens-0 has scene 'room\.scene/"),
        ({"poses": (Pose.from_angles((0.1, 0, 1.5)),) * 3}, "frame lens-0 has pose"),
    ],
    ids=["modes", "world", "poses"],
)
def test_another_job_is_refused(change, says, made):
    before = tree(made / "job")
    with pytest.raises(ArgumentError, match=says):
        make(replace(load(made / "job.yaml"), **change), existing="resume")
    assert tree(made / "job") == before


def test_a_writer_goes_on(made):
    with dataset.Writer(made / "written", resume=True) as writer:
        assert writer.add("turn-2", image(source=f"scene://{made / 'room.scene.yaml'}", width=16))
    assert len(dataset.open(made / "written")) == 3
    assert dataset.check(made / "written", deep=True) == []


def test_it_is_replaced_with_its_exports(made):
    job = load(made / "job.yaml")
    make(replace(job, recipe=replace(job.recipe, exports=())), existing="replace")
    assert not (made / "job" / "exports").exists()
    assert dataset.check(made / "job", deep=True) == []
