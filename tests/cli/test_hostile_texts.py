"""Texts of others on the command line: one short line, exit code 2, and nothing that controls a terminal."""

import os
import subprocess
import sys

import pytest
from test_usage import failed

from omniscv import cli
from omniscv.cli import console
from omniscv.errors import OmniscvError

GOOD = {
    "source": "scene://four-wall",
    "cameras": "{a: {model: equirectangular, width: 8, height: 4}}",
    "poses": "[{position: [0, 0, 1.5]}]",
}
CAMERA = "{{a: {{model: equirectangular, width: {}, height: 4}}}}"
POSE = "[{{position: [0, 0, 1.5], yaw_deg: {}}}]"
WRONG = [
    ("source", "7", "source: expected an address"),
    ("source", '"a\\0b"', "source: expected a text, got 'a\\x00b'"),
    ("cameras", CAMERA.format(".nan"), "cameras.a: width: expected a whole number of pixels"),
    ("cameras", CAMERA.format("9" * 1_000_000), "numbers of at most 64 characters"),
    ("cameras", "{a: {model: pinhole, width: 99999, height: 99999}}", "cameras.a: size: expected at most"),
    ("cameras", "{'': {model: pinhole, width: 8, height: 4}}", "cameras: expected the start of a file name"),
    ("poses", POSE.format(".nan"), "poses[0].yaw_deg: expected a finite number"),
    ("poses", "[{position: [0, 0, 1e300]}]", "position: expected coordinates of at most 1e+09"),
    ("modes", "[[lit]]", "modes[0]: expected a text"),
    ("viewpoints", "1000000000000", "viewpoints: expected a whole number <= 1000000"),
    ("face_size", "true", "face_size: expected 'auto' or"),
    ("max_error_px", "1", "did you mean accuracy?"),
    ("source_options", "{timeout_s: soon}", "source_options.timeout_s: expected a finite number > 0"),
    ("more", "'\x85\u202e'", "unknown key 'more'; did you mean store? known keys: source"),
]


def test_a_field_of_a_job(tmp_path, capsys):
    path = tmp_path / "job.yaml"
    for key, value, says in WRONG:
        path.write_text("\n".join(f"{name}: {text}" for name, text in {**GOOD, key: value}.items()))
        line = failed(capsys, 2, ["render", path])
        assert says in line
        assert "job.yaml" in line
        assert len(line) <= 1000
        assert list(tmp_path.iterdir()) == [path]


def test_a_scene_has_a_bounded_number_of_solids(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("mock_server.scene_file._MOST_SOLIDS", 2)
    path = tmp_path / "scene.yaml"
    path.write_text("objects: {A: {solids: [" + "{sphere: 1, at: [0, 0, 0]}, " * 3 + "]}}")
    assert "at most 2 solids" in failed(capsys, 2, ["render", "--source", f"scene://{path}", "--size", "8x4"])


def test_a_value_on_the_command_line(tmp_path, capsys):
    for options, says in (
        (["--size", "1000000x1000000"], "size: expected at most 134217728 pixels"),
        (["--size", "9" * 5000 + "x1"], "--size: expected WIDTHxHEIGHT"),
        (["--set", "face_size=" + "9" * 5000], "--set face_size: line 1: expected numbers of at most 64"),
        (["--most-captures", "9" * 5000], "Invalid value for '--most-captures'"),
        (["--position", "0,0,1e308"], "position: expected coordinates of at most 1e+09"),
        (["--source", "unreal://[::1"], "source: expected unreal://host:port"),
        (["--camera", "\x1b[31m\u202e[b]"], r"got '\x1b[31m\u202e[b]'"),
    ):
        line = failed(capsys, 2, ["render", "--size", "8x4", "--out", tmp_path / "out", *options])
        assert says in line
        assert len(line) <= 1000
        assert not (tmp_path / "out").exists()


WILD = "\x1b[31m\x07\u202e\u200b\x85\n[/b][bold]\udcff"
TAME = r"\x1b[31m\x07\u202e\u200b\x85\n[/b][bold]\udcff"


def test_what_is_printed_cannot_control_the_terminal(capsys):
    console.line(WILD)
    console.table(("name",), [(WILD,)])
    console.error(f"name {WILD}")
    printed = capsys.readouterr()
    assert printed.out.splitlines()[0] == TAME
    assert printed.out.splitlines()[2].strip() == TAME
    assert printed.err == f"omniscv: name {TAME}\n".replace(r"\x85\n", " ")
    assert str(OmniscvError(WILD)) == TAME.replace(r"\x85\n", " ")


def test_a_name_that_the_terminal_cannot_show(tmp_path):
    scene = "# A ball.\n{objects: {B: {solids: [{sphere: 1, at: [0, 0, 0]}]}}}"
    (tmp_path / "caf\u00e9.yaml").write_text(scene)
    command = [sys.executable, "-c", "from omniscv.cli import main; main()", "scenes", "caf\u00e9.yaml"]
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "1"}
    done = subprocess.run(command, cwd=tmp_path, env=ascii_only, capture_output=True, check=False)
    assert done.stderr == b""
    assert done.stdout.startswith(b"caf\\xe9: A ball.\n")


def test_a_long_error_keeps_its_beginning_and_its_end(capsys):
    message = str(OmniscvError(f"job.yaml: a: expected b, got {'x' * 10_000}, in the end"))
    assert len(message) == 1000
    assert message.startswith("job.yaml: a: expected b, got xxx")
    assert message.endswith("xxx, in the end")
    assert cli.run(["serve", "x" * 5000, "--port", "0"]) == 2  # too long for a file
    assert "scene: expected one of courtyard" in capsys.readouterr().err


@pytest.mark.timeout(60)
@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes in folders")
def test_a_named_pipe_hangs_no_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("p.yaml")
    os.mkfifo("p.sqlite")
    for words in (
        *("job p.yaml", "render p.yaml", "plan p.yaml", "dataset make p.yaml", "look p.yaml", "serve p.yaml"),
        *("doctor p.sqlite", "recording check p.sqlite", "recording import . a.sqlite --layout p.yaml"),
        *("evaluate odometry --trajectory p.yaml", "render --size 8x4 --camera p.yaml"),
    ):
        assert cli.run(words.split()) in (1, 2), words
        assert len(capsys.readouterr().err.splitlines()) == 1, words
