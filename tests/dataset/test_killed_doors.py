"""Each door of a folder, killed at any moment and run again, leaves what it would have left at once."""

import shutil

import pytest
from support.datasets import job_file, tree
from support.killed import moments

KILLS = 2
SOAK_KILLS = 20
NUMBERS = [KILLS, pytest.param(SOAK_KILLS, marks=[pytest.mark.soak, pytest.mark.timeout(1200)])]


def job_of(folder, name):
    """A job that writes into a folder of a name; its file."""
    (folder / name).mkdir(exist_ok=True)
    return job_file(folder / name, more="export: [webdataset]\n")


def overwritten(processes, folder, name, kill_after_s=None):
    """Replace a dataset of one camera less, which has exports and a note of somebody."""
    job = job_of(folder, name)
    if not (folder / name / "dataset").exists():
        shutil.copytree(folder / "earlier" / "dataset", folder / name / "dataset")
        (folder / name / "dataset" / "notes.json").write_text("mine")
    return processes.run("overwrite", job, kill_after_s=kill_after_s)


def rendered(processes, folder, name, kill_after_s=None):
    return processes.run("render", job_of(folder, name), kill_after_s=kill_after_s)


def written(processes, folder, name, kill_after_s=None):
    return processes.run("write", folder / name, kill_after_s=kill_after_s)


def exported(processes, folder, name, kill_after_s=None):
    dataset = folder / "earlier" / "dataset"
    return processes.run("export", dataset, folder / name, kill_after_s=kill_after_s)


@pytest.mark.parametrize("kills", NUMBERS)
@pytest.mark.parametrize("door", [overwritten, rendered, written, exported])
def test_a_door_that_is_killed_and_run_again(door, kills, processes, tmp_path):
    processes.run("warm")
    processes.run("make", job_of(tmp_path, "earlier"))
    whole_s = door(processes, tmp_path, "whole")
    wanted = tree(tmp_path / "whole")
    for number, moment_s in enumerate(moments(kills, whole_s)):
        door(processes, tmp_path, f"killed-{number}", kill_after_s=moment_s)
        assert door(processes, tmp_path, f"killed-{number}") is not None
        assert tree(tmp_path / f"killed-{number}") == wanted
