"""Kill -9 at random moments, and the logs that it leaves: a recording takes in its own, and resumes."""

import os
import shutil
import sqlite3
from contextlib import closing

import pytest
from support import recorder
from support.faces import face_requests
from support.killed import moments
from support.permissions import read_only
from support.recordings import CountingSource, contents, filled

import mock_server
import omniscv
from omniscv.errors import NotARecordingError, RecordingError
from omniscv.importing.folders import export, import_folder
from omniscv.sources.recording.files import written_for
from omniscv.sources.recording.inspection import verify
from omniscv.sources.recording.store import Store

KILLS = 1
SOAK_KILLS = 25
NUMBERS = [KILLS, pytest.param(SOAK_KILLS, marks=[pytest.mark.soak, pytest.mark.timeout(1200)])]


@pytest.fixture(scope="module")
def server():
    with mock_server.serve("four-wall") as running:
        yield running


@pytest.fixture(scope="module")
def whole(server, processes, tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "room.sqlite"
    processes.run("record", server.uri, path)
    return path


@pytest.fixture(scope="module")
def half(whole, tmp_path_factory):
    return filled(tmp_path_factory.mktemp("half") / "room.sqlite", recorder.requests()[::2], str(whole))


def check(path, allowed):
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
    wanted, objects = contents(whole)
    duration_s = processes.run("record", server.uri, tmp_path / "first.sqlite")
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
    assert max(held) > 0


def imported(folder, half, whole):
    path = folder / "room.sqlite"
    faces = folder.parent / f"{folder.name}-faces"
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
    assert killed > 0


@pytest.mark.parametrize("left", [(), ("room.sqlite", "room.sqlite-journal")])
def test_what_a_killed_process_left_is_removed_by_the_next_that_writes(left, tmp_path):
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


MORE = face_requests(center=(0.3, 0.0, 1.5), modes=("depth",))


def leave_journal(recorded, folder):
    """What a recorder leaves that is killed while it changes a file: some pages are the new ones already."""
    path = folder / "writing" / "room.sqlite"
    path.parent.mkdir()
    shutil.copy(recorded, path)
    before = contents(path)
    store = Store(path, write=True)
    with omniscv.open_source("mock://four-wall") as live, store.transaction() as database:
        database.execute("PRAGMA cache_size = 1")  # so small that pages reach the file
        for capture in live.capture(MORE):
            store.add(capture)
        left = copied(path, folder / "room.sqlite")
    store.close()
    assert left == {"room.sqlite", "room.sqlite-journal"}
    return before


def copied(path, target):
    files = {file.name: shutil.copy(file, target.parent) for file in path.parent.glob(f"{path.name}*")}
    return set(files)


@pytest.fixture
def left(recorded, open_folder):
    wanted = leave_journal(recorded, open_folder)
    shutil.rmtree(open_folder / "writing")
    return open_folder / "room.sqlite", wanted


def restored(path, other, recorded):
    path.write_bytes(other.read_bytes())
    return contents(other)


def reimported(path, other, recorded):
    path.unlink()
    export(other, path.parent / "faces")
    import_folder(path.parent / "faces", path)
    shutil.rmtree(path.parent / "faces")
    return contents(other)


def older(path, other, recorded):
    """An older backup has the recording's id, but the journal undoes a change that it never saw."""
    filled(path, face_requests(center=(0.6, 0.0, 1.5), modes=("depth",)), "mock://four-wall")
    leave_journal(path, path.parent)
    shutil.rmtree(path.parent / "writing")
    path.write_bytes(recorded.read_bytes())
    return contents(recorded)


@pytest.mark.parametrize("replace", [restored, reimported, older])
def test_a_file_of_its_name_does_not_take_it_in(replace, left, other, recorded, caplog):
    path, _ = left
    expected = replace(path, other, recorded)
    log = path.with_name("room.sqlite-journal")
    check_set_aside(path, log, log.read_bytes(), expected, caplog)


def test_a_write_ahead_log_is_always_foreign(recorded, other, open_folder, caplog):
    """No recorder writes one; SQLite would take it in, whatever the file's header says."""
    path = open_folder / "room.sqlite"
    log = open_folder / "room.sqlite-wal"
    shutil.copy(recorded, open_folder / "changed.sqlite")
    with closing(sqlite3.connect(open_folder / "changed.sqlite", isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("UPDATE capture SET mode = 'depth'")
        for end in ("-wal", "-shm"):
            shutil.copy(open_folder / f"changed.sqlite{end}", open_folder / f"room.sqlite{end}")
    (open_folder / "changed.sqlite").unlink()
    data = log.read_bytes()
    shutil.copy(other, path)
    check_set_aside(path, log, data, contents(other), caplog)


def test_a_recording_that_another_program_gave_a_write_ahead_log_is_refused(copy):
    with closing(sqlite3.connect(copy)) as database:
        database.execute("PRAGMA journal_mode = WAL")
    for write in (False, True):
        with pytest.raises(NotARecordingError, match="run 'PRAGMA journal_mode = DELETE' there"):
            Store(copy, write=write)


def check_set_aside(path, log, data, wanted, caplog):
    for write in (False, True):
        Store(path, write=write).close()
        assert contents(path) == wanted
        assert verify(path).ok
    assert {file.name for file in path.parent.iterdir()} == {path.name, f"{log.name}.foreign"}
    assert log.with_name(f"{log.name}.foreign").read_bytes() == data  # nothing of it is lost
    [line] = [record.getMessage() for record in caplog.records if record.name == "omniscv"]
    assert line == f"{path}: {log.name} is a log of another file; set aside as {log.name}.foreign"


def test_a_file_without_its_log_holds_nothing_wrong(left, tmp_path):
    """Copied, or renamed, without its log: refused, or nothing but what was recorded."""
    path, wanted = left
    alone = tmp_path / "alone.sqlite"
    shutil.copy(path, alone)
    try:
        sound = verify(alone).ok
    except RecordingError:
        sound = False
    if sound:
        assert contents(alone)[0].items() <= wanted[0].items()
        assert contents(alone)[1] == wanted[1]


def test_a_foreign_log_that_cannot_be_set_aside_is_an_error(left, other):
    path, _ = left
    path.write_bytes(other.read_bytes())
    with read_only(path.parent), pytest.raises(NotARecordingError, match="expected no foreign log, got room"):
        verify(path)
    assert contents(path) == contents(other)


def test_its_own_log_is_taken_in_by_a_recorder_where_something_can_be_written(left):
    path, expected = left
    says = "open it once in a folder that can be written"
    with read_only(path.parent), pytest.raises(NotARecordingError, match=says):
        verify(path)
    Store(path, write=True).close()
    assert contents(path) == expected
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_the_journal_of_another_program_is_left_to_it(recorded, tmp_path, open_folder):
    """SQLite's own shell was killed while it changed a recording: nobody but it knows what the file was."""
    path = tmp_path / "room.sqlite"
    target = open_folder / "room.sqlite"
    shutil.copy(recorded, path)
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA cache_size = 1")
        database.execute("BEGIN")
        database.execute("UPDATE capture SET payload = zeroblob(100000)")
        assert len(copied(path, target)) == 2
    before = {file.name: file.read_bytes() for file in open_folder.iterdir()}
    for write in (False, True):
        with pytest.raises(NotARecordingError, match=r"got room\.sqlite-journal of another program"):
            Store(target, write=write)
    assert {file.name: file.read_bytes() for file in open_folder.iterdir()} == before
    with closing(sqlite3.connect(target)) as database:
        database.execute("SELECT count(*) FROM capture").fetchall()  # which undoes the change
    assert contents(target) == contents(recorded)


def test_another_programs_database_keeps_its_log(tmp_path):
    folder = tmp_path / "browser"
    folder.mkdir()
    with closing(sqlite3.connect(tmp_path / "places.sqlite", isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("CREATE TABLE photo (name TEXT)")
        copied(tmp_path / "places.sqlite", folder / "places.sqlite")
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert len(before) == 3
    for write in (False, True):
        with pytest.raises(RecordingError):
            Store(folder / "places.sqlite", write=write)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
