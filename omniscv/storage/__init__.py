"""Files in and out: folders of this machine or of an object store by URL (``s3://bucket/rooms``).

``folder(where)`` opens either. URLs are opened through fsspec, which the extra ``cloud`` installs.
"""

from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.storage.base import Folder, in_the_way
from omniscv.storage.local import LocalFolder
from omniscv.storage.remote import SCHEMES, RemoteFolder, is_url, scheme_of, was_url, without_secrets

__all__ = [
    "SCHEMES", "Folder", "StoredFile", "fetch_file", "file_at", "folder", "in_the_way", "is_url",
    "was_url", "without_secrets"
]  # fmt: skip


class StoredFile(NamedTuple):
    """A file: its folder, and its name there."""

    folder: Folder
    name: str


def folder(where: str | Path | Folder) -> Folder:
    """Return the folder of a path or a URL; ``file://`` is a path. A Folder is returned unchanged."""
    if isinstance(where, Folder):
        return where
    if not isinstance(where, str | Path) or not str(where) or "\0" in str(where):
        raise ArgumentError(f"folder: expected a path or a URL, got {shown(where)}")
    if was_url(where):
        raise ArgumentError(f"folder: expected the text of a URL, or a path; got a Path of one, {where}")
    if not is_url(where):
        return LocalFolder(Path(where))
    if scheme_of(where) == "file":
        return LocalFolder(_local_path(where))
    return RemoteFolder(where)


def file_at(where: str | Path) -> StoredFile:
    """Return the file of a path, or of a URL, which does not end with a slash."""
    if is_url(where) and scheme_of(where) != "file":
        inside, _, name = where.rpartition("/")
        if not name or (inside.endswith("/") and scheme_of(where) != "memory"):
            raise ArgumentError(f"expected the URL of a file, got {shown(str(RemoteFolder(where)))}")
        url = f"{inside}/" if inside.endswith("/") else inside
        return StoredFile(RemoteFolder(url), name)
    path = _local_path(where) if is_url(where) else Path(where)
    return StoredFile(LocalFolder(path.parent), path.name)


def fetch_file(where: str | Path) -> Path:
    """Return a path unchanged, and for a URL a copy in the local cache, downloaded once."""
    if not is_url(where):
        return Path(where)
    file = file_at(where)
    return file.folder.fetch(file.name)


def _local_path(url: str) -> Path:
    """Return the path of ``file:///path`` or ``file://localhost/path``."""
    path = url.partition("://")[2].removeprefix("localhost")
    if not path.startswith("/"):
        raise ArgumentError(f"expected file:///PATH, got {shown(url)}")
    return Path(unquote(path))
