"""What a folder of files can do, wherever it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from omniscv.arguments import shown
from omniscv.errors import ArgumentError


class Folder(ABC):
    """Files by name; a name is relative, its parts are joined by ``/``. Immutable; may be pickled.

    ``str(folder)`` is safe to print: it holds no credentials. All operations raise StorageError where the
    place cannot be read or written, after retries where another attempt may help, and ArgumentError for a
    name that leaves the folder.
    """

    @abstractmethod
    def exists(self, name: str) -> bool:
        """Return whether there is a file of that name."""

    @abstractmethod
    def names(self, prefix: str = "") -> list[str]:
        """Return the names of all files that start with a prefix, sorted, those of inner folders too.

        Files whose own name starts with a dot are left out: what killed writers may leave is named so.
        """

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Return the bytes of a file; MissingFileError where there is none."""

    @abstractmethod
    def put(self, name: str, content: bytes | Path, first: bool = False) -> bool:
        """Write a file, whole or not at all.

        Args:
            name: of the file; inner folders are made.
            content: its bytes, or the local file that holds them.
            first: never replace a file that is there: the first writer wins. Stores that cannot do this in
                one step write only where there is none, and compare what is there afterwards.

        Returns:
            Whether this call wrote it; False only with ``first``.
        """

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file, where there is one."""

    @abstractmethod
    def fetch(self, name: str, checksum: str = "") -> Path:
        """Return a local file with the bytes of a file: itself, or a copy in the local cache.

        Args:
            name: of the file.
            checksum: SHA-256 that a copy must have, hexadecimal. Without it, a copy is of the version that
                the store has now, and is compared with what was fetched.

        Raises:
            MissingFileError: there is none.
            StorageError: its bytes are others than the checksum's.
        """

    @abstractmethod
    def copy(self, name: str, path: Path) -> None:
        """Write the bytes of a file to a local path; MissingFileError where there is none."""

    @abstractmethod
    def below(self, name: str) -> Folder:
        """Return an inner folder, whether it is there or not."""

    @property
    @abstractmethod
    def local(self) -> Path | None:
        """The folder as a path; None where it is not on this machine."""


def checked(name: str) -> str:
    """Return the name of a file or folder below another; ArgumentError where it is none."""
    if not isinstance(name, str) or "\0" in name or "\\" in name:
        raise ArgumentError(f"name: expected the name of a file below a folder, got {shown(name)}")
    if any(part in ("", ".", "..") for part in name.split("/")):
        raise ArgumentError(f"name: expected the name of a file below a folder, got {shown(name)}")
    return name
