"""SQLite's logs beside a recording: only the file that a log was written for takes it in.

SQLite finds a log by its name: the journal of a killed recorder would be rolled back into any file that has
the name next. Every change of a recording begins with a new random token, so the journal's first page has the
token from before, which the file has as ``token`` or ``parent``.
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


def settle(path: Path) -> None:
    """Roll back the file's own journal; rename a foreign one, and a write-ahead log: recordings have none.

    NotARecordingError if the journal is another program's, or a foreign log cannot be renamed.
    """
    journal, wal = Path(f"{path}-journal"), Path(f"{path}-wal")
    if wal.exists():
        _set_aside(path, wal)
        Path(f"{path}-shm").unlink(missing_ok=True)
    while journal.exists() and journal.stat().st_size and _is_hot(path):
        known, token = _tokens(path), _token_before(journal)
        if not _is_hot(path) or token != _token_before(journal):
            continue  # another process has rolled it back
        if token in known:
            connect(path, "rw").close()
        elif token:
            _set_aside(path, journal)
        else:
            got = f"that of another program in {journal.name}; open it there, or remove a foreign journal"
            raise NotARecordingError(f"expected a journal of omniscv beside it, got {got}", path)


def _is_hot(path: Path) -> bool:
    """Return whether SQLite would roll a journal back: it is not that of a running recorder."""
    try:
        connect(path, "ro").close()
        return False
    except sqlite3.OperationalError as refused:
        if refused.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
            raise
        return True


def _tokens(path: Path) -> set[tuple[bytes, ...]]:
    """Return the id with the token, and with the one before, as they are in a file without its journal."""
    with contextlib.closing(connect(path, "ro&immutable=1", torn=True)) as database:
        check_schema(database, path)
        ((id_, *tokens),) = database.execute("SELECT id, token, parent FROM recording LIMIT 1")
    return {(str(id_).encode(), str(token).encode()) for token in tokens}


def _token_before(journal: Path) -> tuple[bytes, ...] | None:
    """Return the id and token in the first page of a journal; None in the journal of another program."""
    with contextlib.suppress(FileNotFoundError), journal.open("rb") as file:
        start = file.read(1 << 18)
        sector, page_bytes = int.from_bytes(start[20:24], "big"), int.from_bytes(start[24:28], "big")
        page = start[sector + 4 : sector + 4 + page_bytes]  # behind the page's number
        first_row = int.from_bytes(page[8:10], "big")
        if start.startswith(_MAGIC) and page.startswith(_LEAF) and (found := _HEAD.search(page, first_row)):
            return found.groups()
    return None


def _set_aside(path: Path, log: Path) -> None:
    names = (log.with_name(f"{log.name}.foreign{number or ''}") for number in count())
    target = next(name for name in names if not name.exists())
    try:
        log.rename(target)
        _log.warning("%s: %s is a log of another file; set aside as %s", path, log.name, target.name)
    except OSError as cause:
        if not log.exists():
            return  # another process has done it
        got = f"{log.name}, which cannot be set aside ({cause.strerror}); remove it"
        raise NotARecordingError(f"expected no log of another file beside it, got {got}", path) from cause
