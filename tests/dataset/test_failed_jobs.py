"""A job that fails or is killed is no dead end: refused before it captures, taken up, resumed, replaced."""

import json

import pytest
from support.datasets import job_file, tree
from support.killed import moments

from omniscv import dataset, make
from omniscv.cli import run
from omniscv.dataset import manifest
from omniscv.errors import DatasetError, SourceError
from omniscv.frame import FileEntry
from omniscv.job import load
from omniscv.make.frames import FrameMaker
from omniscv.truth import registry as truths

CAMERAS = """
cameras:
  pano: {model: equirectangular, width: 64, height: 32}
  ahead: {model: pinhole, width: 16, height: 8, fov_deg: 20}
face_size: 192
out: made
"""
TWO = "[{position: [0, 0, 1.5]}, {position: [1, 0, 1.5]}]"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Cube maps at one place, in a room that the file does not describe."""
    path = tmp_path_factory.mktemp("recorded") / "room.sqlite"
    asked = ["--modes", "lit,mask,depth,normals", "--set", "face_size=192", "--out", str(path)]
    assert run(["record", *asked]) == 0
    return path


@pytest.fixture
def made(tmp_path, monkeypatch, recording):
    """A function that makes a dataset of the recording by the command line; its exit code."""
    monkeypatch.chdir(tmp_path)

    def make(more, *options, source=recording, poses="[{position: [0, 0, 1.5]}]"):
        (tmp_path / "job.yaml").write_text(f"source: {source}\nposes: {poses}\n{CAMERAS}{more}\n")
        return run(["dataset", "make", "job.yaml", *options])

    return make


def stderr(capsys):
    (line,) = capsys.readouterr().err.splitlines()
    return line


def fails(*_):
    raise SourceError("expected a calm sea")


def fitted(modes):
    return f"modes: [{modes}]\ntruth: {{layout: {{source: fitted}}}}"


def test_jobs_are_checked_before_the_first_capture(made, tmp_path, capsys):
    for more, options, says in (
        (fitted("lit, mask, depth"), {}, "truth.layout: expected modes with normals, because"),
        ("modes: [lit, mask]\ntruth: {amodal: true}", {}, "truth.amodal: source: expected one that can hide"),
        ("modes: [lit]", {"poses": TWO}, "differs in position by 1 m"),
        ("truth: {boxes: {cameras: [side]}}\nmodes: [mask]", {}, "boxes.cameras: expected one of pano"),
    ):
        assert made(more, **options) != 0
        assert says in stderr(capsys)
        assert not (tmp_path / "made").exists()


def test_a_folder_without_frames_is_taken_up(made, tmp_path, monkeypatch):
    """As it is left where the first frame fails."""
    with monkeypatch.context() as patch:
        patch.setattr(FrameMaker, "run", fails)
        assert made("modes: [lit]") == 1
    assert (tmp_path / "made" / "dataset.json").exists()
    assert made("modes: [lit, depth]") == 0
    assert {frame.key for frame in dataset.open("made")} == {"pano", "ahead"}


def test_a_dataset_with_frames_is_completed_or_replaced_by_name(made, tmp_path, capsys):
    assert made("modes: [lit]") == 0
    (tmp_path / "made" / "notes.txt").write_text("mine")
    capsys.readouterr()
    assert made("modes: [lit, depth]", "--resume") == 2
    refused = stderr(capsys)
    assert "its options.modes is ['lit'], in the job ['lit', 'depth']; write elsewhere, or" in refused
    assert refused.endswith(": omniscv dataset make job.yaml --overwrite")
    assert made("modes: [lit]\nexport: [colmap]") == 0  # no frame depends on exports
    assert dataset.check("made", format="colmap", deep=True) == []
    assert made("modes: [lit, nothing]", "--overwrite") == 2
    assert made("truth: {amodal: true}\nmodes: [mask]", "--overwrite") == 2
    assert len(dataset.open("made")) == 2  # a job that is refused removes nothing
    assert made("modes: [depth]", "--overwrite") == 0
    assert dataset.check("made", deep=True) == []
    names = {path.name for path in (tmp_path / "made").iterdir()}
    assert {"notes.txt", "pano.depth.exr"} <= names
    assert not any("lit" in name for name in names)


def test_a_truth_that_a_camera_cannot_carry_is_left_out_unless_it_is_named(made, tmp_path, capsys):
    """A narrow view ahead shows neither floor nor ceiling."""
    more = fitted("lit, mask, depth, normals")
    assert made(more + "\nexport: [{format: horizonnet, cameras: [pano]}]") == 0
    assert stderr(capsys).startswith("omniscv: ahead: truth.layout: layout: expected images that show")
    layouts = {"pano": True, "ahead": False}
    assert {frame.key: "layout" in frame.files for frame in dataset.open("made")} == layouts
    assert [path.stem for path in (tmp_path / "made" / "exports" / "horizonnet").rglob("*.txt")] == ["pano"]
    assert dataset.check("made", deep=True) == []
    assert made(more.replace("fitted", "fitted, cameras: [ahead]"), "--overwrite") == 2
    assert "ahead: truth.layout: layout: expected" in stderr(capsys)
    assert made(more.replace("fitted", "fitted, cameras: [pano]"), "--overwrite") == 0
    assert capsys.readouterr().err == ""
    assert {frame.key: "layout" in frame.files for frame in dataset.open("made")} == layouts


def test_a_frame_that_fails_is_left_out_and_made_later(made, monkeypatch, capsys):
    faults = {"ahead"}

    def derive(frame, options):
        if frame.key in faults:
            raise DatasetError("expected a calm sea")
        return {}

    truths.names()
    monkeypatch.setitem(truths._TRUTHS, "calm", truths.Truth("calm", derive))
    assert made("truth: {calm: true}") == 1
    capsys.readouterr()
    assert made("truth: {calm: true}", "--keep-going", "--overwrite") == 1
    printed = capsys.readouterr()
    left_out, again = printed.err.splitlines()
    assert left_out == "omniscv: ahead: expected a calm sea; left out"
    assert again.endswith(" again: omniscv dataset make job.yaml --keep-going")
    assert "1 frames made, 0 kept, 1 failed; complete" in printed.out
    assert [frame.key for frame in dataset.open("made")] == ["pano"]
    faults.clear()
    assert make.make(load("job.yaml"), existing="resume") == make.Made(1, 1)
    assert [frame.key for frame in dataset.open("made")] == ["ahead", "pano"]


KILLS = 2
SOAK_KILLS = 20
NUMBERS = [KILLS, pytest.param(SOAK_KILLS, marks=[pytest.mark.soak, pytest.mark.timeout(1200)])]
EXPORT = "export: [webdataset, coco]\n"


def seen(out):
    """How many frames are complete; every file that can be seen is whole."""
    # A file is written under a hidden name, which a kill may leave, until it is whole.
    records = [path for path in out.glob("*.json") if not path.name.startswith(".")]
    for path in records:
        json.loads(path.read_bytes())
    frames = [json.loads(path.read_bytes()) for path in records if path.name != manifest.DATASET]
    entries = [FileEntry(**each) for one in frames for each in one["frame"]["files"].values()]
    assert {entry.fault(out) for entry in entries} <= {None}
    for path in out.glob("[!.]*.png"):
        assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
    return len(frames)


@pytest.mark.parametrize("kills", NUMBERS)
def test_killed_and_resumed_is_as_if_it_had_not_been_killed(kills, processes, tmp_path):
    processes.run("warm")
    whole_s = processes.run("make", job_file(tmp_path, out="whole", more=EXPORT))
    wanted = tree(tmp_path / "whole")
    complete = []
    for number, moment_s in enumerate(moments(kills, whole_s, complete)):
        job = job_file(tmp_path, out=f"killed-{number}", more=EXPORT)
        out = tmp_path / f"killed-{number}"
        processes.run("make", job, kill_after_s=moment_s)
        complete.append(seen(out))
        processes.run("make", job)
        assert tree(out) == wanted
    print(f"killed {kills} times within {whole_s:.2f} s: {complete} frames were complete")
    assert max(complete) > 0
    assert dataset.check(out, deep=True) == []
