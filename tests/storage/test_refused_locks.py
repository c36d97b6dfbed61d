"""File systems without locks: work goes on, and says so once; what needs locks is refused by its cause."""

import errno
import fcntl  # noqa: TID251
import re
import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest
from support.datasets import job_file
from support.processes import OMNISCV
from support.refused_locks import without_locks

from omniscv.errors import NotARecordingError, RecordingNotWritableError, StorageError
from omniscv.sources.recording.store import Store
from omniscv.storage import local

RECORDED = Path(__file__).parents[2] / "captures" / "four-wall.sqlite"
REFUSALS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


@pytest.fixture
def new_file_system(monkeypatch):
    """No file system was tried before."""
    monkeypatch.setattr(local, "_without_locks", set())


def refuse(monkeypatch, number, name="flock"):
    def refused(*arguments):
        raise OSError(number, "refused")

    monkeypatch.setattr(fcntl, name, refused)


@pytest.mark.parametrize("number", REFUSALS, ids=errno.errorcode.get)
def test_without_locks_scratch_folders_are_made_and_said_once(
    number, new_file_system, monkeypatch, tmp_path, caplog
):
    refuse(monkeypatch, number)
    for _ in range(3):
        with local.scratch_folder(tmp_path, ".x-") as folder, local.locked(tmp_path):
            local.remove_scratch(tmp_path, ".x-")  # which does not know whose they are
            assert folder.is_dir()
    assert list(tmp_path.iterdir()) == []
    (line,) = [record.getMessage() for record in caplog.records]
    assert "its file system has no locks" in line
    assert line.endswith("let one process at a time write there")


def test_a_lock_that_is_busy_for_ever_ends_in_one_line(monkeypatch, tmp_path):
    refuse(monkeypatch, errno.EAGAIN)
    with (
        pytest.raises(StorageError, match="got 100 that another program locked or removed at once"),
        local.scratch_folder(tmp_path, ".x-"),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_another_error_of_a_lock_names_the_folder(monkeypatch, tmp_path):
    refuse(monkeypatch, errno.EIO)
    with pytest.raises(OSError, match="refused at a lock") as failed, local.locked(tmp_path):
        pass
    assert failed.value.filename == str(tmp_path)


def test_who_waits_for_a_lock_says_so_and_gives_up(monkeypatch, tmp_path, caplog):
    monkeypatch.setattr(local, "_FIRST_LINE_S", 0.1)
    with (
        local.locked(tmp_path),
        pytest.raises(TimeoutError, match=r"locked by another process for 0\.3 s; end it first"),
        local.locked(tmp_path, 0.3),
    ):
        pass
    assert "locked by another process; waiting since 0 s" in caplog.text


def test_who_waits_for_a_lock_gets_it(tmp_path):
    taken = threading.Event()

    def take():
        with local.locked(tmp_path, 20):
            taken.set()

    other = threading.Thread(target=take)
    with local.locked(tmp_path):
        other.start()
        assert not taken.wait(0.2)
    other.join(20)
    assert taken.is_set()


def test_sqlite_without_locks_is_refused_by_its_cause(tmp_path, monkeypatch):
    """SQLite says that a file is busy, whether another process has it or the file system refuses locks."""
    path = shutil.copy(RECORDED, tmp_path / "room.sqlite")
    refuse(monkeypatch, errno.ENOLCK, "lockf")
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        for write, error in ((False, NotARecordingError), (True, RecordingNotWritableError)):
            with pytest.raises(error, match="that locks files, as SQLite needs it, got: refused"):
                Store(path, write=write)


def test_sqlite_that_another_process_uses_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("omniscv.sources.recording.files._BUSY_TIMEOUT_S", 1.0)
    path = shutil.copy(RECORDED, tmp_path / "room.sqlite")
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(NotARecordingError, match="another process has used it for 1 s: let it finish"):
            Store(path)


def test_a_path_that_is_too_long_for_sqlite_is_refused_by_its_length(tmp_path):
    folder = tmp_path.joinpath(*["d" * 100] * 4)
    folder.mkdir(parents=True)
    path = folder / ("n" * (506 - len(str(folder)) - 8) + ".sqlite")
    shutil.copy(RECORDED, path)
    with pytest.raises(NotARecordingError, match="a path of at most 504 bytes, which SQLite opens, got 506"):
        Store(path)
    path.unlink()
    with pytest.raises(RecordingNotWritableError, match="a path of at most 504 bytes"):
        Store(path, write=True)
    assert list(folder.iterdir()) == []


@pytest.mark.soak
@pytest.mark.parametrize("number", REFUSALS[:2], ids=errno.errorcode.get)
def test_commands_go_on_without_locks(number, tmp_path):
    environment = without_locks(tmp_path, number)
    job = job_file(tmp_path)
    commands = (
        ["record", "--source", "scene://four-wall", "--position", "0,0,1.5", "--out", tmp_path / "a.sqlite"],
        ["dataset", "make", job],
        ["recording", "split", RECORDED, "--out", tmp_path / "split"],
    )
    for command in commands:
        done = subprocess.run(
            [sys.executable, *OMNISCV, *map(str, command)],
            env=environment, capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert len(re.findall("has no locks", done.stderr)) == 1
    assert [path for path in tmp_path.rglob(".*") if path.is_dir()] == []


@pytest.mark.soak
@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS], ids=errno.errorcode.get)
def test_a_command_names_locks_that_sqlite_lacks(number, tmp_path):
    environment = without_locks(tmp_path, number, number)
    done = subprocess.run(
        [sys.executable, *OMNISCV, "recording", "info", RECORDED],
        env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert "expected a file system that locks files, as SQLite needs it, got: " in done.stderr
