"""Frames in the folder of a dataset, on this machine or by URL: written, and found again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from tempfile import gettempdir

from omniscv.dataset import manifest
from omniscv.dataset.manifest import Manifest
from omniscv.errors import DatasetError, MissingFileError
from omniscv.frame import Frame
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


def frame_of(folder: Folder, whole: Manifest, key: str) -> Frame | None:
    """Return a frame of a dataset; None if it is missing or damaged.

    Local files are compared with their checksums. In a store the frame's last file is enough.
    """
    name = f"{key}.json"
    try:
        frame = whole.frame_of_file(name, folder.read(name), folder)
    except (DatasetError, MissingFileError):
        return None
    return None if frame.key != key or damaged(folder, frame, deep=True) else frame


def damaged(folder: Folder, frame: Frame, deep: bool) -> bool:
    """Return whether a local file of a frame is missing, of another size, or, ``deep``, has other bytes.
    Files
    of a store are not checked: stores write whole files, and keep them so."""
    local = folder.local
    return local is not None and any(entry.fault(local, deep) for entry in frame.entries.values())
