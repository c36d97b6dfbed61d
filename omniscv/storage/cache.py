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
from omniscv.errors import DamagedFileError
from omniscv.storage.local import storage_errors, whole_file, write_text

Download = Callable[[Path], None]
"""``download(path)`` writes the bytes of a stored file to a path."""

_SUM = ".sha256"
_LIMIT_GB = 50.0  # unless OMNISCV_CACHE_GB says another
_KEPT_S = 24 * 3600.0  # since the last use: then a copy may be removed
_CLEANED = ".cleaned"  # a file whose time is that of the last clean-up
_CLEANED_EVERY_S = 3600.0
_KEY = re.compile("[0-9a-f]{64}")


def folder() -> Path:
    """Return the cache: ``OMNISCV_CACHE``, or ``omniscv`` in the user's folder of caches."""
    path = os.environ.get("OMNISCV_CACHE")
    if path:
        return Path(path)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "omniscv"


def copy_of(
    key: str, name: str, download: Download, *, checksum: str = "", size: int | None = None, shown: str = ""
) -> Path:
    """Return the copy of a file; download it if it is missing or differs.

    Args:
        key: 64 hexadecimal digits, of the file's bytes, or of its URL and version.
        name: of the file.
        download: see :data:`Download`.
        checksum: SHA-256 of the bytes; if it is empty, that of the first download is kept beside the copy.
        size: in the store, bytes; a copy of another size is downloaded again. None if it is not known.
        shown: what messages call the file.
    """
    path = folder() / key[:2] / key / name.rpartition("/")[2]
    sums = path.with_name(path.name + _SUM)
    with storage_errors(path):
        expected = checksum
        if not checksum and sums.exists():
            expected = sums.read_text("ascii", "replace")
        if expected and _digest(path) == expected and size in (None, path.stat().st_size):
            return path
        with whole_file(path) as part:
            download(part)
            digest = _digest(part)
            if checksum and digest != checksum:
                difference = f"{checksum[:12]}..., got {digest[:12]}..."
                raise DamagedFileError(f"{shown}: expected the bytes of its checksum {difference}")
        if not checksum:
            write_text(sums, digest)
        _make_room()
    return path


def _digest(path: Path) -> str:
    """Return the SHA-256 of a copy, and mark it as used; an empty text if there is none."""
    try:
        with path.open("rb") as file:
            with suppress(PermissionError):  # another user's cache
                os.utime(path)
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return ""


def _make_room() -> None:
    """Remove the least recently used copies while the cache is too large; at most once an hour."""
    limit_gb = number("OMNISCV_CACHE_GB", os.environ.get("OMNISCV_CACHE_GB") or _LIMIT_GB, least=0)
    now = time.time()
    mark = folder() / _CLEANED
    if mark.exists() and now - mark.stat().st_mtime < _CLEANED_EVERY_S:
        return
    mark.touch()
    copies = []
    size = 0
    for copy in folder().glob("??/*"):
        if _KEY.fullmatch(copy.name):
            used, nbytes = _last_use(copy)
            copies.append((used, nbytes, copy))
            size += nbytes
    for used, nbytes, copy in sorted(copies):
        if size <= 1e9 * limit_gb or now - used < _KEPT_S:
            return
        shutil.rmtree(copy, ignore_errors=True)  # another process may be removing it
        size -= nbytes


def _last_use(copy: Path) -> tuple[float, int]:
    """Return the time of a copy's last use, seconds since 1970, and its bytes."""
    used = 0.0
    nbytes = 0
    for file in copy.iterdir():
        with suppress(FileNotFoundError):
            stat = file.stat()
            used = max(used, stat.st_mtime)
            nbytes += stat.st_size
    return used, nbytes
