"""The local cache of what was fetched from object stores.

A copy lies in a folder of its own, named after what it is: the checksum of its bytes, or the URL and the
version that the store has. So a file that changes in the store is another copy, and processes that fetch one
file at a time write equal bytes, each beside its place, and move them there.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

from omniscv.errors import MissingFileError, StorageError
from omniscv.storage.local import LocalFolder, in_one_line, written_beside

Download = Callable[[Path], None]
"""``download(path)`` writes the bytes of a stored file to a path."""

_SUM = ".sha256"


def folder() -> Path:
    """Return the cache: ``OMNISCV_CACHE``, or ``omniscv`` in the user's folder of caches."""
    if given := os.environ.get("OMNISCV_CACHE"):
        return Path(given)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "omniscv"


def by_checksum(shown: str, name: str, checksum: str, download: Download) -> Path:
    """Return a copy with a SHA-256, fetched if there is none or another one.

    Raises:
        StorageError: the store has other bytes, or the cache cannot be written.
    """
    place = _place(checksum, name)
    if _digest(place) == checksum:
        return place
    if (got := _fetched(place, download)) != checksum:
        place.unlink(missing_ok=True)
        raise StorageError(
            f"{shown}: expected the bytes of its checksum {checksum[:12]}..., got {got[:12]}..."
        )
    return place


def by_version(url: str, version: str, download: Download) -> Path:
    """Return a copy of a version of a file, fetched if there is none or it is not as it was fetched.

    Raises:
        StorageError: the cache cannot be written.
    """
    place = _place(hashlib.sha256(f"{url}\n{version}".encode()).hexdigest(), url.rpartition("/")[2])
    noted = LocalFolder(place.parent)
    try:
        known = noted.read(place.name + _SUM).decode("ascii", "replace")
    except MissingFileError:
        known = ""
    if not known or _digest(place) != known:
        noted.put(place.name + _SUM, _fetched(place, download).encode())
    return place


def _place(key: str, name: str) -> Path:
    return folder() / key[:2] / key / name.rpartition("/")[2]


def _digest(place: Path) -> str:
    """The SHA-256 of a copy; empty where there is none."""
    try:
        with place.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return ""


def _fetched(place: Path, download: Download) -> str:
    """Fetch a file to its place, and return its SHA-256."""
    with in_one_line(place), written_beside(place) as part:
        download(part)
        got = _digest(part)
        part.replace(place)
    return got
