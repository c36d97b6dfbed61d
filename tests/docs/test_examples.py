"""The examples run as they are told to be run."""

import shutil
import subprocess
import sys

from support.command_line import ROOT

from omniscv import dataset, jobs


def test_the_moving_world_is_the_one_that_its_document_runs():
    """``docs/moving-worlds.md`` is executed; the example is the same script."""
    document = (ROOT / "docs" / "moving-worlds.md").read_text(encoding="utf-8")
    _, script = (ROOT / "examples" / "moving.py").read_text(encoding="utf-8").split("\n\n", maxsplit=1)
    assert script in document


def test_the_dataset_is_made_and_explored(tmp_path):
    folder = shutil.copytree(ROOT / "examples", tmp_path / "examples")
    text = (folder / "kitchen.yaml").read_text()
    for size in ("512", "384", "256"):  # smaller: what they show is that it runs
        text = text.replace(f"width: {size}", f"width: {int(size) // 4}").replace(
            f"height: {size}", f"height: {int(size) // 4}"
        )
    (folder / "kitchen.yaml").write_text(
        text.replace("fx: 116, fy: 116", "fx: 29, fy: 29")
        .replace("face_size: 256", "face_size: 64")
        .replace("count: 4", "count: 2")
    )
    jobs.make(jobs.load(folder / "kitchen.yaml"))
    assert dataset.check(folder / "kitchen", deep=True) == []
    done = subprocess.run(
        [sys.executable, str(folder / "explore.py"), str(folder / "kitchen")],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": str(ROOT)},
    )
    assert done.stdout.startswith("6 frames; splits {")
    assert "floor corners at" in done.stdout
