"""Kill -9 at random moments: whatever a process did to a recording, it opens, verifies, and resumes."""

import os
import shutil

import pytest
from support import recorder
from support.killed import moments
from support.recordings import CountingSource, contents

import mock_server
import omniscv
from omniscv.sources.recording.files import written_for
from omniscv.sources.recording.folders import export
from omniscv.sources.recording.inspection import verify
from omniscv.sources.recording.store import Store

KILLS, SOAK_KILLS = 2, 25
NUMBERS = [KILLS, pytest.param(SOAK_KILLS, marks=[pytest.mark.soak, pytest.mark.timeout(1200)])]


@pytest.fixture(scope="module")
def server():
    with mock_server.serve("four-wall") as running:
        yield running


@pytest.fixture(scope="module")
def whole(server, processes, tmp_path_factory):
    """A recording of all requests, whose recorder was not killed."""
    path = tmp_path_factory.mktemp("whole") / "room.sqlite"
    processes.run("record", server.uri, path)
    return path


@pytest.fixture(scope="module")
def half(whole, tmp_path_factory):
    """A recording of some of the requests."""
    path = tmp_path_factory.mktemp("half") / "room.sqlite"
    with omniscv.open_source(whole) as replay, omniscv.record(replay, path) as source:
        list(source.capture(recorder.requests()[::2]))
    return path


def check(path, allowed):
    """The file is whole and holds one of the allowed contents; then nothing is left beside it."""
    report = verify(path)
    assert report.ok, list(report.lines())
    found = contents(path)
    assert found in allowed
    Store(path, write=True).close()
    assert contents(path) == found
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    return allowed.index(found)


@pytest.mark.parametrize("kills", NUMBERS)
def test_killed_while_it_records(kills, server, whole, processes, tmp_path):
    """What was recorded stays, and resuming captures only the rest."""
    wanted, objects = contents(whole)
    duration_s = max(processes.run("record", server.uri, tmp_path / f"{i}.sqlite") for i in "ab")
    held = []
    for number, moment_s in enumerate(moments(kills, duration_s, held)):
        path = tmp_path / str(number) / "room.sqlite"
        processes.run("record", server.uri, path, kill_after_s=moment_s)
        before = {}
        if path.exists():  # else it was killed before it began to record
            report = verify(path)
            assert report.ok, list(report.lines())
            before = contents(path)[0]
            assert before.items() <= wanted.items()
        live = CountingSource(omniscv.open_source(server.uri))
        recorder.record(live, path)
        assert len(set(live.requests)) == len(live.requests) == len(wanted) - len(before)
        assert contents(path) == (wanted, objects)
        assert check(path, [(wanted, objects)]) == 0
        held.append(len(before))
    print(f"killed {kills} times within {duration_s:.2f} s: held {held} of {len(wanted)} captures")
    assert max(held) > 0


def imported(folder, half, whole):
    path, faces = folder / "room.sqlite", folder.parent / f"{folder.name}-faces"
    shutil.copy(half, path)
    if not faces.exists():
        export(whole, faces)
    return ("import", faces, path), [contents(half), contents(whole)]


def replaced(folder, half, whole):
    path = folder / "room.sqlite"
    shutil.copy(half, path)
    return ("replace", whole, path), [contents(half), contents(whole)]


def changed(folder, half, whole):
    path = folder / "room.sqlite"
    shutil.copy(whole, path)
    return ("change", path, half.with_name("again.sqlite")), [contents(whole)]


@pytest.mark.parametrize("kills", NUMBERS)
@pytest.mark.parametrize("prepare", [imported, replaced, changed])
def test_killed_while_it_changes_a_file(prepare, kills, half, whole, processes, tmp_path):
    """The file is what it was before, or what it should become, and never anything between."""
    shutil.copy(whole, half.with_name("again.sqlite"))
    path = tmp_path / "room" / "room.sqlite"
    path.parent.mkdir()
    action, allowed = prepare(path.parent, half, whole)
    duration_s = processes.run(*action)
    assert check(path, allowed) == len(allowed) - 1
    killed = 0
    sooner = [0.8 * duration_s / 2**halving for halving in range(1, 7)]  # on a machine that has become faster
    for number, moment_s in enumerate([*moments(kills, 0.8 * duration_s), *sooner]):
        if number >= kills and killed:
            break
        path.unlink()
        action, allowed = prepare(path.parent, half, whole)
        killed += processes.run(*action, kill_after_s=moment_s) is None
        check(path, allowed)
    print(f"{prepare.__name__}: killed {killed} times within {duration_s:.3f} s")
    assert killed > 0


@pytest.mark.parametrize("left", [(), ("room.sqlite", "room.sqlite-journal")])
def test_what_a_killed_process_left_is_removed_by_the_next_that_writes(left, tmp_path):
    """Whether it was killed before it wrote, or while it wrote."""
    folder = tmp_path / ".room.sqlite-0123456789abcdef"
    folder.mkdir()
    for name in left:
        (folder / name).touch()
    (tmp_path / ".room.sqlite-mine").mkdir()
    Store(tmp_path / "room.sqlite", write=True).close()
    assert {path.name for path in tmp_path.iterdir()} == {"room.sqlite", ".room.sqlite-mine"}


def test_what_a_living_process_writes_is_left_alone(tmp_path):
    path = tmp_path / "room.sqlite"
    with written_for(path) as part:
        Store(path, write=True).close()
        assert part.parent.is_dir()
    assert list(tmp_path.iterdir()) == [path]


def test_a_killed_creation_leaves_no_file_that_does_not_open(tmp_path, monkeypatch):
    """The file appears with its schema in it, or not at all; another's file is never replaced."""
    path = tmp_path / "room.sqlite"
    link = os.link

    def another_was_first(fresh, target):
        monkeypatch.undo()
        Store(target, write=True).close()
        first.append(path.stat().st_ino)
        link(fresh, target)

    first = []
    monkeypatch.setattr(os, "link", another_was_first)
    Store(path, write=True).close()
    assert [path.stat().st_ino] == first
    assert list(tmp_path.iterdir()) == [path]
