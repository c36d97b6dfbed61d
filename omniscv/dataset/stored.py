"""Frames in the folder of a dataset, on this machine or by URL: written, and found again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

from omniscv.dataset import manifest
from omniscv.dataset.manifest import FrameEntry
from omniscv.errors import DatasetError, MissingFileError
from omniscv.storage import Folder


def alone(folder: Folder) -> AbstractContextManager[None]:
    """Hold a folder of this machine alone among processes. A URL is held by nobody: its files are written
    whole, and equal by all."""
    return nullcontext() if folder.local is None else manifest.locked(folder.local)


@contextmanager
def workplace(folder: Folder) -> Iterator[Path]:
    """Give where the files of a frame are written: the folder itself, or an empty one for a URL."""
    if folder.local is not None:
        yield folder.local
        return
    with TemporaryDirectory(prefix="omniscv-") as scratch:
        yield Path(scratch)


def put(folder: Folder, paths: Iterable[Path]) -> None:
    """Put files of its :func:`workplace` into a folder, in their order; one of this machine has them."""
    if folder.local is None:
        for path in paths:
            folder.put(path.name, path)


def frame_of(folder: Folder, key: str) -> FrameEntry | None:
    """Return a frame that is there; None where it is not, or damaged.

    The files of a frame are compared with their checksums on this machine. By URL its last file is enough.
    """
    name = f"{key}.json"
    try:
        entry = manifest.entry_of(name, folder.read(name))
    except (DatasetError, MissingFileError):
        return None
    return None if entry.key != key or damaged(folder, entry, deep=True) else entry


def damaged(folder: Folder, entry: FrameEntry, deep: bool) -> bool:
    """Return whether a file of a frame on this machine is missing, of another size, or, ``deep``, of other
    bytes. What lies in a store is not asked for: it is whole there, and the store keeps it so."""
    local = folder.local
    return local is not None and any(each.fault(local, deep) for each in entry.files.values())
