"""The local cache of files from object stores.

Each copy has a folder, named after the checksum of its bytes, or after its URL and version: a file that
changes in the store gets a new copy. Copies are written atomically, and every writer writes the same bytes.

The modification time of a copy is that of its last use. While the cache is larger than ``OMNISCV_CACHE_GB``
(50), the least recently used copies are removed, but none of the last day: a process may be about to open it.
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
from omniscv.errors import ArgumentError, DamagedFileError, MissingFileError
from omniscv.storage.local import LocalFolder, in_one_line, whole_file

Download = Callable[[Path], None]
"""``download(path)`` writes the bytes of a stored file to a path."""

_SUM = ".sha256"
_LIMIT_GB = 50.0
_KEPT_S = 24 * 3600.0
_CLEANED, _CLEANED_EVERY_S = ".cleaned", 3600.0  # a file whose time is that of the last clean-up
_KEY = re.compile("[0-9a-f]{64}")


def folder() -> Path:
    """Return the cache: ``OMNISCV_CACHE``, or ``omniscv`` in the user's folder of caches."""
    if path := os.environ.get("OMNISCV_CACHE"):
        return Path(path)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "omniscv"


def limit_bytes() -> float:
    """Return the size of the cache, bytes: ``OMNISCV_CACHE_GB`` times 10^9.

    Raises:
        ArgumentError: it is not a number >= 0.
    """
    text = os.environ.get("OMNISCV_CACHE_GB") or str(_LIMIT_GB)
    try:
        return 1e9 * number("OMNISCV_CACHE_GB", float(text), least=0)
    except ValueError as cause:
        raise ArgumentError(f"OMNISCV_CACHE_GB: expected a number >= 0, got {text!r}") from cause


def by_checksum(shown: str, name: str, checksum: str, download: Download) -> Path:
    """Return the copy of a SHA-256; download it if it is missing or differs.

    Raises:
        DamagedFileError: the store has other bytes.
        StorageError: the cache cannot be written.
    """
    path = _path(checksum, name)
    if _digest(path) == checksum:
        return path
    _fetch(path, download, shown, checksum)
    return path


def by_version(url: str, version: str, size: int | None, download: Download) -> Path:
    """Return the copy of a version of a file; download it if it is missing, or has changed since.

    Args:
        url, version: of the file.
        size: in the store, bytes; a copy of another size is downloaded again. None if it is not known.
        download: as :func:`by_checksum`.

    Raises:
        StorageError: the cache cannot be written.
    """
    path = _path(hashlib.sha256(f"{url}\n{version}".encode()).hexdigest(), url.rpartition("/")[2])
    checksums = LocalFolder(path.parent)
    try:
        checksum = checksums.read(path.name + _SUM).decode("ascii", "replace")
    except MissingFileError:
        checksum = ""
    if not checksum or _digest(path) != checksum or size not in (None, path.stat().st_size):
        checksums.put(path.name + _SUM, _fetch(path, download).encode())
    return path


def _path(key: str, name: str) -> Path:
    return folder() / key[:2] / key / name.rpartition("/")[2]


def _digest(path: Path) -> str:
    """Return the SHA-256 of a copy, and mark it as used; an empty text if there is none."""
    try:
        with path.open("rb") as file:
            with suppress(PermissionError):  # another user's cache
                os.utime(path)
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return ""


def _fetch(path: Path, download: Download, shown: str = "", expected: str = "") -> str:
    """Download a file, and return its SHA-256; with an expected one, a file of other bytes is not kept."""
    with in_one_line(path):
        with whole_file(path) as part:
            download(part)
            checksum = _digest(part)
            if expected and checksum != expected:
                sums = f"{expected[:12]}..., got {checksum[:12]}..."
                raise DamagedFileError(f"{shown}: expected the bytes of its checksum {sums}")
        _make_room()
    return checksum


def _make_room() -> None:
    """Remove the least recently used copies while the cache is too large; at most once an hour."""
    limit, now, mark = limit_bytes(), time.time(), folder() / _CLEANED
    if mark.exists() and now - mark.stat().st_mtime < _CLEANED_EVERY_S:
        return
    mark.touch()
    copies = [_use(copy) for copy in folder().glob("??/*") if _KEY.fullmatch(copy.name)]
    size = sum(nbytes for _, nbytes, _ in copies)
    for used, nbytes, copy in sorted(copies):
        if size <= limit or now - used < _KEPT_S:
            return
        shutil.rmtree(copy, ignore_errors=True)  # another process may be removing it
        size -= nbytes


def _use(copy: Path) -> tuple[float, int, Path]:
    """Return the time of a copy's last use, its bytes, and its folder."""
    stats = []
    for file in copy.iterdir():
        with suppress(FileNotFoundError):
            stats.append(file.stat())
    return max((stat.st_mtime for stat in stats), default=0.0), sum(stat.st_size for stat in stats), copy
