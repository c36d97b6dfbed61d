"""The file of a recording: its tables, its journal, and how it appears or is replaced as a whole.

docs/recording-format.md describes the tables. A file may come from anybody: header and schema are checked
before a table is read, and a connection reads no value that is longer than the file.

SQLite finds a journal by its name alone: rolled back into a file that took the name of another one, it would
destroy it. A journal holds the pages before a change, and every change of a recording writes the row of
``recording`` first, with a new random ``token`` and the one before as ``parent``. So a journal belongs to the
file if the file still has the token in the journal's first page, or has it as its parent.
"""

import contextlib
import logging
import os
import re
import shlex
import shutil
import sqlite3
import struct
import threading
from collections.abc import Callable, Iterator
from functools import cache
from itertools import count
from pathlib import Path
from weakref import WeakSet

from omniscv import storage
from omniscv.arguments import shown
from omniscv.errors import (
    ArgumentError,
    DamagedRecordingError,
    NewerRecordingError,
    NotARecordingError,
    RecordingError,
    RecordingNotWritableError,
)
from omniscv.sources.recording.rows import Head
from omniscv.sources.recording.world_rows import checked_json
from omniscv.storage.local import move_new, refused_file_locks, remove_scratch, scratch_folder

SCHEMA_VERSION = 4
LARGEST_BYTES = 1 << 29
"""The largest row that is written."""

_APPLICATION_ID = 0x6F6D6E69  # "omni"
_TABLES = """
CREATE TABLE recording (
    id TEXT NOT NULL, token TEXT NOT NULL, parent TEXT NOT NULL, scene TEXT NOT NULL,
    tolerance INTEGER NOT NULL, captures INTEGER NOT NULL, capture_sum INTEGER NOT NULL,
    object_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL
) STRICT;
CREATE TABLE capture (
    number INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, mode TEXT NOT NULL, asked TEXT NOT NULL,
    captured TEXT NOT NULL, encoding TEXT NOT NULL, provenance TEXT NOT NULL,
    payload_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL, payload BLOB NOT NULL
, state TEXT NOT NULL DEFAULT '') STRICT;
CREATE TABLE object (
    name TEXT PRIMARY KEY NOT NULL, red INTEGER NOT NULL, green INTEGER NOT NULL, blue INTEGER NOT NULL,
    instance INTEGER
) STRICT;
CREATE TABLE geometry (content TEXT NOT NULL, checksum INTEGER NOT NULL) STRICT;
CREATE TABLE state (name TEXT PRIMARY KEY NOT NULL, content TEXT NOT NULL, checksum INTEGER NOT NULL) STRICT;
"""
_HEADER = struct.Struct(">16s2xBB40xI4xI")
"""Of an SQLite file: magic, write and read version (2: write-ahead log), user version, application id."""
_MAGIC = b"SQLite format 3\0"
_GROWTH_BYTES = 1 << 26
_BUSY_TIMEOUT_S = 30.0  # for other processes to finish a change
_FIRST_WAIT_S = 0.5  # before it is asked whether the file system has locks
_LONGEST_PATH = 504
"""Bytes of the longest path that SQLite opens with a journal beside it."""
_MOST_SETTLED = 100  # times that other processes may change a journal while it is read
# starts of a journal, and of a page of rows
_JOURNAL = bytes.fromhex("d9d505f920a163d7")
_LEAF = b"\x0d"
_HEAD = re.compile(rb"([0-9a-f]{32})([0-9a-f]{32})[0-9a-f]{32}")  # id, token, parent: adjacent in a row
_log = logging.getLogger("omniscv")


def create(path: Path) -> None:
    """Write a new, empty recording."""
    head = Head.new()
    with contextlib.closing(connect(path, "rwc")) as database:
        database.execute("PRAGMA auto_vacuum = NONE")
        database.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
        database.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        database.executescript(_TABLES)
        database.execute(f"INSERT INTO recording VALUES ({', '.join('?' * len(head))})", head)
        content = checked_json({"boxes": {}, "room": None}, dict, head.id)
        database.execute("INSERT INTO geometry VALUES (?, ?)", content)


def connect(path: Path, mode: str, *, torn: bool = False) -> sqlite3.Connection:
    """Return a connection that has read the header, and with it a journal.

    Args:
        path: of the file.
        mode: of SQLite's addresses: ``ro``, ``rw`` or ``rwc``.
        torn: whether the file may be shorter than its header says.
    """
    refused = RecordingNotWritableError if mode.startswith("rw") else NotARecordingError
    length = len(os.fsencode(path.absolute()))
    if length > _LONGEST_PATH:
        expected = f"expected a path of at most {_LONGEST_PATH} bytes, which SQLite opens"
        raise refused(f"{expected}, got {length}; choose a shorter one", path)
    uri = f"{path.absolute().as_uri()}?mode={mode}"
    database = sqlite3.connect(
        uri, timeout=_FIRST_WAIT_S, isolation_level=None, check_same_thread=False, uri=True
    )
    database.text_factory = bytes.decode
    try:
        # A row is at most as long as the file, unless the file grows while it is read.
        longest = LARGEST_BYTES if mode.startswith("rw") else max(_GROWTH_BYTES, path.stat().st_size)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, longest)
        database.execute("PRAGMA trusted_schema = OFF")
        database.execute("PRAGMA cell_size_check = ON")
        if torn:
            database.execute("PRAGMA writable_schema = ON")
        if why := _lacks_locks(database, path):
            raise refused(why, path)
        database.execute(f"PRAGMA busy_timeout = {1000 * _BUSY_TIMEOUT_S:.0f}")
        database.execute("PRAGMA schema_version").fetchone()
    except BaseException:
        database.close()
        raise
    return database


def _lacks_locks(database: sqlite3.Connection, path: Path) -> str:
    """Return that the file system has no locks, and what to do; an empty text if nothing says so.

    SQLite does not tell such a file system from a file that another process has locked.
    """
    try:
        database.execute("PRAGMA schema_version").fetchone()
    except sqlite3.OperationalError as refused:
        if not _is_of_locks(refused):
            raise
        if why := refused_file_locks(path.parent):
            advice = "use a local disk, or mount this one with locks, as Lustre's option flock does"
            return f"expected a file system that locks files, as SQLite needs it, got: {why}; {advice}"
    return ""


def _is_of_locks(error: sqlite3.Error) -> bool:
    """Return whether SQLite was refused a lock, or waited in vain for another process."""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_OK)
    return code in _LOCK_ERRORS or code & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_PERM)


_LOCK_ERRORS = (
    sqlite3.SQLITE_IOERR_LOCK, sqlite3.SQLITE_IOERR_RDLOCK, sqlite3.SQLITE_IOERR_UNLOCK,
    sqlite3.SQLITE_IOERR_CHECKRESERVEDLOCK,
)  # fmt: skip


def opened(path: Path, write: bool) -> sqlite3.Connection:
    """Return a connection to the recording at ``path``; with ``write``, to a new one if nothing is there."""
    kind = kind_of(path)
    if write:
        if kind == "" or path.stat().st_size == 0:
            with written_for(path) as file:
                create(file)
                publish_new(file, path)
        remove_scratch(path.parent, f".{path.name}-")
    elif kind == "":
        raise NotARecordingError("expected a recording, got nothing there; record one first")
    elif kind == "a folder":
        advice = f"if it has pictures, {import_advice(path)}"
        raise NotARecordingError(f"expected a recording, got a folder; {advice}")
    elif kind != "a file":
        raise NotARecordingError(f"expected a recording, got {kind}")
    check_header(path)
    settle_journal(path)
    database = connect(path, "rw" if write else "ro")
    try:
        check_schema(database)
        if write:
            database.execute("PRAGMA journal_mode = TRUNCATE")
            # Flush each capture, so that it outlives a power cut; little time beside capturing it.
            database.execute("PRAGMA synchronous = FULL")
    except BaseException:
        database.close()
        raise
    return database


class Forkable:
    """Base of what has a connection, and a lock around it. A forked child must neither use nor close it."""

    def __init__(self, connect: Callable[[], sqlite3.Connection]) -> None:
        self._lock = threading.RLock()
        self._connection: sqlite3.Connection | None = connect()
        _forkable.add(self)

    def _forked(self) -> None:
        _inherited.append(self._connection)
        self._connection = None
        self._lock = threading.RLock()


_forkable: WeakSet[Forkable] = WeakSet()
_locks_at_fork: list[threading.RLock] = []
_inherited: list[sqlite3.Connection | None] = []


def _before_fork() -> None:
    """Hold every lock: SQLite's own, if another thread held one, would stay taken in the child."""
    for forkable in list(_forkable):
        lock = forkable._lock
        if lock.acquire(timeout=_BUSY_TIMEOUT_S):
            _locks_at_fork.append(lock)


def _after_fork() -> None:
    while _locks_at_fork:
        _locks_at_fork.pop().release()


def _after_fork_in_child() -> None:
    _locks_at_fork.clear()
    for forkable in list(_forkable):
        forkable._forked()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork_in_child)


_PICTURES = {
    b"\xff\xd8\xff": "a JPEG picture",
    b"\x89PNG\r\n": "a PNG picture",
    b"\x76\x2f\x31\x01": "an EXR picture",
    b"II*\0": "a TIFF picture",
    b"MM\0*": "a TIFF picture",
    b"II+\0": "a TIFF picture",
    b"RIFF": "a WebP picture",
    b"#?R": "a Radiance picture",
    b"BM": "a BMP picture",
    b"\x93NUMPY": "a NumPy array",
    b"\0\0\0\x0cJXL ": "a JPEG XL picture",
}
"""By the bytes that files begin with, what is often taken for a recording."""


def import_advice(pictures: Path) -> str:
    """Return the command that makes a recording of pictures."""
    target = pictures.with_suffix(".sqlite").name
    command = shlex.join(["omniscv", "recording", "import", str(pictures), target, "--position", "0,0,1.5"])
    return f"write '{command}', and render from {target}"


def check_header(path: Path) -> None:
    """Check the first bytes of a file; NotARecordingError, or NewerRecordingError for a later version."""
    with path.open("rb") as file:
        header = file.read(_HEADER.size)
    if len(header) < _HEADER.size or not header.startswith(_MAGIC):
        for start, picture in _PICTURES.items():
            if header.startswith(start):
                raise NotARecordingError(f"expected a recording, got {picture}; {import_advice(path)}")
        actual = "a file that is not a database" if header else "an empty file"
        raise NotARecordingError(f"expected a recording, got {actual}")
    _, *log_versions, version, application = _HEADER.unpack(header)
    if application != _APPLICATION_ID:
        raise NotARecordingError("expected a recording, got another SQLite database")
    reason = f"expected schema version {SCHEMA_VERSION}, got version {version}"
    if version > SCHEMA_VERSION:
        raise NewerRecordingError(f"{reason}; update omniscv")
    if version < SCHEMA_VERSION:
        raise NotARecordingError(f"{reason}; record it again")
    if log_versions != [1, 1]:
        actual = "one that another program gave a write-ahead log"
        reason = f"expected a recording with a rollback journal, got {actual}"
        raise NotARecordingError(f"{reason}; run 'PRAGMA journal_mode = DELETE' there")


def check_schema(database: sqlite3.Connection) -> None:
    """Raise NotARecordingError for other tables, triggers or views than those of a recording."""
    expected = _schema()
    query = f"SELECT type, name, tbl_name, sql FROM sqlite_master LIMIT {len(expected) + 1}"
    rows = set(database.execute(query))
    if rows != expected:
        strange = sorted(f"the {row[0]} {shown(row[1])}" for row in rows - expected)
        actual = strange[0] if strange else "some of them only"
        raise NotARecordingError(f"expected the tables of a recording only, got {actual}")


@contextlib.contextmanager
def errors_of(path: Path, *, write: bool = False, advice: str = "") -> Iterator[None]:
    """Raise errors of SQLite and of the file system as errors of a recording, and name the file in them.

    Args:
        path: of the file.
        write: whether it is written, or else read.
        advice: what to do about damage.
    """
    try:
        yield
    except RecordingError as cause:
        if cause.path is not None:
            raise
        raise cause.at(path, advice) from cause
    except (OSError, sqlite3.Error, UnicodeError) as cause:
        why = cause.strerror if isinstance(cause, OSError) and cause.strerror else shown(str(cause))
        if isinstance(cause, OSError | sqlite3.OperationalError):
            why += _remedy(cause)
            if write:
                reason = f"expected a file that can be written, got: {why}; what it held is intact"
                raise RecordingNotWritableError(reason, path) from cause
            raise NotARecordingError(f"expected a recording that can be read, got: {why}", path) from cause
        if isinstance(cause, sqlite3.DataError | sqlite3.IntegrityError | UnicodeError):
            raise DamagedRecordingError(f"expected rows as recorded, got: {why}", path) from cause
        raise NotARecordingError(f"expected a recording, got another file, or damage: {why}", path) from cause


def _remedy(cause: OSError | sqlite3.Error) -> str:
    """Return what helps against an error of SQLite, behind a semicolon; an empty text if nothing is known."""
    if isinstance(cause, OSError):
        return ""
    if _is_of_locks(cause):
        return f"; another process has used it for {_BUSY_TIMEOUT_S:.0f} s: let it finish, or end it"
    if getattr(cause, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_READONLY:
        open_it = "open it once in a folder that can be written, together with the files beside it"
        return f"; if its recorder was killed, {open_it}"
    return ""


@cache
def _schema() -> frozenset[tuple[str, ...]]:
    with contextlib.closing(sqlite3.connect(":memory:")) as model:
        model.executescript(_TABLES)
        return frozenset(model.execute("SELECT type, name, tbl_name, sql FROM sqlite_master"))


def target_of(path: Path | str) -> Path:
    """Return where a recording is, or will be; RecordingNotWritableError if no regular file is there."""
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
    """Yield where to write the file that will be moved to a path, in a scratch folder beside it."""
    with contextlib.ExitStack() as stack:
        with errors_of(target, write=True):
            target.parent.mkdir(parents=True, exist_ok=True)
            remove_scratch(target.parent, f".{target.name}-")  # which killed processes have left
            folder = stack.enter_context(scratch_folder(target.parent, f".{target.name}-"))
        yield folder / target.name


def publish(file: Path, target: Path) -> None:
    """Move a complete ``file`` to ``target`` in one step, and remove the logs of the file that was there."""
    with errors_of(target, write=True):
        if target.exists():
            shutil.copymode(target, file)
        file.replace(target)
        for suffix in ("-journal", "-wal", "-shm"):
            Path(f"{target}{suffix}").unlink(missing_ok=True)
        _sync_folder(target.parent)


def publish_new(file: Path, target: Path) -> bool:
    """Move a complete ``file`` to ``target``; return False if another process has just created one there."""
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
    """Roll back the file's own journal; set aside a foreign one, and any write-ahead log."""
    journal = Path(f"{path}-journal")
    wal = Path(f"{path}-wal")
    if wal.exists():
        _set_aside(path, wal)
        Path(f"{path}-shm").unlink(missing_ok=True)
    for _ in range(_MOST_SETTLED):
        if not (journal.exists() and _must_roll_back(path)):
            return
        in_file = _states_of_file(path)
        in_journal = _state_in_journal(journal)
        if not _must_roll_back(path) or in_journal != _state_in_journal(journal):
            continue  # another process has rolled it back
        if in_journal in in_file:
            connect(path, "rw").close()
        elif in_journal:
            _set_aside(path, journal)
        else:
            actual = f"{journal.name} of another program; open it there, or remove the journal"
            raise NotARecordingError(f"expected a journal of omniscv, got {actual}")
    actual = f"{journal.name}, which other processes changed {_MOST_SETTLED} times"
    advice = "end them, and open it again"
    raise NotARecordingError(f"expected a journal that rests, got {actual}; {advice}")


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
        if match and start.startswith(_JOURNAL) and page.startswith(_LEAF):
            return match.groups()
    return None


def _set_aside(path: Path, log: Path) -> None:
    """Give a log of another file a free name."""
    numbers = count(1)
    target = log.with_name(f"{log.name}.foreign")
    while target.exists():
        target = log.with_name(f"{log.name}.foreign{next(numbers)}")
    try:
        log.rename(target)
    except FileNotFoundError:
        return  # another process has done it
    except OSError as cause:
        raise NotARecordingError(f"expected no foreign log, got {log.name}; remove it") from cause
    _log.warning("%s: %s is a log of another file; set aside as %s", path, log.name, target.name)
