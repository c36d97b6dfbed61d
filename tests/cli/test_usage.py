"""Commands and their options: what they do, and one clear line when something is wrong."""

import re
import shutil
import sys

import pytest
from support.command_line import ROOT

from omniscv.cli import run
from omniscv.make import render
from omniscv.sources.recording.inspection import info


def failed(capsys, code, arguments):
    """The one line that a failing command prints."""
    assert run([str(a) for a in arguments]) == code
    printed = capsys.readouterr()
    lines = printed.err.strip().splitlines()
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("omniscv: ")
    assert "Traceback" not in printed.out + printed.err
    return lines[0]


def names_in(folder):
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
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
    ],
)
def test_wrong_usage_is_one_line_that_says_what_to_write(arguments, says, capsys, tmp_path, monkeypatch):
    shutil.copy(ROOT / "captures" / "four-wall.sqlite", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert says in failed(capsys, 2, arguments.split())
    assert not (tmp_path / "out").exists()


def test_a_capture_that_a_recording_lacks_is_described_whole(capsys, tmp_path, monkeypatch):
    """Also where a file has captures of several sizes."""
    monkeypatch.chdir(tmp_path)
    for mode, edge in (("lit", 64), ("depth", 32)):
        run(["record", "--modes", mode, "--set", f"face_size={edge}", "--out", "two.sqlite"])
    capsys.readouterr()
    line = failed(capsys, 1, ["render", "--source", "two.sqlite", "--size", "8x4", "--modes", "lit,depth"])
    assert " ... " not in line
    assert "size: 40 x 40 recorded, 72 x 72 px requested; 'omniscv recording places two.sqlite' lists" in line


def test_recording_again_says_how_many_captures_are_new(capsys, tmp_path):
    path = tmp_path / "one.sqlite"
    wanted = ("lit", "6 captures"), ("lit", "6 captures, none new"), ("lit,depth", "12 captures, 6 new")
    for modes, count in wanted:
        assert run(["record", "--modes", modes, "--set", "face_size=16", "--out", str(path)]) == 0
        assert capsys.readouterr().out == f"{path}: {count}\n"


def test_captures_of_another_process_in_the_same_file_are_not_counted(capsys, tmp_path, monkeypatch):
    path, opened = tmp_path / "one.sqlite", render.opened
    arguments = ["record", "--set", "face_size=16", "--out", str(path), "--modes"]

    def opened_while_another_records(*args):
        monkeypatch.undo()
        assert run([*arguments, "lit,depth"]) == 0
        return opened(*args)

    monkeypatch.setattr(render, "opened", opened_while_another_records)
    assert run([*arguments, "lit"]) == 0
    assert capsys.readouterr().out == f"{path}: 12 captures\n{path}: 6 captures\n"


def test_a_command_without_arguments_prints_its_help_with_the_defaults_that_hold(capsys):
    """With a job's file, the job has them."""
    for name in ("render", "record"):
        assert run([name]) == 2
        assert f"Usage: omniscv {name}" in capsys.readouterr().out
    for command, shown in ((["render"], True), (["dataset", "make"], False)):
        run([*command, "--help"])
        assert ("[default: mock://four-wall]" in capsys.readouterr().out) is shown


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


def test_a_command_without_standard_error(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "stderr", None)  # as Python has it where it is closed
    assert run(["render", "--source", "scene://waves", "--size", "8x4", "--out", str(tmp_path)]) == 0
    assert run(["scenes", "moon"]) == 2


def test_what_a_recording_may_change_of_its_job(job, tmp_path, capsys):
    """Another source, another file, and wider faces."""
    out = tmp_path / "two.sqlite"
    sources = ["--source", "mock://six-wall", "--source", "mock://six-wall?latency_ms=1"]
    assert run(["record", str(job), *sources, "--overscan", "9", "--fix-exposure", "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: 12 captures\n"
    held = info(out)
    assert held.captures == {"lit": 6, "object_mask": 6}
    assert held.scenes == ["six-wall"]
    assert run(["record", str(job), "--out", str(tmp_path / "one.sqlite")]) == 0
    names = "one.sqlite", "two.sqlite"
    edge, wider = (int(next(iter(info(tmp_path / name).sizes)).partition("x")[0]) for name in names)
    assert wider > edge


def test_a_job_without_a_recording_is_recorded_where_the_help_says(job, tmp_path, capsys):
    assert run(["record", str(job)]) == 0
    assert capsys.readouterr().out == "capture.sqlite: 12 captures\n"
    job.write_text(job.read_text() + "record: kept.sqlite\n")
    assert run(["record", str(job)]) == 0
    assert info(tmp_path / "kept.sqlite").captures == info(tmp_path / "capture.sqlite").captures


def test_mask_and_rgb_are_other_words_for_modes(tmp_path, capsys):
    small = ["--size", "16x8", "--set", "face_size=16"]
    assert run(["render", *small, "--modes", "mask, rgb,mask", "--out", str(tmp_path)]) == 0
    layers = {f"equirectangular.{name}.png" for name in ("object_mask", "labels", "lit")}
    assert layers <= names_in(tmp_path)


def planned(capsys, *arguments):
    """The rows of a plan, by their first column."""
    assert run(["plan", *arguments]) == 0
    heading, *rows = capsys.readouterr().out.splitlines()
    assert heading.split() == ["strategy", "captures", "Mpx", "seconds", "marked", "%"]
    split = (re.fullmatch(r"(.*?) +\d+(?: to \d+)? +(\S+) +(\S+) +(\S+) *", row) for row in rows)
    return {row[1]: [row[2], row[3], row[4]] for row in split}


def test_plan_lists_every_strategy_and_three_accuracies(job, capsys):
    rows = planned(capsys, str(job), "--measure", "--source", "scene://four-wall")
    assert list(rows) == ["auto", "1 %", "0.3 %", "0.1 %", "exact", "cube"]


def test_plan_says_what_is_marked_where_it_is_known(capsys):
    ring = ["--camera", "noncentral-panorama", "--set", "camera.radius=1", "--size", "64x32"]
    assert [row[-1] for row in planned(capsys, *ring).values()] == ["3", "1", "0.3", "0.1", "3", "3"]
    few = planned(capsys, *ring, "--set", "viewpoints=4")
    assert [row[-1] for row in few.values()] == ["3", "1", "0.3", "0.1", "unknown", "unknown"]
