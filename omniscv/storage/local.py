"""A folder on this machine."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from glob import escape
from pathlib import Path

from omniscv.errors import MissingFileError, StorageError
from omniscv.storage.base import Folder, checked

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_TOKEN_BYTES = 8
_TOKEN_PATTERN = "[0-9a-f]" * (2 * _TOKEN_BYTES)
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
    part = place.with_name(f".{place.stem}.{secrets.token_hex(_TOKEN_BYTES)}{place.suffix}")
    try:
        yield part
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield where to write a file, and move it to ``path`` once it is complete: no half file is ever seen.

    Raises:
        StorageError: there is no space for it.
    """
    try:
        with written_beside(path) as part:
            yield part
            part.replace(path)
    except OSError as cause:
        if cause.errno not in NO_SPACE:
            raise
        raise StorageError(refusal(cause, path)) from cause


def remove_parts(path: Path) -> None:
    """Remove what killed processes left of a file that was to be moved to ``path``.

    Only for files that one process writes at a time: a living writer's part goes, too.
    """
    for part in path.parent.glob(f".{escape(path.stem)}.{_TOKEN_PATTERN}{escape(path.suffix)}"):
        part.unlink(missing_ok=True)


@contextmanager
def scratch_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """Yield a new, empty folder ``PREFIX`` + token in ``parent``; it is removed at the end.

    It is locked meanwhile, so that :func:`remove_scratch` of another process or thread leaves it alone.
    """
    while True:
        folder = parent / f"{prefix}{secrets.token_hex(_TOKEN_BYTES)}"
        folder.mkdir(parents=True)
        with _try_lock(folder) as held:
            if not held and fcntl is not None:  # remove_scratch came between the two
                continue
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            return


def remove_scratch(parent: Path, prefix: str) -> None:
    """Remove the scratch folders of a prefix that killed processes left in ``parent``."""
    for folder in parent.glob(f"{escape(prefix)}{_TOKEN_PATTERN}"):
        with _try_lock(folder) as held:
            if held:
                shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder alone, among processes and threads; wait for it. A killed holder leaves no lock.

    Without effect on Windows, where only one process at a time may write a folder.
    """
    if fcntl is None:
        yield
        return
    opened = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(opened, fcntl.LOCK_EX)
        yield
    finally:
        os.close(opened)


@contextmanager
def _try_lock(folder: Path) -> Iterator[bool]:
    """Yield whether a folder is there and was free, held until the end."""
    if fcntl is None:
        yield False
        return
    try:
        opened = os.open(folder, os.O_RDONLY)
    except OSError:
        yield False
        return
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        held = folder.exists()
    except OSError:
        held = False
    try:
        yield held
    finally:
        os.close(opened)


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
