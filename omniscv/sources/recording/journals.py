"""Journals beside a recording: its own is rolled back, another file's is set aside.

SQLite finds a journal by its name alone: rolled back into a file that took the name of another one, it would
destroy it. A journal holds the pages before a change, and every change of a recording writes the row of
``recording`` first, with a new random ``token`` and the one before as ``parent``. So a journal's first page
has the token before the change. It belongs to the file if the file still has that token, as where the change
did not reach it, or has it as its parent.
"""

import contextlib
import logging
import re
import sqlite3
from itertools import count
from pathlib import Path

from omniscv.errors import NotARecordingError
from omniscv.sources.recording.schema import check_schema, connect

_MAGIC, _LEAF = bytes.fromhex("d9d505f920a163d7"), b"\x0d"  # of a journal, of a page of rows
_HEAD = re.compile(rb"([0-9a-f]{32})([0-9a-f]{32})[0-9a-f]{32}")  # id, token, parent: adjacent in a row
_log = logging.getLogger("omniscv")


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
