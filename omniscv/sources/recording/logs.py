"""SQLite's logs beside a recording: one is taken in only by the file that it was written for.

SQLite finds a log by its name alone. A log that a killed recorder left would be taken in by whatever file has
the name next. So every log is compared with the file before SQLite sees both; a foreign one is set aside.

A recorder writes a rollback journal, ``FILE-journal``, which holds pages as they were before a change. Every
change replaces the random token of the recording first, so that the journal's first page has the token of
before, and the file has that one, or the one that followed it.
Recordings of version 1, and other programs, may leave ``FILE-wal``.
"""

import contextlib
import logging
import os
import re
import sqlite3
import struct
from itertools import count
from pathlib import Path

from zlib_ng import zlib_ng

from omniscv.errors import NotARecordingError, RecordingError
from omniscv.sources.recording.schema import connect, most_captures, structural_faults, version_of

_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_HEAD = re.compile(rb"([0-9a-f]{32})([0-9a-f]{32})[0-9a-f]{32}")  # id, token, parent: one behind the other
_WAL_VERSIONS = b"\x02\x02"  # bytes 18 and 19 of a file with a write-ahead log
_LEAF = b"\x0d"  # the first byte of a page of rows

_log = logging.getLogger("omniscv")


def logs_of(path: Path) -> list[Path]:
    """Return where SQLite's logs of a file are."""
    return [Path(f"{path}{end}") for end in ("-journal", "-wal", "-shm")]


def settle(path: Path) -> None:
    """Leave no log beside a file but its own: undo what its journal undoes, set foreign logs aside.

    Raises:
        NotARecordingError: a foreign log cannot be set aside, or it cannot be known whose a log is.
        sqlite3.Error, OSError: the file cannot be read.
    """
    journal, wal, shared = logs_of(path)
    if wal.exists() and not _owns_wal(path):
        _set_aside(path, wal)
        with contextlib.suppress(OSError):
            shared.unlink()
    while (state := _state(journal)) and _is_hot(path):
        owned = _owns_journal(path, journal)
        if _state(journal) != state:
            continue  # another process has just done it
        if owned is None:
            raise NotARecordingError(
                f"{path}: expected a journal of omniscv beside it, got that of another program in "
                f"{journal.name}; open it with that program, or remove the journal if it is of another file"
            )
        if owned:
            connect(path, "rw").close()
        else:
            _set_aside(path, journal)


def _state(log: Path) -> tuple[int, int, int] | None:
    """What tells a log from one that is written later; None if there is none, or an empty one."""
    try:
        found = log.stat()
    except FileNotFoundError:
        return None
    return (found.st_ino, found.st_size, found.st_mtime_ns) if found.st_size else None


def remove_logs(path: Path) -> None:
    """Remove the logs of a file that was replaced."""
    for log in logs_of(path):
        log.unlink(missing_ok=True)


def _set_aside(path: Path, log: Path) -> None:
    names = (log.with_name(f"{log.name}.foreign{number or ''}") for number in count())
    aside = next(name for name in names if not name.exists())
    try:
        log.rename(aside)
    except FileNotFoundError:
        return  # another process has just done it
    except OSError as cause:
        raise NotARecordingError(
            f"{path}: expected no log of another file beside it, got {log.name}, which cannot be set aside "
            f"({cause.strerror}); remove it"
        ) from cause
    _log.warning("%s: %s is a log of another file; set aside as %s", path, log.name, aside.name)


def _is_hot(path: Path) -> bool:
    """Whether a journal would be rolled back into a file: it is no live recorder's, and not empty."""
    try:
        connect(path, "ro").close()
    except sqlite3.OperationalError as refused:
        if refused.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
            raise
        return True
    return False


def _owns_journal(path: Path, journal: Path) -> bool | None:
    """Whether a journal undoes what is half done in a file; None if that cannot be known."""
    with contextlib.closing(_alone(path)) as alone:
        if version_of(alone, path) == 1:
            # Version 1 wrote journals of the file's header only, a single page.
            if _sound_rows(alone, path) is not None:
                return False
        else:
            ((root,),) = alone.execute("SELECT rootpage FROM sqlite_master WHERE name = 'recording'")
            ((own, *tokens),) = alone.execute("SELECT id, token, parent FROM recording LIMIT 1")
            before = _first_head(journal, root)
            if before:
                return before[0] == own and before[1] in tokens
    return None


def _alone(path: Path) -> sqlite3.Connection:
    """A connection to a file as it is, without its logs."""
    return connect(path, "ro&immutable=1", torn=True)


def _first_head(journal: Path, root: int) -> tuple[str, str] | None:
    """The recording's id and token in the first page of a journal; None if another page is the first."""
    with contextlib.suppress(FileNotFoundError), journal.open("rb") as file:
        file.seek(-min(8, journal.stat().st_size), os.SEEK_END)
        if file.read() == _JOURNAL_MAGIC:  # it names another journal, which a change of one file does not
            return None
        file.seek(0)
        header = file.read(28)
        if len(header) < 28 or not header.startswith(_JOURNAL_MAGIC):
            return None
        sector, size = struct.unpack(">II", header[20:28])
        file.seek(sector)
        page = file.read(4 + min(size, 1 << 16))
        number, cells = page[:4], page[4:]
        if int.from_bytes(number, "big") == root and cells[:1] == _LEAF:
            found = _HEAD.search(cells, int.from_bytes(cells[8:10], "big"))
            return (found[1].decode(), found[2].decode()) if found else None
    return None


def _owns_wal(path: Path) -> bool:
    """Whether a file and its write-ahead log together are sound, and hold all that the file alone holds."""
    with contextlib.closing(_alone(path)) as database, path.open("rb") as file:
        version_of(database, path)
        if file.read(20)[18:] != _WAL_VERSIONS:  # it has no such log
            return False
        alone = _sound_rows(database, path)
    with contextlib.closing(connect(path, "ro")) as database:
        try:
            version_of(database, path)
            both = _sound_rows(database, path)
        except (sqlite3.DatabaseError, RecordingError):
            return False
    return both is not None and (alone or set()) <= both


def _sound_rows(database: sqlite3.Connection, path: Path) -> set[tuple[str, int]] | None:
    """The keys and checksums of captures; None if a payload or the structure is damaged."""
    version = version_of(database, path)
    column = "checksum" if version == 1 else "payload_checksum"
    query = f"SELECT key, {column}, payload FROM capture LIMIT {most_captures(path) + 1}"
    rows = set()
    try:
        if structural_faults(database):
            return None
        for key, crc, payload in database.execute(query):
            if not isinstance(payload, bytes) or zlib_ng.crc32(payload) != crc:
                return None
            rows.add((str(key), crc))
    except sqlite3.DatabaseError:
        return None
    return rows


def sync_folder(path: Path) -> None:
    """Flush a folder, so that what was renamed in it outlives a power cut; nothing where none can be."""
    with contextlib.suppress(OSError):
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
