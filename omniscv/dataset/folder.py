"""The folder of a dataset while it is written, on this machine or by URL: its lock, manifest and files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from tempfile import gettempdir
from typing import Any

from omniscv.arguments import shown
from omniscv.compose.files import OBJECTS
from omniscv.dataset import manifest
from omniscv.dataset.manifest import MOST_IDS, Manifest
from omniscv.errors import ArgumentError, DamagedFileError, DatasetError, MissingFileError
from omniscv.frame import Frame, FrameFiles
from omniscv.storage import Folder
from omniscv.storage.bounded import MOST_JSON_BYTES
from omniscv.storage.local import locked, remove_parts, remove_scratch, scratch_folder

_SCRATCH = ".omniscv-"
_OWN = (manifest.DATASET, manifest.FRAMES, "exports", "parts")


def lock(folder: Folder) -> AbstractContextManager[None]:
    """Hold the lock of a local folder.

    Object stores are not locked. Files are written atomically, and every writer produces the same bytes.
    """
    return nullcontext() if folder.local is None else locked(folder.local)


# -- the manifest ----------------------------------------------------------------------------------------


def check_new(folder: Folder, resume: bool = False) -> None:
    """Refuse a folder that holds images of ``render``, or a dataset that is not resumed.

    Raises:
        ArgumentError: it does.
    """
    if not resume and _has_dataset(folder):
        raise _taken(folder, "a dataset; --resume completes it, --overwrite replaces it, or")
    if folder.exists(OBJECTS):
        raise _taken(folder, "images of 'render';")


def make_room(folder: Folder, overwrite: bool = False) -> None:
    """Remove a dataset that has no frames yet, as a job leaves it that failed at once; ``overwrite``: any.

    Raises:
        ArgumentError: as :func:`check_new`.
    """
    if _has_dataset(folder) and (overwrite or not _frame_names(folder)):
        stems = {name.partition(".")[0] for name in _frame_names(folder)}
        for name in sorted(folder.names(), key=lambda name: name == manifest.DATASET):  # the manifest last
            top = name.partition("/")[0]
            if top in _OWN or (top == name and name.partition(".")[0] in stems):
                folder.remove(name)
    check_new(folder)


def _frame_names(folder: Folder) -> list[str]:
    """Return the names of the files that are the last of a frame."""
    others = (manifest.DATASET, OBJECTS)
    return [
        name for name in folder.names() if name.endswith(".json") and "/" not in name and name not in others
    ]


def begin(folder: Folder, wanted: Manifest, resume: bool) -> Manifest:
    """Write the manifest of a new dataset, or extend that of a resumed one, under :func:`lock`; return it.

    Raises:
        ArgumentError: a dataset exists and ``resume`` is not set, or it has other cameras, classes or
            settings; or the folder holds images of ``render``.
        DatasetError: its manifest is damaged.
        UnmatchedNamesError: no rule of the classes matches some names.
    """
    current = manifest.find(folder) if resume else None
    if current is None:
        check_new(folder, resume)
        if not _has_dataset(folder) and manifest.write(folder, wanted, first=True):
            return wanted
        current = manifest.read(folder)
    extended = _extended(current, wanted, folder)
    if current.to_dict() != extended.to_dict():
        manifest.write(folder, extended)
    return extended


def with_names(names: Mapping[str, int], new: Iterable[str]) -> dict[str, int]:
    """Return names with ids; new ones follow in sorted order.

    Raises:
        ArgumentError: more than labels can tell apart.
    """
    extended = {**names, **{name: i for i, name in enumerate(sorted(new), start=len(names) + 1)}}
    if len(extended) > MOST_IDS:
        raise ArgumentError(f"names: expected at most {MOST_IDS} objects in a dataset, got {len(extended)}")
    return extended


def _extended(current: Manifest, wanted: Manifest, folder: Folder) -> Manifest:
    """Return the manifest of a resumed dataset; ArgumentError if it was begun with other values."""
    for name, camera in wanted.cameras.items():
        if current.cameras.get(name, camera) != camera:
            raise _differs(folder, f"camera {name!r} as {current.cameras[name]!r}")
    if wanted.rules is not None and current.rules != wanted.rules:
        raise _differs(folder, "other classes" if current.rules else "no classes")
    settings = json.loads(json.dumps(wanted.settings))  # as it is read: lists for tuples
    if settings and (differ := _difference(current.settings, settings)):
        raise _differs(folder, differ)
    names = with_names(current.names, [name for name in wanted.names if name not in current.names])
    return replace(current, names=names, cameras={**current.cameras, **wanted.cameras})


def _difference(there: Mapping[str, Any], wanted: Mapping[str, Any], start: str = "") -> str:
    """Return the first setting that two datasets have with other values, and both; empty if there is none."""
    for key, value in wanted.items():
        other = there.get(key)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            if below := _difference(other, {**dict.fromkeys(other), **value}, f"{start}{key}."):
                return below
        elif value != other:
            return f"{start}{key} {shown(other)}, and the job {shown(value)}"
    return ""


def _has_dataset(folder: Folder) -> bool:
    """Return whether a folder holds a dataset, complete or not."""
    return any(folder.exists(name) for name in (manifest.DATASET, manifest.FRAMES))


def _taken(folder: Folder, content: str) -> ArgumentError:
    return ArgumentError(f"{folder}: expected a new folder, got {content} write elsewhere")


def _differs(folder: Folder, difference: str) -> ArgumentError:
    wanted = "expected the dataset that is resumed to be the same"
    return ArgumentError(
        f"{folder}: {wanted}, it has {difference}; --overwrite replaces it, or write elsewhere"
    )


# -- files of frames -------------------------------------------------------------------------------------


@contextmanager
def scratch(folder: Folder) -> Iterator[Path]:
    """Give an empty folder in which the files of one frame are written, inside a local folder of a dataset.

    Each writer has its own: two may write one frame, as when a worker that was taken for dead continues.
    """
    parent = Path(gettempdir()) if folder.local is None else folder.local
    with scratch_folder(parent, _SCRATCH) as path:
        yield path


def put(folder: Folder, paths: Sequence[Path], last: Path) -> None:
    """Move files of a :func:`scratch` folder into a dataset, one of them after all others."""
    if folder.local is None:
        folder.each(lambda path: folder.put(path.name, path), paths)
        folder.put(last.name, last)
        return
    for path in (*paths, last):
        path.replace(folder.local / path.name)


def tidy(folder: Folder) -> None:
    """Remove what killed writers have left in a local folder, under :func:`lock`.

    Only names that writers of datasets use are removed; the scratch folders of live writers stay.
    """
    if folder.local is not None:
        remove_scratch(folder.local, _SCRATCH)
        for name in (manifest.DATASET, manifest.FRAMES):
            remove_parts(folder.local / name)


def read_frame(folder: Folder, whole: Manifest, key: str) -> Frame | None:
    """Return a frame of a dataset; None if it is missing or damaged.

    Local files are compared with their checksums. In a store the frame's last file is enough.
    """
    name = f"{key}.json"
    try:
        frame = whole.frame_of_file(name, folder.read(name, MOST_JSON_BYTES), folder)
    except (DatasetError, DamagedFileError, MissingFileError):
        return None
    return None if is_damaged(folder, frame, deep=True) else frame


def is_damaged(folder: Folder, frame: Frame, deep: bool) -> bool:
    """Return whether a local file of a frame is missing, of another size, or, ``deep``, has other bytes.

    Files of a store are not read: they are written whole.
    """
    local, files = folder.local, frame.files
    if local is None or not isinstance(files, FrameFiles):
        return False
    if deep:
        return any(files.fault(kind) for kind in files)
    return any(entry.fault(local, deep=False) for entry in frame.entries.values())
