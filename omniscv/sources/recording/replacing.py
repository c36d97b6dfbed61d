"""Files of recordings that appear, or change, as a whole: written beside their place, then moved there."""

import contextlib
import glob
import os
import secrets
import shutil
import sqlite3
import stat
from collections.abc import Iterator
from pathlib import Path

from omniscv import storage
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, RecordingNotWritableError
from omniscv.sources.recording.logs import remove_logs, sync_folder
from omniscv.sources.recording.schema import errors_of

_LOCK, _ATTEMPTS = "lock", 10
_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
}  # fmt: skip


def place_of(path: Path | str) -> Path:
    """Return where a recording is, or will be written: links are followed.

    Raises:
        RecordingNotWritableError: something that is no regular file is there.
        ArgumentError: it is no path.
    """
    place = followed(path)
    kind = kind_of(place)
    if kind not in ("", "a file"):
        raise RecordingNotWritableError(f"{path}: expected a file or a free name, got {kind}; name another")
    return place


def followed(path: Path | str) -> Path:
    """Return a path with links followed; ArgumentError for a text that is no path on this machine."""
    if storage.is_url(path) or storage.was_url(path):
        wanted = "expected a path on this machine"
        advice = "record there, and put it into the store by 'omniscv captures merge'"
        raise ArgumentError(f"recording: {wanted}, got {storage.without_secrets(path)}; {advice}")
    try:
        return Path(os.path.realpath(path))
    except ValueError as cause:  # it has a NUL
        raise ArgumentError(f"recording: expected a path, got {shown(str(path))}: {cause}") from cause


def kind_of(place: Path) -> str:
    """Return what is at a place; empty if nothing is."""
    try:
        mode = place.stat().st_mode
    except OSError:
        return "a link without an end" if place.is_symlink() else ""
    return _KINDS.get(stat.S_IFMT(mode), "a file")


@contextlib.contextmanager
def part_of(place: Path) -> Iterator[Path]:
    """Yield where to write the file that will be moved to a place: in a folder beside it, removed at the end.

    The folder of the place is created.

    Raises:
        RecordingNotWritableError: the folder cannot be created or written.
    """
    with errors_of(place, write=True):
        place.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(place)
        folder, lock = _locked_folder(place)
    try:
        with contextlib.closing(lock):  # held while the folder is in use
            yield folder / place.name
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _locked_folder(place: Path) -> tuple[Path, sqlite3.Connection]:
    """A new folder, and a connection that holds its lock: another process may remove one without."""
    for _ in range(_ATTEMPTS):
        folder = place.with_name(f".{place.name}-{secrets.token_hex(8)}")
        folder.mkdir()
        if lock := _locked(folder):
            return folder, lock
        shutil.rmtree(folder, ignore_errors=True)
    raise RecordingNotWritableError(f"{place}: expected a folder whose files can be locked, got one without")


def _locked(folder: Path) -> sqlite3.Connection | None:
    """A connection that holds a folder's lock; None if another process has it, or removes the folder."""
    try:
        lock = sqlite3.connect(folder / _LOCK, 0.0, isolation_level=None)
    except sqlite3.OperationalError:
        if folder.exists():
            raise
        return None
    with contextlib.suppress(sqlite3.DatabaseError):
        lock.execute("BEGIN EXCLUSIVE")
        if (folder / _LOCK).exists():
            return lock
    lock.close()
    return None


def publish(part: Path, place: Path) -> None:
    """Move a whole file to its place, in one step, and remove the logs of the file that was there."""
    with errors_of(place, write=True):
        if place.exists():
            shutil.copymode(place, part)
        part.replace(place)
        remove_logs(place)
        sync_folder(place.parent)


def publish_new(part: Path, place: Path) -> bool:
    """Move a whole file to its place; return False if another recorder has just created a file there."""
    with errors_of(place, write=True):
        try:
            os.link(part, place)
        except FileExistsError:
            if place.stat().st_size:
                return False
            part.replace(place)
        except OSError:  # a file system without hard links
            part.replace(place)
        sync_folder(place.parent)
        return True


def copy_to_part(place: Path, part: Path) -> None:
    """Copy a recording, with a log that a recorder of version 1 may have left."""
    with errors_of(place, write=True):
        shutil.copyfile(place, part)
        with contextlib.suppress(FileNotFoundError):
            shutil.copyfile(f"{place}-wal", f"{part}-wal")


def remove_leftovers(place: Path) -> None:
    """Remove what killed processes left of files that were to be moved to a place."""
    for folder in place.parent.glob(f".{glob.escape(place.name)}-{'[0-9a-f]' * 16}"):
        with contextlib.suppress(sqlite3.OperationalError):  # a folder of others, which cannot be written
            if lock := _locked(folder):
                with contextlib.closing(lock):
                    shutil.rmtree(folder, ignore_errors=True)
