"""The local cache of what was fetched from object stores.

A copy lies in a folder of its own, named after what it is: the checksum of its bytes, or the URL and the
version that the store has. So a file that changes in the store is another copy, and processes that fetch one
file at a time write equal bytes, each beside its place, and move them there.

The time of a copy's file is that of its last use. Where all are larger than ``OMNISCV_CACHE_GB`` (50), those
that were not used for longest are removed, but none of the last day: a process may be about to open it.
"""

import hashlib
import os
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from omniscv.arguments import number
from omniscv.errors import ArgumentError, MissingFileError, StorageError
from omniscv.storage.local import LocalFolder, in_one_line, written_beside

Download = Callable[[Path], None]
"""``download(path)`` writes the bytes of a stored file to a path."""

_SUM = ".sha256"
_LIMIT_GB = 50.0
_KEPT_S = 24 * 3600.0
_CLEANED, _CLEANED_EVERY_S = ".cleaned", 3600.0  # a file, whose time is that of the last look at all copies
_KEY = re.compile("[0-9a-f]{64}")


def folder() -> Path:
    """Return the cache: ``OMNISCV_CACHE``, or ``omniscv`` in the user's folder of caches."""
    if given := os.environ.get("OMNISCV_CACHE"):
        return Path(given)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "omniscv"


def limit_bytes() -> float:
    """Return how many bytes of copies are kept: ``OMNISCV_CACHE_GB``, 10^9 bytes each.

    Raises:
        ArgumentError: it is no number, or below 0.
    """
    text = os.environ.get("OMNISCV_CACHE_GB") or str(_LIMIT_GB)
    try:
        return 1e9 * number("OMNISCV_CACHE_GB", float(text), least=0)
    except ValueError as cause:
        raise ArgumentError(f"OMNISCV_CACHE_GB: expected a number >= 0, got {text!r}") from cause


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
    """The SHA-256 of a copy, which is used thereby; empty where there is none."""
    try:
        with place.open("rb") as file:
            with suppress(PermissionError):  # a cache that others fill
                os.utime(place)
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return ""


def _fetched(place: Path, download: Download) -> str:
    """Fetch a file to its place, and return its SHA-256."""
    with in_one_line(place), written_beside(place) as part:
        download(part)
        got = _digest(part)
        part.replace(place)
        _make_room()
    return got


def _make_room() -> None:
    """Remove the copies that were not used for longest while all are too large; look once an hour."""
    limit, now, mark = limit_bytes(), time.time(), folder() / _CLEANED
    if mark.exists() and now - mark.stat().st_mtime < _CLEANED_EVERY_S:
        return
    mark.touch()
    copies = [_use(each) for each in folder().glob("??/*") if _KEY.fullmatch(each.name)]
    size = sum(nbytes for _, nbytes, _ in copies)
    for used, nbytes, copy in sorted(copies):
        if size <= limit or now - used < _KEPT_S:
            return
        shutil.rmtree(copy, ignore_errors=True)  # another process may be removing it
        size -= nbytes


def _use(copy: Path) -> tuple[float, int, Path]:
    """When a copy was last used, its bytes, and its folder."""
    stats = []
    for each in copy.iterdir():
        with suppress(FileNotFoundError):
            stats.append(each.stat())
    return max((each.st_mtime for each in stats), default=0.0), sum(each.st_size for each in stats), copy
