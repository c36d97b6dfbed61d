"""Local folders: atomic writes, locks, and scratch folders."""

import errno
import logging
import os
import secrets
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Literal

from omniscv.errors import ArgumentError, DamagedFileError, MissingFileError, StorageError
from omniscv.storage.base import MOST_BYTES, Folder, checked_name
from omniscv.storage.bounded import open_regular

with suppress(ImportError):  # Windows
    import fcntl  # noqa: TID251

_TOKEN_BYTES = 8  # random, in names of temporary files and folders
_TOKEN_PATTERN = "[0-9a-f]" * (2 * _TOKEN_BYTES)
NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_LOCKS = (
    errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.ENOTTY, errno.EOPNOTSUPP,
    errno.EPERM,
)  # fmt: skip
"""With which file systems say that they lock nothing: Lustre, NFS, and those in user space."""
_BUSY = (errno.EAGAIN, errno.EACCES)

# While a folder is locked by another process, seconds:
_LOCK_WAIT_S = 3600.0  # until it is an error
_FIRST_LINE_S = 10.0  # until a line says so
_LINES_EVERY_S = 60.0  # until the next line
_POLL_S = 0.05  # from one attempt to the next, at most

_MOST_SCRATCH_FOLDERS = 100  # that are made in vain
_log = logging.getLogger("omniscv")
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EXDEV)


@dataclass(frozen=True)
class LocalFolder(Folder):
    """A folder by its path; created with its first file."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def local(self) -> Path:
        return self.path

    def exists(self, name: str) -> bool:
        with storage_errors(self.path / checked_name(name)):
            return (self.path / name).is_file()

    def names(self, prefix: str = "") -> list[str]:
        inner = prefix.rpartition("/")[0]
        start = self.path / checked_name(inner) if inner else self.path
        names = []
        for root, folders, files in os.walk(start):
            folders[:] = [folder for folder in folders if not folder.startswith(".")]
            below = Path(root).relative_to(self.path)
            names += [(below / file).as_posix() for file in files if not file.startswith(".")]
        return sorted(name for name in names if name.startswith(prefix))

    def read(self, name: str, most: int = MOST_BYTES) -> bytes:
        """As :meth:`Folder.read`: the file ``name``, of at most ``most`` bytes."""
        path = self.path / checked_name(name)
        try:
            with storage_errors(path), open_regular(path, most=most) as file:
                return file.read()
        except ArgumentError as fault:
            raise DamagedFileError(f"{path}: {fault.message}") from fault

    def put(self, name: str, content: bytes | Path, first: bool = False) -> bool:
        """As :meth:`Folder.put`: ``content`` goes to a temporary file, which is renamed to ``name``; with
        ``first`` it is linked, which never replaces a file."""
        if first and self.exists(name):
            return False
        path = self.path / checked_name(name)
        with storage_errors(path), _temporary(path) as part:
            if isinstance(content, bytes):
                part.write_bytes(content)
            else:
                shutil.copyfile(content, part)
            if first:
                return move_new(part, path)
            part.replace(path)
        return True

    def remove(self, name: str) -> None:
        path = self.path / checked_name(name)
        with storage_errors(path):
            path.unlink(missing_ok=True)

    def fetch(self, name: str, checksum: str = "", size: int = sys.maxsize) -> Path:
        """Return the file ``name`` itself, unread, so that ``checksum`` and ``size`` do not matter."""
        path = self.path / checked_name(name)
        if not self.exists(name):
            raise MissingFileError(f"{path}: expected a file, it is missing")
        return path

    def copy(self, name: str, path: Path, most: int | None = None) -> None:
        """As :meth:`Folder.copy`: from ``name`` to ``path``; ``most`` does not matter."""
        source = self.path / checked_name(name)
        with storage_errors(source):
            shutil.copyfile(source, path)

    def below(self, name: str) -> "LocalFolder":
        return LocalFolder(self.path / checked_name(name))


@contextmanager
def _temporary(path: Path) -> Iterator[Path]:
    """Yield a unique temporary path beside a file's, so that several processes may write the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{secrets.token_hex(_TOKEN_BYTES)}{path.suffix}")
    try:
        yield part
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to, and rename it to ``path`` at the end: the one atomic write.
    StorageError: the disk is full."""
    try:
        with _temporary(path) as part:
            yield part
            part.replace(path)
    except OSError as cause:
        if cause.errno not in NO_SPACE:
            raise
        raise StorageError(refusal(cause, path)) from cause


def write_bytes(path: Path, content: bytes) -> Path:
    """Write ``content`` to a file, whole or not at all, and return the path."""
    with whole_file(path) as part:
        part.write_bytes(content)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write a text as UTF-8 to ``path``, whole or not at all, and return the path."""
    return write_bytes(path, text.encode())


def remove_parts(path: Path) -> None:
    """Remove the temporary files that killed processes left of :func:`whole_file`.

    Only for files that one process writes at a time: a running writer's file goes too.
    """
    for part in path.parent.glob(f".{escape(path.stem)}.{_TOKEN_PATTERN}{escape(path.suffix)}"):
        part.unlink(missing_ok=True)


@contextmanager
def scratch_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """Yield a new, empty folder in ``parent``, named ``prefix`` and a token, and remove it at the end.

    It is locked until then, so that :func:`remove_scratch` of another process or thread skips it. One that
    was removed before it was locked is replaced by another; StorageError if that happens every time.
    """
    for _ in range(_MOST_SCRATCH_FOLDERS):
        folder = parent / f"{prefix}{secrets.token_hex(_TOKEN_BYTES)}"
        folder.mkdir(parents=True)
        with _try_lock(folder) as lock:
            if lock in ("busy", "gone"):
                shutil.rmtree(folder, ignore_errors=True)
                continue
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            return
    wanted = f"expected a new folder {prefix}* that can be locked"
    failures = f"{_MOST_SCRATCH_FOLDERS} that another program locked or removed at once"
    raise StorageError(f"{parent}: {wanted}, got {failures}; end it, or write elsewhere")


def remove_scratch(parent: Path, prefix: str) -> None:
    """Remove the scratch folders of a prefix that killed processes left in ``parent``.

    Where a file system has no locks, nobody knows whether one is in use, and all stay.
    """
    for folder in dead_scratch(parent, prefix):
        shutil.rmtree(folder, ignore_errors=True)


def dead_scratch(parent: Path, prefix: str) -> Iterator[Path]:
    """Yield the scratch folders of a prefix that killed processes left in ``parent``, each locked."""
    for folder in parent.glob(f"{escape(prefix)}{_TOKEN_PATTERN}"):
        with suppress(OSError), _try_lock(folder) as lock:  # another user's, or one on its way out
            if lock == "locked":
                yield folder


def is_written(parent: Path, prefix: str) -> bool:
    """Return whether a living process or thread has a scratch folder of a prefix in ``parent``; False where
    a file system has no locks, as nobody knows."""
    for folder in parent.glob(f"{escape(prefix)}{_TOKEN_PATTERN}"):
        with suppress(OSError), _try_lock(folder) as lock:
            if lock == "busy":
                return True
    return False


@contextmanager
def locked(folder: Path, timeout_s: float = _LOCK_WAIT_S) -> Iterator[None]:
    """Lock a folder against other processes and threads; wait for it, and log that after some seconds. A
    killed process leaves no lock.

    Without effect on Windows, and on file systems without locks: there only one process at a time may write a
    folder. That is logged, once for each file system.

    Args:
        folder: which must exist.
        timeout_s: how long to wait.

    Raises:
        TimeoutError: another process or thread held the lock all the time.
    """
    opened = os.open(folder, os.O_RDONLY) if sys.platform != "win32" else None
    started = time.monotonic()
    line_s = _FIRST_LINE_S
    try:
        while _flock(folder, opened) == "busy":
            seconds = time.monotonic() - started
            if seconds > timeout_s:
                raise TimeoutError(f"{folder}: locked by another process for {timeout_s:.3g} s; end it first")
            if seconds > line_s:
                _log.warning("%s: locked by another process; waiting since %.0f s", folder, seconds)
                line_s += _LINES_EVERY_S
            time.sleep(min(_POLL_S, max(0.001, seconds)))
        yield
    finally:
        if opened is not None:
            os.close(opened)


_Lock = Literal["locked", "busy", "gone", "none"]
"""What came of locking a folder: another process has the lock, the folder was removed, or the file system has
no locks."""


@contextmanager
def _try_lock(folder: Path) -> Iterator[_Lock]:
    """Lock a folder until the end, and yield what came of it."""
    if sys.platform == "win32":
        yield "none"
        return
    try:
        opened = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:
        yield "gone"
        return
    try:
        lock = _flock(folder, opened)
        yield lock if folder.exists() else "gone"
    finally:
        os.close(opened)


def _flock(folder: Path, opened: int | None) -> _Lock:
    """Lock an open folder without waiting. OSError: of a file system that cannot be reached, say."""
    if sys.platform == "win32" or opened is None:
        return "none"
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as cause:
        if cause.errno in _BUSY:
            return "busy"
        if cause.errno not in _NO_LOCKS:
            raise OSError(cause.errno, f"{cause.strerror} at a lock", str(folder)) from cause
        _warn_without_locks(os.fstat(opened).st_dev, folder, os.strerror(cause.errno))
        return "none"
    return "locked"


def _warn_without_locks(device: int, folder: Path, why: str) -> None:
    """Log that a file system has no locks, once for each."""
    if device not in _without_locks:
        _without_locks.add(device)
        advice = "let one process at a time write there"
        _log.warning("%s: its file system has no locks (%s); %s", folder, why, advice)


_without_locks: set[int] = set()
"""Numbers of the file systems that have no locks, as far as these were tried."""


def refused_file_locks(folder: Path) -> str:
    """Return why the file system of a folder refuses POSIX locks of files, as SQLite takes them; an empty
    text if it does not, or if that cannot be tried."""
    if sys.platform == "win32":
        return ""
    with suppress(OSError), _temporary(folder / "lock") as part, part.open("xb") as file:
        # Of a file of its own: closing a file releases all locks that the process has on it.
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as cause:
            return "" if cause.errno in _BUSY else str(cause.strerror)
    return ""


@contextmanager
def folder_beside(target: Path) -> Iterator[Path]:
    """Yield a new folder beside ``target``, for :func:`replace_folder`, and remove it at the end.

    Several processes may have one each. Those that killed processes left are removed.
    """
    prefix = f".{target.name}."
    with scratch_folder(target.parent, prefix) as folder:
        remove_scratch(target.parent, prefix)
        yield folder


def replace_folder(part: Path, target: Path) -> None:
    """Rename the folder ``part`` to ``target``, in place of the folder that has the name; the last of several
    processes wins."""
    with locked(target.parent):
        shutil.rmtree(target, ignore_errors=True)
        part.replace(target)


@contextmanager
def storage_errors(path: Path | str) -> Iterator[None]:
    """Raise OSError as StorageError: one line that names a file and what helps."""
    try:
        yield
    except FileNotFoundError as cause:
        raise MissingFileError(f"{path}: expected a file, it is missing") from cause
    except OSError as cause:
        raise StorageError(refusal(cause, path)) from cause


def refusal(cause: OSError, path: Path | str | None = None) -> str:
    """Return an OSError in one line that names the file, if known, and what helps.

    Args:
        cause: the error.
        path: of the file; None: that of the error, of a copy or a move its target.
    """
    path = path or cause.filename2 or cause.filename
    reason = cause.strerror or str(cause)
    if isinstance(cause, FileExistsError):  # of mkdir
        if os.path.isfile(path or ""):
            reason = "a file"
        return f"{path}: expected a folder or a free name, got {reason}"
    if cause.errno in NO_SPACE:
        reason += "; free space there, and run again"
    return f"{path}: expected to read or write it, got: {reason}" if path else reason


def move_new(part: Path, path: Path) -> bool:
    """Give the complete temporary file ``part`` its path; return False if the path exists."""
    try:
        os.link(part, path)
    except FileExistsError:
        return False
    except OSError as cause:
        if cause.errno not in _NO_LINKS:
            raise
        return _create(part, path)
    return True


def _create(part: Path, path: Path) -> bool:
    """As :func:`move_new`, without hard links: of simultaneous writers, the last one wins."""
    if path.exists():
        return False
    content = part.read_bytes()
    part.replace(path)
    return path.read_bytes() == content
