"""Folders of files: the operations that local folders and object stores share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from omniscv.arguments import shown
from omniscv.errors import ArgumentError


class Folder(ABC):
    """Files by name: a relative path joined by ``/``. Immutable and picklable.

    ``str(folder)`` is safe to print: it holds no credentials. Every operation raises StorageError if the
    folder cannot be read or written, after retries of faults that may pass, and ArgumentError for a name that
    leads out of the folder.
    """

    @abstractmethod
    def exists(self, name: str) -> bool:
        """Return whether a file of that name exists."""

    @abstractmethod
    def names(self, prefix: str = "") -> list[str]:
        """Return the sorted names of all files that start with a prefix, those of inner folders too.

        Hidden files are left out: killed writers may leave some.
        """

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Return the bytes of a file; MissingFileError if it does not exist."""

    @abstractmethod
    def put(self, name: str, content: bytes | Path, first: bool = False) -> bool:
        """Write a file atomically.

        Args:
            name: of the file; inner folders are created.
            content: its bytes, or the local file that holds them.
            first: never replace an existing file: the first writer wins. Stores that cannot do this in one
                step look for the file first, and compare its bytes afterwards.

        Returns:
            Whether this call wrote the file; False only with ``first``.
        """

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file if it exists."""

    @abstractmethod
    def fetch(self, name: str, checksum: str = "") -> Path:
        """Return a local file with the same bytes: the file itself, or a copy in the local cache.

        Args:
            name: of the file.
            checksum: SHA-256 of the copy, hexadecimal. Without it, the copy is of the store's present
                version, and is compared with the checksum of its download.

        Raises:
            MissingFileError: the file does not exist.
            StorageError: its bytes do not match the checksum.
        """

    @abstractmethod
    def copy(self, name: str, path: Path) -> None:
        """Write the bytes of a file to a local path; MissingFileError if it does not exist."""

    @abstractmethod
    def below(self, name: str) -> Folder:
        """Return an inner folder, which need not exist."""

    @property
    @abstractmethod
    def local(self) -> Path | None:
        """The folder as a path; None for an object store."""


def checked_name(name: str) -> str:
    """Return the name of a file or folder below another; ArgumentError for anything else."""
    if isinstance(name, str) and not {"\0", "\\"} & set(name) and not {"", ".", ".."} & set(name.split("/")):
        return name
    raise ArgumentError(f"name: expected the name of a file below a folder, got {shown(name)}")
