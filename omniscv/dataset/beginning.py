"""The folder of a dataset that is written: how it is locked, begun, resumed, replaced and tidied."""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

from omniscv.compose.files import OBJECTS
from omniscv.dataset import exported
from omniscv.dataset.belongings import SCRATCH, Belongings, is_listing, roll_back
from omniscv.dataset.exporting import Export
from omniscv.dataset.manifest import (
    DATASET,
    FAILED,
    FRAMES,
    PLANNED,
    Manifest,
    find,
    is_dataset,
    read,
    read_planned,
    with_names,
    write,
    write_planned,
)
from omniscv.dataset.origin import Origin, World, differences, frame_difference, plain, world_difference
from omniscv.errors import ArgumentError, DatasetError, ExistingDatasetError, OtherDatasetError
from omniscv.frame import Frame
from omniscv.frame.classes import ClassRules
from omniscv.storage import Folder, in_the_way
from omniscv.storage.local import is_written, locked, remove_parts, remove_scratch


def lock(folder: Folder) -> AbstractContextManager[None]:
    """Hold the lock of a local folder.

    Object stores are not locked. Files are written atomically, and every writer produces the same bytes.
    """
    return nullcontext() if folder.local is None else locked(folder.local)


def refuse_existing(folder: Folder) -> None:
    """Raise ExistingDatasetError for a folder that holds a dataset with frames."""
    whole = find_own(folder)
    if whole is not None and Belongings(folder, whole).frames:
        raise ExistingDatasetError(f"{folder}: expected a new folder, got a dataset")


def find_own(folder: Folder) -> Manifest | None:
    """Return the manifest of the dataset in a folder; None where there is none.

    ArgumentError: a file of another program has its name. DatasetError: it is damaged, or lost beside frames.
    """
    try:
        whole = find(folder)
    except DatasetError as damaged:
        if is_dataset(folder):
            raise
        wanted = f"expected no {DATASET}, or that of a dataset, got one of another program"
        raise ArgumentError(f"{folder}: {wanted}; move it away, or write elsewhere") from damaged
    return read(folder) if whole is None and folder.exists(FRAMES) else whole


def replace_dataset(folder: Folder) -> None:
    """Remove the files that the record of a dataset lists, if there is one; ArgumentError if another process
    is writing it."""
    whole = find_own(folder)
    if whole is not None:
        with lock(folder):
            if _is_written(folder):
                wanted = "expected a dataset that no other process is writing"
                raise ArgumentError(f"{folder}: {wanted}; wait for its end, or write elsewhere")
            roll_back(folder)
            _remove(folder, Belongings(folder, whole))


def _remove(folder: Folder, belongings: Belongings) -> None:
    exported.remove_exports(folder, belongings.exported())
    lists = []
    described = []
    layers = []
    for name in belongings.files():
        if is_listing(name):
            lists.append(name)
        elif name.endswith(".json"):
            described.append(name)
        else:
            layers.append(name)
    # Files that list others are removed after them: if the process is killed, the remaining files are listed.
    folder.remove_files(layers)
    folder.remove_files(described)
    folder.remove_files(lists)
    folder.remove(DATASET)


def _is_written(folder: Folder) -> bool:
    """Return whether another writer of a local dataset is alive; False for a store, which does not say."""
    return folder.local is not None and is_written(folder.local, SCRATCH)


# -- the gate --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Planned:
    """The frames that a job makes, of which the present process may make a part.

    Attributes:
        frames: returns those of the worlds that the manifest has, without files.
        worlds: the names of all of the job's worlds.
        is_part: whether other processes make other parts of the same frames.
    """

    frames: Callable[[], Sequence[Frame]]
    worlds: Collection[str] = ("",)
    is_part: bool = False


def begin(
    folder: Folder,
    wanted: Manifest,
    resume: bool,
    keys: Collection[str] = (),
    planned: Planned | None = None,
) -> tuple[Manifest, Mapping[str, Frame]]:
    """Write the manifest of a new dataset, and what is planned, or extend those of one that is continued.

    Everything that writes a dataset calls this first, under :func:`lock`. An existing dataset is continued if
    it agrees with ``wanted`` in every field of the record, and with ``planned`` in every frame. A dataset of
    another job that has no frames, and that nobody is writing, is begun anew.

    Args:
        folder: of the dataset.
        wanted: its manifest, as far as it is known.
        resume: whether an existing dataset is continued.
        keys: of the frames that this process writes, as far as they are known. A part looks only for frames
            of these keys, and does not list the whole folder.
        planned: the frames of the job; None for a writer that does not know them.

    Returns:
        The manifest, and the existing frames by key.

    Raises:
        ExistingDatasetError: a dataset exists and ``resume`` is not set.
        OtherDatasetError: the first difference between it and what is wanted.
        ArgumentError: the folder holds images of ``render``, or files of others that are in the way.
        DatasetError: its manifest is damaged.
        UnmatchedNamesError: no rule of the classes matches some names.
    """
    current = find_own(folder)
    if current is not None and not resume:
        raise ExistingDatasetError(f"{folder}: expected a new folder, got a dataset")
    is_part = planned is not None and planned.is_part
    there = Belongings(folder, current or wanted, keys if is_part else None)
    if current is not None and (difference := _difference(folder, current, wanted, planned, there)):
        _remove_other_dataset(folder, current, difference)
        current = None
        there = Belongings(folder, wanted)
    _check_free(folder, current, wanted, there, keys)
    worlds_before: set[str] = set()
    if current is None:
        whole = wanted
        if not write(folder, whole, first=True):
            return begin(folder, wanted, resume, keys, planned)  # another process was faster, in a store
    else:
        worlds_before = worlds_of(current)
        whole = _extended(current, wanted)
        if current.to_dict() != whole.to_dict():
            write(folder, whole)
    if planned is not None:
        _plan(folder, whole, wanted, planned, there, worlds_before)
    return whole, there.frames


def _remove_other_dataset(folder: Folder, current: Manifest, difference: str) -> None:
    """Remove a dataset of another job that has no frames.

    Args:
        folder: of the dataset.
        current: its manifest.
        difference: what is different in the present job, the end of a sentence that begins with "its".

    Raises:
        OtherDatasetError: it has frames, or is in a store, or another process is writing it.
    """
    belongings = Belongings(folder, current)
    if belongings.frames or folder.local is None or _is_written(folder):
        expected = "expected a job with the settings of the dataset"
        raise OtherDatasetError(f"{folder}: {expected}; its {difference}")
    roll_back(folder)
    _remove(folder, belongings)


def _check_free(
    folder: Folder, current: Manifest | None, wanted: Manifest, there: Belongings, keys: Collection[str]
) -> None:
    """Raise ArgumentError for files of others that are in the way."""
    if current is None and folder.exists(OBJECTS):
        raise ArgumentError(f"{folder}: expected a new folder, got images of 'render'; write elsewhere")
    if DATASET.removesuffix(".json") in keys:
        raise ArgumentError(f"key: expected another than that of {DATASET}, got a frame of this name")
    exports = [Export(**export) for export in wanted.settings.get("exports", ())]
    exported.check_free(folder, current, exports)
    strange = there.strange(keys)
    if strange:  # a killed writer may have left them
        roll_back(folder)
        strange = Belongings(folder, current or wanted, keys).strange(keys)
    if current is None:
        strange += filter(is_listing, folder.names())
    if strange:
        raise in_the_way(folder, strange, "this dataset")


def _extended(current: Manifest, wanted: Manifest) -> Manifest:
    """Return the manifest of a dataset that is continued, with what is new; exports may be others."""
    new: dict[str, Any] = {}
    if "exports" in wanted.settings:
        new["exports"] = plain(wanted.settings["exports"])
    watch = wanted.settings.get("options", {}).get("watch")
    if current.origin is None and watch is not None:  # version 0.2 did not write it
        new["options"] = {**current.settings["options"], "watch": watch}
    before = current.origin or Origin(runs=(current.versions,))
    return replace(
        current,
        names=with_names(current.names, wanted.names.keys() - current.names),
        cameras={**current.cameras, **wanted.cameras},
        settings={**current.settings, **new},
        origin=before.joined(wanted.origin or Origin()),
    )


def _plan(
    folder: Folder,
    whole: Manifest,
    wanted: Manifest,
    planned: Planned,
    there: Belongings,
    before: Collection[str],
) -> None:
    """Write the planned frames, unless all of them are in the list of a complete dataset.

    Args:
        folder: of the dataset.
        whole: its manifest.
        wanted: the manifest of the worlds whose frames are planned now.
        planned: these frames.
        there: the frames that the dataset has; for a part, those of the part.
        before: the names of the worlds that the dataset had before.
    """
    worlds = worlds_of(wanted)
    if planned.is_part and worlds <= set(before) and (folder.exists(PLANNED) or folder.exists(FRAMES)):
        return
    frames = {frame.key: frame for frame in planned.frames()}
    if folder.exists(FRAMES) and frames.keys() <= there.frames.keys():
        return
    others = []
    for frame in read_planned(folder, whole):
        if frame.world not in worlds:
            others.append(frame)
    write_planned(folder, [*others, *frames.values()])


def worlds_of(whole: Manifest) -> set[str]:
    """Return the names of the worlds that a manifest describes."""
    return set() if whole.origin is None else set(whole.origin.worlds)


def _difference(
    folder: Folder, current: Manifest, wanted: Manifest, planned: Planned | None, there: Belongings
) -> str:
    """Return the first thing in which a dataset differs from what is wanted, with both values.

    It is the end of a sentence that begins with "its"; empty if nothing differs.
    """
    for name, camera in wanted.cameras.items():
        if current.cameras.get(name, camera) != camera:
            return f"camera {name!r} is {current.cameras[name]!r}, in the job {camera!r}"
    if current.rules != wanted.rules and (wanted.rules is not None or planned is not None):
        return _difference_of_rules(current.rules, wanted.rules)
    if wanted.settings and (line := _difference_of_settings(current, wanted)):
        return line
    if line := _difference_of_worlds(current, wanted, planned):
        return line
    if planned is None:
        return ""
    return _difference_of_frames(folder, current, wanted, planned, there)


def _difference_of_rules(current: ClassRules | None, wanted: ClassRules | None) -> str:
    """As :func:`_difference`, of classes that are not equal."""
    if current is None:
        return "frames have no classes, in the job classes"
    if wanted is None:
        return "frames have classes, in the job none"
    rules = differences(plain(current.to_dict()), plain(wanted.to_dict()), "classes.")
    return next(rules, "classes are other classes than those of the job")


def _difference_of_settings(current: Manifest, wanted: Manifest) -> str:
    """As :func:`_difference`, of the settings but for exports, which may be others."""
    before: dict[str, Any] = {}
    settings: dict[str, Any] = {}
    for key, value in wanted.settings.items():
        if key != "exports":
            before[key] = current.settings.get(key)
            settings[key] = plain(value)
    if current.origin is None:  # version 0.2 did not write whether it watched
        settings["options"] = {**settings["options"], "watch": None}
    return next(differences(before, settings), "")


def _difference_of_worlds(current: Manifest, wanted: Manifest, planned: Planned | None) -> str:
    """As :func:`_difference`, of what is captured, and of the versions of parts."""
    if planned is not None and planned.is_part and current.versions != wanted.versions:
        for package, version in current.versions.items():
            own = wanted.versions.get(package)
            if version != own:
                return f"parts are made with {package} {version}, this one with {own}: use one version"
    if current.origin is None or wanted.origin is None:
        return ""
    for name, world in wanted.origin.worlds.items():
        before = current.origin.worlds.get(name)
        if before is not None and (line := world_difference(before, world)):
            return f"worlds.{name}.{line}" if name else line
    if planned is not None and (missing := sorted(current.origin.worlds.keys() - set(planned.worlds))):
        return f"frames are of the world {missing[0]!r}, in the job there is none of this name"
    return ""


def _difference_of_frames(
    folder: Folder, current: Manifest, wanted: Manifest, planned: Planned, there: Belongings
) -> str:
    """As :func:`_difference`, of frames that exist, and of those that other processes may be making."""
    worlds = (wanted.origin or Origin()).worlds
    if planned.is_part and _has_same_poses(current, worlds):
        return ""  # the whole plan is the same: it need not be made for each part
    lines = {frame.key: frame.to_dict() for frame in planned.frames()}
    keys = set()
    for key, frame in _present_frames(folder, current, planned, there):
        if frame.world in worlds:
            keys.add(key)
        elif frame.world in planned.worlds:
            continue
        if key not in lines:
            return f"frame {key} is none of the {len(lines)} of the job"
        if difference := _difference_of_frame(current, frame, lines[key]):
            return difference
    if planned.is_part and folder.exists(PLANNED) and keys and lines.keys() != keys:
        return f"frames are {len(keys)}, of the job {len(lines)}: parts of one job have the same"
    return ""


def _present_frames(
    folder: Folder, current: Manifest, planned: Planned, there: Belongings
) -> list[tuple[str, Frame]]:
    """Return the frames that exist, and those that other processes may be making, by their keys, in order."""
    if planned.is_part:
        there = Belongings(folder, current)  # all frames, not those of the part alone
    frames = dict(there.frames)
    if planned.is_part or folder.local is None or _is_written(folder):
        for frame in read_planned(folder, current):
            frames.setdefault(frame.key, frame)
    return sorted(frames.items())


def _difference_of_frame(current: Manifest, frame: Frame, line: Mapping[str, Any]) -> str:
    """As :func:`_difference`, of a frame that exists, and its line in the plan of the job."""
    if difference := frame_difference(frame.to_dict(), line):
        return f"frame {frame.key} has {difference}"
    if frame.made_of not in ("", current.made_of(frame.world)):
        return f"frame {frame.key} is one of another job or source, which was copied into it"
    return ""


def _has_same_poses(current: Manifest, worlds: Mapping[str, World]) -> bool:
    """Return whether a dataset has as many poses of each world, with the same digest."""
    origin = current.origin or Origin()
    for name, world in worlds.items():
        if origin.worlds.get(name, {}).get("poses") != world.get("poses"):
            return False
    return True


# -- the end ---------------------------------------------------------------------------------------------


def tidy(folder: Folder) -> None:
    """Remove what killed writers have left in a local folder, under :func:`lock`.

    Only names that writers of datasets use are removed; the scratch folders of live writers stay.
    """
    if folder.local is not None:
        remove_scratch(folder.local, SCRATCH)
        for name in (DATASET, FRAMES, PLANNED, FAILED):
            remove_parts(folder.local / name)
