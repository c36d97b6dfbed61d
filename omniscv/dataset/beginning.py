"""The folder of a dataset that is written: how it is locked, begun, resumed, replaced and tidied."""

import json
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

from omniscv.arguments import shown
from omniscv.compose.files import OBJECTS
from omniscv.dataset.manifest import DATASET, FAILED, FRAMES, Manifest, find, read, with_names, write
from omniscv.errors import ArgumentError
from omniscv.storage import Folder
from omniscv.storage.local import locked, remove_parts, remove_scratch

SCRATCH = ".omniscv-"
"""Start of the names of folders in which frames are written."""

_OWN = (DATASET, FRAMES, FAILED, "exports", "parts")


def lock(folder: Folder) -> AbstractContextManager[None]:
    """Hold the lock of a local folder.

    Object stores are not locked. Files are written atomically, and every writer produces the same bytes.
    """
    return nullcontext() if folder.local is None else locked(folder.local)


def check_new(folder: Folder, resume: bool = False) -> None:
    """Refuse a folder that holds images of ``render``, or a dataset that is not resumed."""
    content = ""
    if not resume and _has_dataset(folder):
        content = "a dataset; --resume completes it, --overwrite replaces it, or"
    elif folder.exists(OBJECTS):
        content = "images of 'render';"
    if content:
        raise ArgumentError(f"{folder}: expected a new folder, got {content} write elsewhere")


def make_room(folder: Folder, overwrite: bool = False) -> None:
    """Remove a dataset that has no frames yet, as a job leaves it that failed at once; ``overwrite``: any.
    Then refuse the folder as :func:`check_new`."""
    frames = _frame_names(folder) if _has_dataset(folder) else None
    if frames is not None and (overwrite or not frames):
        stems = {name.partition(".")[0] for name in frames}
        for name in sorted(folder.names(), key=lambda name: name == DATASET):  # the manifest last
            top = name.partition("/")[0]
            if top in _OWN or (top == name and name.partition(".")[0] in stems):
                folder.remove(name)
    check_new(folder)


def _frame_names(folder: Folder) -> list[str]:
    """Return the names of the files that are the last of a frame."""
    names = (name for name in folder.names() if name.endswith(".json") and "/" not in name)
    return [name for name in names if name not in (DATASET, OBJECTS)]


def begin(folder: Folder, wanted: Manifest, resume: bool) -> Manifest:
    """Write the manifest of a new dataset, or extend that of a resumed one, under :func:`lock`; return it.

    Raises:
        ArgumentError: a dataset exists and ``resume`` is not set, or it has other cameras, classes or
            settings; or the folder holds images of ``render``.
        DatasetError: its manifest is damaged.
        UnmatchedNamesError: no rule of the classes matches some names.
    """
    current = find(folder) if resume else None
    if current is None:
        check_new(folder, resume)
        if not _has_dataset(folder) and write(folder, wanted, first=True):
            return wanted
        current = read(folder)
    extended = _extended(current, wanted, folder)
    if current.to_dict() != extended.to_dict():
        write(folder, extended)
    return extended


def _extended(current: Manifest, wanted: Manifest, folder: Folder) -> Manifest:
    """Return the manifest of a resumed dataset; ArgumentError if it was begun with other values.

    Exports may be others: no frame depends on them.
    """
    for name, camera in wanted.cameras.items():
        if current.cameras.get(name, camera) != camera:
            raise _differs(folder, f"its camera {name!r} is {current.cameras[name]!r}")
    if wanted.rules is not None and current.rules != wanted.rules:
        raise _differs(folder, f"it has {'other' if current.rules else 'no'} classes")
    settings = json.loads(json.dumps(wanted.settings))  # as it is read: lists for tuples
    begun = {**current.settings, **{key: settings[key] for key in ("exports",) if key in settings}}
    if differ := _difference(begun, settings):
        raise _differs(folder, f"its {differ}")
    names = with_names(current.names, wanted.names.keys() - current.names)
    return replace(current, names=names, cameras={**current.cameras, **wanted.cameras}, settings=begun)


def _difference(there: Mapping[str, Any], wanted: Mapping[str, Any], start: str = "") -> str:
    """Return the first setting that two datasets have with other values, and both; empty if there is none."""
    for key, value in wanted.items():
        other = there.get(key)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            if below := _difference(other, {**dict.fromkeys(other), **value}, f"{start}{key}."):
                return below
        elif value != other:
            return f"{start}{key} is {shown(other)}, in the job {shown(value)}"
    return ""


def _has_dataset(folder: Folder) -> bool:
    """Return whether a folder holds a dataset, complete or not."""
    return any(folder.exists(name) for name in (DATASET, FRAMES))


def _differs(folder: Folder, difference: str) -> ArgumentError:
    wanted, advice = "expected a job with the settings of the dataset", "--overwrite replaces the dataset"
    return ArgumentError(f"{folder}: {wanted}; {difference}; {advice}, or write elsewhere")


def tidy(folder: Folder) -> None:
    """Remove what killed writers have left in a local folder, under :func:`lock`.

    Only names that writers of datasets use are removed; the scratch folders of live writers stay.
    """
    if folder.local is not None:
        remove_scratch(folder.local, SCRATCH)
        for name in (DATASET, FRAMES):
            remove_parts(folder.local / name)
