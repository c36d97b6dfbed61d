"""Kill -9 at any moment: what is left holds no half file, and ``--resume`` makes the same bytes of it."""

import json

import pytest
from support.datasets import job_file, tree
from support.killed import moments

from omniscv import dataset
from omniscv.dataset import manifest
from omniscv.frame import FileEntry

KILLS, SOAK_KILLS = 3, 20
NUMBERS = [KILLS, pytest.param(SOAK_KILLS, marks=[pytest.mark.soak, pytest.mark.timeout(1200)])]
EXPORT = "export: [webdataset, hf]\n"


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
    durations = [
        processes.run("make", job_file(tmp_path, out=out, more=EXPORT)) for out in ("whole", "second")
    ]
    wanted = tree(tmp_path / "whole")
    assert tree(tmp_path / "second") == wanted
    complete = []
    for number, moment_s in enumerate(moments(kills, max(durations), complete)):
        job = job_file(tmp_path, out=f"killed-{number}", more=EXPORT)
        out = tmp_path / f"killed-{number}"
        processes.run("make", job, kill_after_s=moment_s)
        complete.append(seen(out))
        processes.run("make", job)
        assert tree(out) == wanted
    print(f"killed {kills} times within {max(durations):.2f} s: {complete} frames were complete")
    assert max(complete) > 0
    assert dataset.check(out, deep=True) == []
