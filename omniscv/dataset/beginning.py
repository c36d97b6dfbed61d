"""The folder of a dataset that is written: how it is locked, begun, resumed, replaced and tidied."""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

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
from omniscv.dataset.origin import Origin, differences, frame_difference, plain, world_difference
from omniscv.errors import ArgumentError, DatasetError
from omniscv.frame import Frame
from omniscv.storage import Folder, in_the_way
from omniscv.storage.local import is_written, locked, remove_parts, remove_scratch


def lock(folder: Folder) -> AbstractContextManager[None]:
    """Hold the lock of a local folder.

    Object stores are not locked. Files are written atomically, and every writer produces the same bytes.
    """
    return nullcontext() if folder.local is None else locked(folder.local)


def refuse_existing(folder: Folder) -> None:
    """Refuse a folder that holds a dataset with frames."""
    whole = find_own(folder)
    if whole is not None and Belongings(folder, whole).frames:
        content = "a dataset; --resume completes it, --overwrite replaces it, or"
        raise ArgumentError(f"{folder}: expected a new folder, got {content} write elsewhere")


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
    files = belongings.files()
    lists = [name for name in files if is_listing(name)]
    described = [name for name in files if name.endswith(".json") and name not in lists]
    # What lists others goes after them: a process that is killed leaves nothing that nobody knows.
    folder.remove_files([name for name in files if name not in {*lists, *described}])
    folder.remove_files(described)
    folder.remove_files(lists)
    folder.remove(DATASET)


def _is_written(folder: Folder) -> bool:
    """Return whether another writer of a local dataset is alive; of a store nobody knows."""
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
    """Pass the gate of all that write a dataset, under :func:`lock`: write the manifest of a new dataset, and
    what is planned, or extend those of one that is continued.

    What is there must be of what is wanted: field by field of the record, and frame by frame. A dataset of
    another job that has no frames, and that nobody is writing, is begun anew.

    Args:
        folder: of the dataset.
        wanted: its manifest, as far as it is known.
        resume: whether a dataset that is there is continued.
        keys: of the frames that this process writes, as far as they are known; only frames of these are
            looked for by a part, which does not list the whole folder.
        planned: the frames of the job; None for a writer that does not know them.

    Returns:
        The manifest, and by key the frames that are there.

    Raises:
        ArgumentError: a dataset exists and ``resume`` is not set, or the first difference between it and
            what is wanted; or the folder holds images of ``render``, or files of others that are in the way.
        DatasetError: its manifest is damaged.
        UnmatchedNamesError: no rule of the classes matches some names.
    """
    current = find_own(folder)
    if current is not None and not resume:
        content = "a dataset; --resume completes it, --overwrite replaces it, or"
        raise ArgumentError(f"{folder}: expected a new folder, got {content} write elsewhere")
    is_part = planned is not None and planned.is_part
    there = Belongings(folder, current or wanted, keys if is_part else None)
    if current is not None and (difference := _difference(folder, current, wanted, planned, there)):
        whole_folder = Belongings(folder, current)
        if whole_folder.frames or folder.local is None or _is_written(folder):
            expected = "expected a job with the settings of the dataset"
            advice = "--overwrite replaces the dataset, or write elsewhere"
            raise ArgumentError(f"{folder}: {expected}; its {difference}; {advice}")
        roll_back(folder)
        _remove(folder, whole_folder)
        current = None
        there = Belongings(folder, wanted)
    _check_free(folder, current, wanted, there, keys)
    if current is None and not write(folder, wanted, first=True):
        return begin(folder, wanted, resume, keys, planned)  # another process was faster, in a store
    whole = wanted if current is None else _extended(current, wanted)
    if current is not None and current.to_dict() != whole.to_dict():
        write(folder, whole)
    if planned is not None:
        _plan(folder, whole, wanted, planned, there, set() if current is None else worlds_of(current))
    return whole, there.frames


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
        strange += [name for name in folder.names() if is_listing(name)]
    if strange:
        raise in_the_way(folder, strange, "this dataset")


def _extended(current: Manifest, wanted: Manifest) -> Manifest:
    """Return the manifest of a dataset that is continued, with what is new; exports may be others."""
    new = {key: plain(wanted.settings[key]) for key in ("exports",) if key in wanted.settings}
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
        folder, whole: the dataset and its manifest.
        wanted: the manifest of the worlds whose frames are planned now.
        planned: these frames.
        there: the frames that the dataset has, for a part those that are its own.
        before: the names of the worlds that the dataset had before.
    """
    worlds = worlds_of(wanted)
    if planned.is_part and worlds <= set(before) and (folder.exists(PLANNED) or folder.exists(FRAMES)):
        return
    frames = {frame.key: frame for frame in planned.frames()}
    if folder.exists(FRAMES) and frames.keys() <= there.frames.keys():
        return
    others = [frame for frame in read_planned(folder, whole) if frame.world not in worlds]
    write_planned(folder, [*others, *frames.values()])


def worlds_of(whole: Manifest) -> set[str]:
    """Return the names of the worlds that a manifest describes."""
    return set() if whole.origin is None else set(whole.origin.worlds)


def _difference(
    folder: Folder, current: Manifest, wanted: Manifest, planned: Planned | None, there: Belongings
) -> str:
    """Return the first thing in which a dataset differs from what is wanted, with both values, as the end of
    a sentence that begins with "its"; empty for none."""
    for name, camera in wanted.cameras.items():
        if current.cameras.get(name, camera) != camera:
            return f"camera {name!r} is {current.cameras[name]!r}, in the job {camera!r}"
    if current.rules != wanted.rules and (wanted.rules is not None or planned is not None):
        if wanted.rules is None or current.rules is None:
            has, lacks = ("no classes", "classes") if current.rules is None else ("classes", "none")
            return f"frames have {has}, in the job {lacks}"
        rules = differences(plain(current.rules.to_dict()), plain(wanted.rules.to_dict()), "classes.")
        return next(rules, "classes are other classes than those of the job")
    if wanted.settings:
        settings = {key: plain(value) for key, value in wanted.settings.items() if key != "exports"}
        known = {key: current.settings.get(key) for key in settings}
        if current.origin is None:  # version 0.2 did not write whether it watched
            settings = {**settings, "options": {**settings["options"], "watch": None}}
        if line := next(differences(known, settings), ""):
            return line
    return _difference_of_worlds(current, wanted, planned) or (
        _difference_of_frames(folder, current, wanted, planned, there) if planned is not None else ""
    )


def _difference_of_worlds(current: Manifest, wanted: Manifest, planned: Planned | None) -> str:
    """As :func:`_difference`, of what is captured, and of the versions of parts."""
    if planned is not None and planned.is_part and current.versions != wanted.versions:
        for package, version in current.versions.items():
            if version != (mine := wanted.versions.get(package)):
                return f"parts are made with {package} {version}, this one with {mine}: use one version"
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
    """As :func:`_difference`, of frames that are there, and of those that others may be making."""
    origin = current.origin or Origin()
    mine = (wanted.origin or Origin()).worlds
    digests = [origin.worlds.get(name, {}).get("poses") == world.get("poses") for name, world in mine.items()]
    if planned.is_part and all(digests):  # the whole plan is the same: it need not be made for each part
        return ""
    frames = {frame.key: frame.to_dict() for frame in planned.frames()}
    if planned.is_part:
        there = Belongings(folder, current)  # all frames, not those of the part alone
    known = list(there.frames.values())
    if planned.is_part or folder.local is None or _is_written(folder):
        known += [frame for frame in read_planned(folder, current) if frame.key not in there.frames]
    for frame in sorted(known, key=lambda frame: frame.key):
        if frame.world in mine or frame.world not in planned.worlds:
            line = frames.get(frame.key)
            if line is None:
                return f"frame {frame.key} is none of the {len(frames)} of the job"
            if difference := frame_difference(frame.to_dict(), line):
                return f"frame {frame.key} has {difference}"
            if frame.made_of not in ("", current.made_of(frame.world)):
                return f"frame {frame.key} is one of another job or source, which was copied into it"
    keys = {frame.key for frame in known if frame.world in mine}
    if planned.is_part and folder.exists(PLANNED) and keys and frames.keys() != keys:
        return f"frames are {len(keys)}, of the job {len(frames)}: parts of one job have the same"
    return ""


# -- the end ---------------------------------------------------------------------------------------------


def tidy(folder: Folder) -> None:
    """Remove what killed writers have left in a local folder, under :func:`lock`.

    Only names that writers of datasets use are removed; the scratch folders of live writers stay.
    """
    if folder.local is not None:
        remove_scratch(folder.local, SCRATCH)
        for name in (DATASET, FRAMES, PLANNED, FAILED):
            remove_parts(folder.local / name)
