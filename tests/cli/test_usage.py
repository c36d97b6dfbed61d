"""Commands and their options, which take the place of a job's keys; one clear line when they are wrong."""

import json
import re
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from support.command_line import ROOT

from omniscv.arguments import shown
from omniscv.cli import run
from omniscv.cli.options import IMAGES, JobArguments
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.job import address, load, overridden, read
from omniscv.make import render
from omniscv.sources.recording.inspection import info


def failed(capsys, code, arguments):
    assert run([str(a) for a in arguments]) == code
    printed = capsys.readouterr()
    lines = printed.err.strip().splitlines()
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("omniscv: ")
    assert "Traceback" not in printed.out + printed.err
    return lines[0]


def test_wrong_usage_is_one_line_that_says_what_to_write(capsys, tmp_path, monkeypatch):
    shutil.copy(ROOT / "captures" / "four-wall.sqlite", tmp_path)
    monkeypatch.chdir(tmp_path)
    for arguments, says in (
        ("render --camera fisheye-equidistant --set camera.fov_deg=180 --set camera.focal=100", "focal"),
        ("render --position nan,0,1", "position: expected"),
        ("render --position 0,0", "--position: expected numbers such as 0,0,1.5, got '0,0'"),
        ("render --position 0 0 1.5", "--position: expected numbers with commas: --position 0,0,1.5"),
        ("render --modes lt", "lit, object_mask, depth, normals; got 'lt'; did you mean lit?"),
        ("render --set freeze=hard", "freeze: expected one of auto, puppet, pause, batch, none; got 'hard'"),
        ("render --set truth_scale=9", "truth_scale: expected a whole number <= 8, got 9"),
        ("render --source mock://moon", "moon"),
        ("render four-wall.sqlite", "got a source of captures; write --source four-wall.sqlite"),
        ("render mock://four-wall", "or 'source: mock://four-wall' in a job"),
        ("render --set record=. --size 8x4", "record: expected a file or a free name, got a folder: ."),
        ("render --source four-wall", "a recording, got 'four-wall'; write mock://four-wall"),
        ("render --camera fisheye --size 8x8", "; did you mean fisheye-equidistant?"),
        ("render --set face_sise=8 --size 8x4", "; did you mean face_size?"),
        ("rendr", "No such command 'rendr'. Did you mean 'render', 'send'? (see omniscv --help)"),
        ("render --yaw left", "a valid number, unable to parse string as a number, got 'left'"),
        ("doctor localhost:9000", "got 'localhost:9000'; write unreal://localhost:9000"),
        ("send mock://four-wall vget /objects", "expected it in quotes, such as 'vget /objects'"),
        ("cameras fit double-sphere pinhole --set width=5", "expected width and height in --size"),
        ("record --source four-wall.sqlite --set face_size=1024", "face_size: expected 192 px"),
        ("render --source four-wall.sqlite --set face_size=512 --size 8x4", "or auto; got 512"),
    ):
        assert says in failed(capsys, 2, arguments.split())
        assert not (tmp_path / "out").exists()


def test_a_capture_that_a_recording_lacks_is_described_whole(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for mode, edge in (("lit", 64), ("depth", 32)):
        run(["record", "--modes", mode, "--set", f"face_size={edge}", "--out", "two.sqlite"])
    capsys.readouterr()
    line = failed(capsys, 1, ["render", "--source", "two.sqlite", "--size", "8x4", "--modes", "lit,depth"])
    assert " ... " not in line
    assert "size: 40 x 40 recorded, 72 x 72 px requested; 'omniscv recording places two.sqlite' lists" in line


def test_recording_again_says_how_many_captures_are_new(capsys, tmp_path, monkeypatch):
    """Those of another process in the same file are not counted."""
    path = tmp_path / "one.sqlite"
    opened = render.opened
    arguments = ["record", "--set", "face_size=16", "--out", str(path), "--modes"]
    wanted = ("lit", "6 captures"), ("lit", "6 captures, none new"), ("lit,depth", "12 captures, 6 new")
    for modes, count in wanted:
        assert run([*arguments, modes]) == 0
        assert capsys.readouterr().out == f"{path}: {count}\n"

    def opened_while_another_records(*args):
        monkeypatch.undo()
        assert run([*arguments, "lit,depth"]) == 0
        return opened(*args)

    path.unlink()
    monkeypatch.setattr(render, "opened", opened_while_another_records)
    assert run([*arguments, "lit"]) == 0
    assert capsys.readouterr().out == f"{path}: 12 captures\n{path}: 6 captures\n"


def test_a_command_without_arguments_prints_its_help_with_the_defaults_that_hold(capsys):
    """With a job's file, the job has them."""
    for name in ("render", "record"):
        assert run([name]) == 2
        assert f"Usage: omniscv {name}" in capsys.readouterr().out
    for command, has_defaults in ((["render"], True), (["dataset", "make"], False)):
        run([*command, "--help"])
        assert ("[default: mock://four-wall]" in capsys.readouterr().out) is has_defaults


def test_a_file_where_a_folder_is_wanted(capsys, tmp_path):
    path = tmp_path / "notes"
    path.write_text("dear diary")
    for out, says in (
        (path, "expected a folder or a free name, got a file"),
        (path / "out", "expected to read or write it, got: Not a directory"),
    ):
        line = failed(capsys, 1, ["render", "--source", "scene://waves", "--size", "8x4", "--out", out])
        assert line == f"omniscv: {out}: {says}"
    assert path.read_text() == "dear diary"


def test_a_job_is_recorded_where_the_help_says_and_what_may_be_changed(job, tmp_path, capsys):
    assert run(["record", str(job)]) == 0
    assert capsys.readouterr().out == "capture.sqlite: 12 captures\n"
    out = tmp_path / "two.sqlite"
    sources = ["--source", "mock://six-wall", "--source", "mock://six-wall?latency_ms=1"]
    assert run(["record", str(job), *sources, "--overscan", "9", "--fix-exposure", "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: 12 captures\n"
    assert info(out).captures == {"lit": 6, "object_mask": 6}
    assert info(out).scenes == ["six-wall"]
    job.write_text(job.read_text() + "record: kept.sqlite\n")
    assert run(["record", str(job)]) == 0
    one = info(tmp_path / "capture.sqlite")
    kept = info(tmp_path / "kept.sqlite")
    assert kept.captures == one.captures
    edge, wider = (int(next(iter(held.sizes)).partition("x")[0]) for held in (one, info(out)))
    assert wider > edge


def test_mask_and_rgb_are_other_words_for_modes_and_standard_error_may_be_closed(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)  # as Python has it where it is closed
    small = ["--size", "16x8", "--set", "face_size=16"]
    assert run(["render", *small, "--modes", "mask, rgb,mask", "--out", str(tmp_path)]) == 0
    layers = {f"equirectangular.{name}.png" for name in ("object_mask", "labels", "lit")}
    assert layers <= {path.name for path in tmp_path.iterdir()}
    assert run(["scenes", "moon"]) == 2


def planned(capsys, *arguments):
    assert run(["plan", *arguments]) == 0
    heading, *rows = capsys.readouterr().out.splitlines()
    timed = ["seconds"] if "--measure" in arguments else []
    assert heading.split() == ["strategy", "captures", "Mpx", *timed, "marked", "%"]
    found = {}
    for row in rows:
        way, values = re.fullmatch(r"(.*?) +\d+(?: to \d+)? +(.*?) *", row).groups()
        found[way] = values.split()
        assert len(found[way]) == 2 + len(timed)
    return found


def test_plan_lists_strategies_and_accuracies_and_what_is_marked_where_it_is_known(job, capsys):
    rows = planned(capsys, str(job), "--measure", "--source", "scene://four-wall")
    assert list(rows) == ["auto", "1 %", "0.3 %", "0.1 %", "exact", "cube"]
    ring = ["--camera", "noncentral-panorama", "--set", "camera.radius=1", "--size", "64x32"]
    assert [row[-1] for row in planned(capsys, *ring).values()] == ["3", "1", "0.3", "0.1", "3", "3"]
    few = planned(capsys, *ring, "--set", "viewpoints=4")
    assert [row[-1] for row in few.values()] == ["3", "1", "0.3", "0.1", "3", "unknown"]


BEAT = "narrower than a captured pixel; --set checks=beat compares captures of a second size"


@pytest.mark.parametrize(
    ("options", "lines"),
    [
        (("--modes", "lit,depth"), 1),
        (("--modes", "depth", "--set", "checks=beat"), 0),
        (("--modes", "lit"), 0),  # nothing to compare
        (("--modes", "depth", "--json"), 0),
    ],
    ids=["unchecked", "checked", "colours", "json"],
)
def test_plan_says_what_an_accuracy_does_not_know(capsys, options, lines):
    assert run(["plan", "--size", "32x16", "--set", "face_size=16", *options]) == 0
    assert capsys.readouterr().err.count(BEAT) == lines


def loaded(job, **values):
    values = {name.replace("-", "_"): value for name, value in values.items()}
    return JobArguments(job, IMAGES, values, frozenset(values)).load()


def test_an_option_overrides_its_key(job, capsys):
    """The job without it has another value. One line names it."""
    for options, field, value in (
        ({"modes": "lit"}, "modes", ("lit",)),
        ({"yaw": 0.0}, "poses.0.yaw", 0.0),
        ({"position": "1,0,1.5", "pitch": 10.0}, "poses.0.position.0", 1.0),
        ({"size": "16x8"}, "cameras.pano.width", 16),
        ({"camera": "pinhole", "size": "8x6", "set": ["camera.focal=5"]}, "cameras.pinhole.focal", 5.0),
        ({"out": "elsewhere"}, "out.name", "elsewhere"),
        ({"set": ["face_size=16", "filter=area"]}, "options.face_size", 16),
        ({"set": ["pose.yaw_deg=0"]}, "poses.0.yaw", 0.0),
        ({"set": ["modes=[lit]"]}, "modes", ("lit",)),
        ({"set": ["record=room.sqlite"]}, "record.name", "room.sqlite"),
    ):
        overridden_job = loaded(job, **options)
        assert _field(overridden_job, field) == value
        assert _field(load(job), field) != value
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        assert all(f"--{name} overrides " in line for name in options)


def test_a_wrong_setting_is_refused(job, capsys):
    for setting, says in (
        ("face_size", "KEY=VALUE such as strategy=exact or camera.fov_deg=185, got 'face_size'"),
        ("a..b=1", "--set: expected KEY=VALUE"),
        ("modes=[lit", "--set modes: line 2: expected YAML"),
        ("strateg=cube", "unknown key 'strateg'; did you mean strategy? known keys: source, "),
        ("source.x=1", "source: expected something in which x can be set"),
    ):
        assert run(["render", str(job), "--set", setting]) == 2
        assert says in capsys.readouterr().err


ONE_LENS = ["render", "--source", "scene://four-wall", "--size", "32x32", "--out", "made"]


def test_a_parameter_of_a_camera_is_named_where_it_belongs(capsys):
    assert run([*ONE_LENS, "--camera", "fisheye-equidistant", "--set", "fov_deg=190"]) == 2
    place = "cameras.fisheye-equidistant.fov_deg (--set camera.fov_deg=...)?"
    assert f"unknown key 'fov_deg'; did you mean {place}" in capsys.readouterr().err


def test_models_that_begin_as_a_word_are_listed_first(capsys):
    assert run([*ONE_LENS, "--camera", "fisheye"]) == 2
    listed = capsys.readouterr().err.partition("expected one of ")[2].partition(";")[0].split(", ")
    begin = [name.startswith("fisheye") for name in listed]
    assert begin == sorted(begin, reverse=True)
    assert sum(begin) > 3


def _field(job, path):
    """A value of a job; None where there is none."""
    value = job
    for key in path.split("."):
        if isinstance(value, Pose):
            value = {"position": value.position, "yaw": -round(value.to_unreal()[1][1], 9)}
        if isinstance(value, Mapping):
            value = value.get(key)
        elif key.isdecimal():
            value = value[int(key)]
        else:
            value = getattr(value, key, None)
    return value


def test_each_written_file_is_listed_once(job, capsys):
    command = ["render", str(job), "--set", "poses=[{position: [0, 0, 1.5]}, {position: [0, 0, 1.4]}]"]
    out = job.parent / "out"
    assert run([*command, "--json"]) == 0
    files = sorted(map(str, out.iterdir()))
    assert sorted(json.loads(capsys.readouterr().out)) == files
    assert run(command) == 0
    assert capsys.readouterr().out.startswith(f"{len(files)} files in {out}/\n2 images: 24 captures, at most")


def test_a_command_renders_what_options_make_of_a_job(job, capsys):
    options = ["--size", "16x8", "--modes", "depth", "--stem", "small", "--out", "x"]
    assert run(["render", str(job), *options]) == 0
    printed = capsys.readouterr()
    assert printed.err == (
        f"omniscv: {job}: --size overrides cameras.*.width and cameras.*.height; --modes overrides modes; "
        "--out overrides out\n"
    )
    written = json.loads((job.parent / "x" / "small.json").read_text())
    assert (written["camera"]["width"], written["options"]["face_size"]) == (16, 32)
    assert run(["dataset", "make", str(job), "--size", "16x8", "--out", "y"]) == 0
    assert (job.parent / "y" / "dataset.json").exists()


def test_paths_of_options_are_relative_to_the_present_folder(job, monkeypatch, capsys):
    room = job.parent / "room.sqlite"
    assert run(["record", str(job), "--out", str(room)]) == 0
    (job.parent / "sub").mkdir()
    job = job.rename(job.parent / "sub" / "job.yaml")
    assert run(["render", str(job), "--source", "room.sqlite", "--out", "here"]) == 0
    assert {each.name for each in job.parent.parent.iterdir()} == {"room.sqlite", "sub", "here"}


def test_cameras_of_a_rig_are_not_changed_in_part(job):
    camera = {"model": "pinhole", "width": 8, "height": 8, "fov_deg": 90}
    rig = {"cameras": {"left": {"camera": camera}}}
    described = {"source": "scene://four-wall", "poses": [{"position": [0, 0, 1]}], "rig": rig}
    with pytest.raises(ArgumentError, match=r"cameras\.\*\.width: expected a job without a rig"):
        overridden(described, {"cameras.*.width": 4})
    changed = overridden(described, {"cameras": {"other": camera}, "rig": None, "cameras.*.width": 4})
    assert {name: each.width for name, each in read(changed, Path()).cameras.items()} == {"other": 4}


def test_what_is_overridden_is_not_changed():
    described = {"a": {"x": {"n": 1}, "y": {"n": 2}}, "list": [{"n": 1}], "left": 0}
    before = shown(described)
    found = overridden(described, {"a.*.n": 5, "list.*.n": 6, "new.deep": 7, "left": None})
    assert found == {"a": {"x": {"n": 5}, "y": {"n": 5}}, "list": [{"n": 6}], "new": {"deep": 7}}
    assert shown(described) == before


def test_a_url_keeps_its_slashes(job):
    assert loaded(job, out="s3://bucket/kitchen").out == "s3://bucket/kitchen"
    assert address("s3://bucket/kitchen", Path("/elsewhere")) == "s3://bucket/kitchen"
