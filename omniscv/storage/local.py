"""A folder on this machine."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from omniscv.errors import MissingFileError, StorageError
from omniscv.storage.base import Folder, checked

NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EXDEV)


@dataclass(frozen=True)
class LocalFolder(Folder):
    """A folder by its path; it is made with its first file."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def local(self) -> Path:
        """The path."""
        return self.path

    def exists(self, name: str) -> bool:
        """Return whether there is a file of that name."""
        with in_one_line(self.path / checked(name)):
            return (self.path / name).is_file()

    def names(self, prefix: str = "") -> list[str]:
        """Return the names of all files that start with a prefix, sorted."""
        inner = prefix.rpartition("/")[0]
        start = self.path / checked(inner) if inner else self.path
        found = []
        for root, folders, files in os.walk(start):
            folders[:] = [each for each in folders if not each.startswith(".")]
            below = Path(root).relative_to(self.path)
            found += [(below / each).as_posix() for each in files if not each.startswith(".")]
        return sorted(each for each in found if each.startswith(prefix))

    def read(self, name: str) -> bytes:
        """Return the bytes of a file."""
        with in_one_line(path := self.path / checked(name)):
            return path.read_bytes()

    def put(self, name: str, content: bytes | Path, first: bool = False) -> bool:
        """Write a file beside its place and move it there; with ``first`` by a link, which never replaces."""
        if first and self.exists(name):
            return False
        place = self.path / checked(name)
        with in_one_line(place), written_beside(place) as part:
            if isinstance(content, bytes):
                part.write_bytes(content)
            else:
                shutil.copyfile(content, part)
            if first:
                return _linked(part, place)
            part.replace(place)
        return True

    def remove(self, name: str) -> None:
        """Remove a file, where there is one."""
        with in_one_line(path := self.path / checked(name)):
            path.unlink(missing_ok=True)

    def fetch(self, name: str, checksum: str = "") -> Path:
        """Return the file itself; its bytes are not read."""
        path = self.path / checked(name)
        if not self.exists(name):
            raise MissingFileError(f"{path}: expected a file, it is missing")
        return path

    def copy(self, name: str, path: Path) -> None:
        """Write the bytes of a file to a local path."""
        with in_one_line(place := self.path / checked(name)):
            shutil.copyfile(place, path)

    def below(self, name: str) -> LocalFolder:
        """Return an inner folder."""
        return LocalFolder(self.path / checked(name))


@contextmanager
def written_beside(place: Path) -> Iterator[Path]:
    """Yield where to write a file that is then moved to its place; nothing is left there at the end.

    Every writer has a place of its own: several processes may write one file.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    part = place.with_name(f".{place.stem}.{secrets.token_hex(8)}{place.suffix}")
    try:
        yield part
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def folder_beside(target: Path) -> Iterator[Path]:
    """Yield a new folder beside a place, to be moved there when it is complete; it is removed at the end."""
    part = target.with_name(f".{target.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        yield part
    finally:
        shutil.rmtree(part, ignore_errors=True)


def replace_folder(part: Path, target: Path) -> None:
    """Move a folder to its place; the one that is there is removed."""
    shutil.rmtree(target, ignore_errors=True)
    part.replace(target)


@contextmanager
def in_one_line(path: Path | str) -> Iterator[None]:
    """Raise what the system reports as one line that names a file and what helps."""
    try:
        yield
    except FileNotFoundError as cause:
        raise MissingFileError(f"{path}: expected a file, it is missing") from cause
    except OSError as cause:
        raise StorageError(refusal(cause, path)) from cause


def refusal(cause: OSError, path: Path | str | None = None) -> str:
    """Return what the system refused, in one line that names the file, where it is known, and what helps."""
    path = path or cause.filename2 or cause.filename  # of a copy or a move: where it goes
    got = cause.strerror or str(cause)
    if isinstance(cause, FileExistsError):  # of mkdir
        got = "a file" if os.path.isfile(path or "") else got
        return f"{path}: expected a folder or a free name, got {got}"
    advice = "; free space there, and run again" if cause.errno in NO_SPACE else ""
    return f"{path}: expected to read or write it, got: {got}{advice}" if path else f"{got}{advice}"


def _linked(part: Path, place: Path) -> bool:
    """Whether a whole file was given its place, where none was before."""
    try:
        os.link(part, place)
    except FileExistsError:
        return False
    except OSError as cause:
        if cause.errno not in _NO_LINKS:
            raise
        return _created(part, place)
    return True


def _created(part: Path, place: Path) -> bool:
    """As :func:`_linked`, on a file system without hard links: the last of several writers at once wins."""
    if place.exists():
        return False
    content = part.read_bytes()
    part.replace(place)
    return place.read_bytes() == content
