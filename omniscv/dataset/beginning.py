"""The folder of a dataset that is written: how it is locked, begun, resumed, replaced and tidied."""

import json
from collections.abc import Collection, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

from omniscv.arguments import shown
from omniscv.compose.files import OBJECTS
from omniscv.dataset import exporting
from omniscv.dataset.belongings import SCRATCH, Belongings, is_listing, roll_back
from omniscv.dataset.manifest import DATASET, FRAMES, Manifest, find, is_dataset, read, with_names, write
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.storage import Folder, in_the_way
from omniscv.storage.local import locked, remove_parts, remove_scratch


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
    Then refuse the folder as :func:`check_new`.

    Only files that the record of the dataset lists are removed; a ``dataset.json`` of another program is
    refused.
    """
    whole = find_own(folder)
    if whole is not None:
        with lock(folder):
            roll_back(folder)
            belongings = Belongings(folder, whole)
            if overwrite or not belongings.frames:
                exporting.remove_exports(folder, belongings.exported())
                folder.remove_files(belongings.files())
                folder.remove(DATASET)  # the last: until then the next run knows the others by it
    check_new(folder)


def find_own(folder: Folder) -> Manifest | None:
    """Return the manifest of the dataset in a folder; None where there is none.

    ArgumentError: a file of another program has its name. DatasetError: it is damaged, or lost beside frames.
    """
    if folder.exists(DATASET) and not is_dataset(folder):
        wanted = f"expected no {DATASET}, or that of a dataset, got one of another program"
        raise ArgumentError(f"{folder}: {wanted}; move it away, or write elsewhere")
    whole = find(folder)
    return read(folder) if whole is None and folder.exists(FRAMES) else whole


def begin(
    folder: Folder, wanted: Manifest, resume: bool, keys: Collection[str] = ()
) -> tuple[Manifest, Mapping[str, Frame]]:
    """Write the manifest of a new dataset, or extend that of a resumed one, under :func:`lock`; return it,
    and the frames that are there by key.

    Args:
        folder: of the dataset.
        wanted: its manifest, as far as it is known.
        resume: whether a dataset that is there is continued.
        keys: of the frames that are to be written; only frames of these are looked for, unless there are
            none: parts of a large dataset do not list the whole folder.

    Raises:
        ArgumentError: a dataset exists and ``resume`` is not set, or it has other cameras, classes or
            settings; or the folder holds images of ``render``.
        DatasetError: its manifest is damaged.
        UnmatchedNamesError: no rule of the classes matches some names.
    """
    current = find_own(folder) if resume else None
    exports = [exporting.Export(**export) for export in wanted.settings.get("exports", ())]
    exporting.check_free(folder, current, exports)
    if DATASET.removesuffix(".json") in keys:
        raise ArgumentError(f"key: expected another than that of {DATASET}, got a frame of this name")
    there = Belongings(folder, current or wanted, keys or None)
    strange = there.strange(keys)
    if strange:  # a killed writer may have left them
        roll_back(folder)
        there = Belongings(folder, current or wanted, keys or None)
        strange = there.strange(keys)
    if current is None:
        check_new(folder, resume)
        strange += [name for name in folder.names() if is_listing(name)]
    if strange:
        raise in_the_way(folder, strange, "this dataset")
    if current is None:
        if not _has_dataset(folder) and write(folder, wanted, first=True):
            return wanted, {}
        current = read(folder)
    extended = _extended(current, wanted, folder)
    if current.to_dict() != extended.to_dict():
        write(folder, extended)
    return extended, there.frames


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
