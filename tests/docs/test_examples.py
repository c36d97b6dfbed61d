"""The examples run as they are told to be run."""

import re
import runpy
import shutil
import sys

from support.command_line import ROOT

from omniscv import dataset
from omniscv.job import load
from omniscv.make import make


def test_the_moving_world_is_the_one_that_its_document_runs():
    """``docs/moving-worlds.md`` is executed; the example is the same script."""
    document = (ROOT / "docs" / "moving-worlds.md").read_text(encoding="utf-8")
    _, script = (ROOT / "examples" / "moving.py").read_text(encoding="utf-8").split("\n\n", maxsplit=1)
    assert script in document


def test_the_dataset_is_made_and_explored(tmp_path, monkeypatch, capsys):
    folder = shutil.copytree(ROOT / "examples", tmp_path / "examples")
    text = (folder / "kitchen.yaml").read_text()
    smaller = re.sub(r"((?:width|height|face_size|fx|fy): )(\d+)", lambda m: f"{m[1]}{int(m[2]) // 8}", text)
    (folder / "kitchen.yaml").write_text(smaller.replace("count: 4", "count: 1"))
    make(load(folder / "kitchen.yaml"))
    assert dataset.check(folder / "kitchen", deep=True) == []
    monkeypatch.setattr(sys, "argv", ["explore.py", str(folder / "kitchen")])
    runpy.run_path(str(folder / "explore.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert printed.startswith("3 frames; splits {")
    assert "floor corners at" in printed
