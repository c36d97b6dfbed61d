"""Folders of files: the operations that local folders and object stores share."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import TypeVar

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.parallel import side_by_side

T = TypeVar("T")
R = TypeVar("R")

_NAMED = 3  # files of others that a message names

MOST_BYTES = 1 << 30
"""The largest file that is read into memory."""

_REQUESTS = 16
"""Requests to a store at the same time."""


class Folder(ABC):
    """Files by name: a relative path joined by ``/``. Immutable and picklable.

    ``str(folder)`` is safe to print: it holds no credentials. Every operation raises StorageError if the
    folder cannot be read or written, after retries of faults that may pass, MissingFileError for a file that
    is not there, and ArgumentError for a name that leads out of the folder.
    """

    @abstractmethod
    def exists(self, name: str) -> bool:
        """Return whether a file of that name exists."""

    @abstractmethod
    def names(self, prefix: str = "") -> list[str]:
        """Return the sorted names of all files that start with a prefix, in inner folders too, but of hidden
        ones: killed writers may leave some."""

    @abstractmethod
    def read(self, name: str, most: int = MOST_BYTES) -> bytes:
        """Return the bytes of a regular file.

        Args:
            name: of the file.
            most: bytes that it may have; DamagedFileError if it has more, or is a pipe.
        """

    @abstractmethod
    def put(self, name: str, content: bytes | Path, first: bool = False) -> bool:
        """Write a file atomically; return whether this call wrote it.

        Args:
            name: of the file.
            content: bytes, or a local file that has them.
            first: whether an existing file is never replaced, so that the first writer wins. Stores that
                cannot do this in one step look for the file first, and compare its bytes afterwards.
        """

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file if it exists."""

    @abstractmethod
    def fetch(self, name: str, checksum: str = "", size: int = sys.maxsize) -> Path:
        """Return a local file with the same bytes: the file itself, or a copy in the local cache.

        Args:
            name: of the file.
            checksum: SHA-256 of a copy, hexadecimal; DamagedFileError if it has another. Without a checksum
                it is of the store's present version, and is compared with its size in the store, and with the
                checksum of its download.
            size: bytes that a copy may have; DamagedFileError if it has more.
        """

    @abstractmethod
    def copy(self, name: str, path: Path, most: int | None = None) -> None:
        """Write the bytes of a file to a local path.

        Args:
            name: of the file.
            path: that is written.
            most: bytes that a store's file may have; None: those that the store says. Else DamagedFileError.
        """

    @abstractmethod
    def below(self, name: str) -> "Folder":
        """Return an inner folder, which need not exist."""

    @property
    @abstractmethod
    def local(self) -> Path | None:
        """The folder as a path; None for an object store."""

    def each(self, function: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """Return the results of a function that uses the folder's files, for every item, in order.

        Requests to a store overlap; files of a local folder are processed on all cores.

        Args:
            function: is called with each item, in threads.
            items: such as names of files.
        """
        if self.local is not None or len(items) < 2:
            return side_by_side(function, items)
        with ThreadPoolExecutor(min(len(items), _REQUESTS)) as threads:
            return list(threads.map(function, items))

    def remove_files(self, names: Sequence[str]) -> None:
        """Remove files, and the local inner folders that are empty then."""
        self.each(self.remove, names)
        if self.local is None:
            return
        inner: set[str] = set()
        for name in names:
            inner.update(map(str, PurePosixPath(name).parents))
        inner.discard(".")
        for name in sorted(inner, reverse=True):  # folders before those that they are in
            with suppress(OSError):  # it holds something else
                (self.local / name).rmdir()


def is_name(name: object) -> bool:
    """Return whether a text names a file or folder below another."""
    if not isinstance(name, str) or "\0" in name or "\\" in name:
        return False
    return not {"", ".", ".."} & set(name.split("/"))


def checked_name(name: str) -> str:
    """Return the name of a file or folder below another; ArgumentError for anything else."""
    if is_name(name):
        return name
    raise ArgumentError(f"name: expected the name of a file below a folder, got {shown(name)}")


def in_the_way(folder: Folder, names: Sequence[str], what: str) -> ArgumentError:
    """Return the error of files of somebody else where files are to be written.

    Args:
        folder: where they are.
        names: of the files.
        what: would be written there, in a few words.
    """
    shown = ", ".join(names[:_NAMED])
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    wanted = f"expected free names for {what}, got files that it has not written: {shown}{more}"
    return ArgumentError(f"{folder}: {wanted}; move them away, or write elsewhere")
