"""Commands that list and describe: help, jobs, scenes, places of a recording; and the shell's completion."""

import json
import os
import re
import subprocess
import sys
from typing import get_type_hints

import numpy as np
import pytest
import yaml
from support.command_line import ROOT

import mock_server
import omniscv
from omniscv import cameras
from omniscv.cli import COMMANDS, run
from omniscv.job import EXAMPLE, keys, load
from omniscv.make import check_dataset
from omniscv.planning import RenderKeywords, RenderOptions
from omniscv.sources.recording.inspection import centers, info

RECORDING = ROOT / "captures" / "four-wall.sqlite"


def test_the_example_of_a_job_has_every_key_and_loads(tmp_path, capsys):
    assert run(["job", "--example"]) == 0
    text = capsys.readouterr().out
    given = yaml.safe_load(text)
    assert given == yaml.safe_load(EXAMPLE.read_text())
    top = {key.name for key in keys() if "." not in key.name}
    assert set(given) == top
    assert all(f"# {key.help}\n" in text for key in keys() if "." not in key.name)
    assert not re.search(r"\n# (?!--).*\n\w+:.*#", text), "a key with two comments"
    path = tmp_path / "job.yaml"
    path.write_text(text)
    job = load(path)
    assert job.options == RenderOptions()  # as the comment says
    check_dataset(job)
    assert run(["job", str(path)]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"{path}: 4 cameras at 2 poses, of mock://workshop\n")
    assert all(f"\n{name}: " in printed for name in job.cameras)
    assert list(tmp_path.iterdir()) == [path]


def test_every_key_is_listed_with_its_meaning_or_an_example_or_a_job(capsys):
    assert run(["job", "--keys"]) == 0
    text = capsys.readouterr().out
    assert all(key.help and f"{key.name} " in text for key in keys())
    for arguments in ([], ["job.yaml", "--example"], ["--keys", "--example"]):
        assert run(["job", *arguments]) == 2
        assert "job: expected one of JOB.yaml, --example and --keys" in capsys.readouterr().err


def test_keywords_of_render_are_its_options():
    """The one second declaration: type checkers know keyword arguments by it."""
    assert get_type_hints(RenderKeywords) | {"accuracy": float | None} == get_type_hints(RenderOptions)


def test_scenes_are_listed_and_described(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert run(["scenes"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert set(lines) == {"scene", *mock_server.scene_names()}
    assert all(mock_server.summary(name) in lines[name] != "" for name in mock_server.scene_names())
    mine = tmp_path / "mine.yaml"
    mine.write_text("# A ball\n# in the dark.\nobjects: {Ball: {solids: [{sphere: 0.5, at: [1, 2, 3]}]}}\n")
    assert run(["scenes", str(mine)]) == 0
    first, _, ball = capsys.readouterr().out.splitlines()
    assert first == "mine: A ball in the dark."
    assert ball.split() == ["Ball", "0.5", "1.5", "2.5", "1.5", "2.5", "3.5"]
    assert run(["scenes", "moon"]) == 2
    assert "moon" in capsys.readouterr().err


def printed_json(capsys, *arguments):
    assert run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_scenes_models_and_plans_as_json(capsys):
    listed = printed_json(capsys, "scenes")
    assert [each["scene"] for each in listed] == mock_server.scene_names()
    scene = mock_server.load_scene("workshop")
    objects = printed_json(capsys, "scenes", "workshop")["objects"]
    assert {name for name, each in objects.items() if each["moves"]} == set(scene.moving)
    assert all(np.array_equal(objects[name]["box_m"], scene.bounds(name)) for name in scene.objects)
    models = printed_json(capsys, "cameras")
    assert all(re.fullmatch(r"[^\n]{5,100}[\w)`]", each["summary"]) for each in models), "cut in the middle"
    central = {each["model"]: each["kind"] == "central" for each in models}
    assert central == {name: cameras.model(name).central for name in cameras.names()}
    plan = printed_json(capsys, "plan", "--size", "64x32", "--set", "face_size=16")
    assert {each["way"]: each["requests"] for each in plan}["cube"] == 6


def test_places_of_a_recording(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert run(["recording", "places", str(RECORDING), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    held = info(RECORDING)
    positions = np.array([each["center"] for each in found])
    assert len(np.unique(positions.round(6), axis=0)) == len(found) == held.centers
    for mode, count in held.captures.items():
        assert sum(each["captures"].get(mode, 0) for each in found) == count
    assert max(each["last"] for each in found) == held.last
    assert run(["recording", "places", str(RECORDING)]) == 0
    _, *rows = capsys.readouterr().out.splitlines()
    assert len(rows) == len(centers(RECORDING))
    assert " ".join(rows[0].split()) == "0 0 1.5 6 depth 6 lit 6 normals 6 object_mask still"


BASH = """
source <("$PYTHON" -c "$PROGRAM" --show-completion)
omniscv() { "$PYTHON" -c "$PROGRAM" "$@"; }
complete_words() {
  COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
  COMPREPLY=($(COMP_WORDS="${COMP_WORDS[*]}" COMP_CWORD=$COMP_CWORD _OMNISCV_COMPLETE=complete_bash omniscv))
  echo "${COMPREPLY[@]}"
}
complete -p omniscv
complete_words omniscv ""
complete_words omniscv render --camera fisheye-eq
"""


def test_bash_completes_commands_and_models():
    program = "from omniscv.cli import main; main()"
    more = {"PYTHON": sys.executable, "PROGRAM": program, "SHELL": "/bin/bash", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "-c", BASH], env={**os.environ, **more}, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    function, commands, models = done.stdout.splitlines()
    assert function.endswith(" omniscv")
    assert commands.split() == list(COMMANDS)
    assert models.split() == ["fisheye-equidistant", "fisheye-equisolid"]


def test_help_lists_every_command_with_its_summary(capsys):
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    assert [name for name in COMMANDS if not re.search(rf"│ {name} +[A-Z]\w+", text)] == []


def loaded_by(*arguments):
    """The modules that a command line loads, in a process of its own."""
    program = f"import sys; from omniscv.cli import run; code = run({list(arguments)!r})"
    report = "; print(*sys.modules, file=sys.stderr); sys.exit(code)"
    command = [sys.executable, "-c", program + report]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout, set(done.stderr.split())


HEAVY = {"numpy", "numba", "cv2", "scipy", "matplotlib", "OpenImageIO", "mock_server", "omniscv.make"}


@pytest.mark.parametrize(("arguments", "own"), [(["--version"], []), (["render", "--help"], ["render"])])
def test_a_command_line_loads_the_module_of_its_command_alone(arguments, own):
    printed, modules = loaded_by(*arguments)
    assert own or printed == f"omniscv {omniscv.__version__}\n"
    assert modules.isdisjoint(HEAVY if own else HEAVY | {"rich"})
    of_commands = {f"omniscv.cli.{name}" for name in COMMANDS.values()}
    assert modules & of_commands == {f"omniscv.cli.{COMMANDS[name]}" for name in own}
