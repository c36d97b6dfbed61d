"""Frames in the folder of a dataset, on this machine or by URL: written, and found again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from tempfile import gettempdir

from omniscv.dataset import manifest
from omniscv.dataset.manifest import FrameEntry
from omniscv.errors import DatasetError, MissingFileError
from omniscv.storage import Folder
from omniscv.storage.local import locked, remove_parts, remove_scratch, scratch_folder


def alone(folder: Folder) -> AbstractContextManager[None]:
    """Hold a folder of this machine alone among processes. A URL is held by nobody: its files are written
    whole, and equal by all."""
    return nullcontext() if folder.local is None else locked(folder.local)


_SCRATCH = ".omniscv-"


@contextmanager
def workplace(folder: Folder) -> Iterator[Path]:
    """Give an empty folder where the files of a frame are written, inside a folder of this machine.

    It is the writer's own: two may make one frame, as where a worker that was taken for dead goes on.
    """
    parent = Path(gettempdir()) if folder.local is None else folder.local
    with scratch_folder(parent, _SCRATCH) as scratch:
        yield scratch


def put(folder: Folder, paths: Iterable[Path]) -> None:
    """Move files of its :func:`workplace` into a folder, in their order."""
    for path in paths:
        if folder.local is None:
            folder.put(path.name, path)
        else:
            path.replace(folder.local / path.name)


def tidy(folder: Folder) -> None:
    """Remove what killed writers have left in a folder of this machine, under :func:`alone`.

    Only names that writers of datasets make are removed; the scratch folders of living writers stay.
    """
    if folder.local is not None:
        remove_scratch(folder.local, _SCRATCH)
        for name in (manifest.DATASET, manifest.FRAMES):
            remove_parts(folder.local / name)


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
