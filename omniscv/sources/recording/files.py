"""The file of a recording: it appears, or is replaced, as a whole, and its journal is settled.

SQLite finds a journal by its name alone: rolled back into a file that took the name of another one, it would
destroy it. A journal holds the pages before a change, and every change of a recording writes the row of
``recording`` first, with a new random ``token`` and the one before as ``parent``. So a journal's first page
has the token before the change. It belongs to the file if the file still has that token, as where the change
did not reach it, or has it as its parent.
"""

import contextlib
import logging
import os
import re
import shutil
import sqlite3
from collections.abc import Iterator
from itertools import count
from pathlib import Path

from omniscv import storage
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, NotARecordingError, RecordingNotWritableError
from omniscv.sources.recording.schema import check_schema, connect, errors_of
from omniscv.storage.local import move_new, remove_scratch, scratch_folder

_MAGIC, _LEAF = bytes.fromhex("d9d505f920a163d7"), b"\x0d"  # of a journal, of a page of rows
_HEAD = re.compile(rb"([0-9a-f]{32})([0-9a-f]{32})[0-9a-f]{32}")  # id, token, parent: adjacent in a row
_log = logging.getLogger("omniscv")


def target_of(path: Path | str) -> Path:
    """Return where a recording is, or will be written: links are followed.

    Raises:
        RecordingNotWritableError: something that is no regular file is there.
        ArgumentError: it is no path.
    """
    target = followed(path)
    kind = kind_of(target)
    if kind not in ("", "a file"):
        raise RecordingNotWritableError(f"expected a file or a free name, got {kind}; name another", path)
    return target


def followed(path: Path | str) -> Path:
    """Return a path with links followed; ArgumentError for a text that is no path on this machine."""
    if storage.is_url(path) or storage.was_url(path):
        expected = "expected a path on this machine"
        advice = "record there, and put it into the store by 'omniscv recording merge'"
        raise ArgumentError(f"recording: {expected}, got {storage.without_secrets(path)}; {advice}")
    try:
        return Path(os.path.realpath(path))
    except ValueError as cause:  # it has a NUL
        raise ArgumentError(f"recording: expected a path, got {shown(str(path))}: {cause}") from cause


def kind_of(path: Path) -> str:
    """Return what is at a path, in words; empty if nothing is."""
    if os.path.isfile(path):
        return "a file"
    if os.path.isdir(path):
        return "a folder"
    if os.path.exists(path):
        return "a device, a FIFO or a socket"
    return "a link without an end" if os.path.islink(path) else ""


@contextlib.contextmanager
def written_for(target: Path) -> Iterator[Path]:
    """Yield where to write the file that will be moved to a path, in a scratch folder beside it.

    Raises:
        RecordingNotWritableError: the folder of the path cannot be created or written.
    """
    with contextlib.ExitStack() as stack:
        with errors_of(target, write=True):
            target.parent.mkdir(parents=True, exist_ok=True)
            remove_scratch(target.parent, f".{target.name}-")  # which killed processes have left
            folder = stack.enter_context(scratch_folder(target.parent, f".{target.name}-"))
        yield folder / target.name


def publish(file: Path, target: Path) -> None:
    """Move a complete file to its path in one step, and remove the logs of the file that was there."""
    with errors_of(target, write=True):
        if target.exists():
            shutil.copymode(target, file)
        file.replace(target)
        for suffix in ("-journal", "-wal", "-shm"):
            Path(f"{target}{suffix}").unlink(missing_ok=True)
        _sync_folder(target.parent)


def publish_new(file: Path, target: Path) -> bool:
    """Move a complete file to its path; return False if another process has just created a file there."""
    with errors_of(target, write=True):
        if kind_of(target) and not target.stat().st_size:
            file.replace(target)
        elif not move_new(file, target):
            return False
        _sync_folder(target.parent)
        return True


def _sync_folder(path: Path) -> None:
    """Flush a folder, where that is possible, so that a renamed file outlives a power cut."""
    with contextlib.suppress(OSError):
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def settle_journal(path: Path) -> None:
    """Roll back the file's own journal; rename a foreign one, and a write-ahead log: recordings have none.

    NotARecordingError if the journal is another program's, or a foreign log cannot be renamed.
    """
    journal, wal = Path(f"{path}-journal"), Path(f"{path}-wal")
    if wal.exists():
        _set_aside(path, wal)
        Path(f"{path}-shm").unlink(missing_ok=True)
    while journal.exists() and _must_roll_back(path):
        of_file, in_journal = _states_of_file(path), _state_in_journal(journal)
        if not _must_roll_back(path) or in_journal != _state_in_journal(journal):
            continue  # another process has rolled it back
        if in_journal in of_file:
            connect(path, "rw").close()
        elif in_journal:
            _set_aside(path, journal)
        else:
            got = f"{journal.name} of another program; open it there, or remove the journal"
            raise NotARecordingError(f"expected a journal of omniscv, got {got}")


def _must_roll_back(path: Path) -> bool:
    """Return whether SQLite would roll a journal back: it is not that of a running recorder."""
    try:
        connect(path, "ro").close()
        return False
    except sqlite3.OperationalError as refused:
        if refused.sqlite_errorcode == sqlite3.SQLITE_READONLY_ROLLBACK:
            return True
        raise


def _states_of_file(path: Path) -> set[tuple[bytes, ...]]:
    """Return the id with the token, and with the one before, as they are in a file without its journal."""
    with contextlib.closing(connect(path, "ro&immutable=1", torn=True)) as database:
        check_schema(database)
        ((id_, *tokens),) = database.execute("SELECT id, token, parent FROM recording LIMIT 1")
    return {(str(id_).encode(), str(token).encode()) for token in tokens}


def _state_in_journal(journal: Path) -> tuple[bytes, ...] | None:
    """Return the id and token in the first page of a journal; None in the journal of another program."""
    with contextlib.suppress(FileNotFoundError), journal.open("rb") as file:
        start = file.read(1 << 18)
        page = start[int.from_bytes(start[20:24], "big") + 4 :]  # behind the header's sector, a page's number
        match = _HEAD.search(page, int.from_bytes(page[8:10], "big"))  # from the first row on
        return match.groups() if match and start.startswith(_MAGIC) and page.startswith(_LEAF) else None
    return None


def _set_aside(path: Path, log: Path) -> None:
    names = (log.with_name(f"{log.name}.foreign{number or ''}") for number in count())
    target = next(name for name in names if not name.exists())
    try:
        log.rename(target)
    except FileNotFoundError:
        return  # another process has done it
    except OSError as cause:
        raise NotARecordingError(f"expected no foreign log, got {log.name}; remove it") from cause
    _log.warning("%s: %s is a log of another file; set aside as %s", path, log.name, target.name)
