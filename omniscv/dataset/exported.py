"""Exports in folders: in a dataset's, or in one of the user.

A list beside the files of each export names them, and what they show. By it a later export replaces exactly
the files of the one before it, and a check notices files that are out of date.
"""

import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from omniscv import storage
from omniscv.arguments import text
from omniscv.dataset.exporting import EXPORTS, Export, get
from omniscv.dataset.manifest import DATASET, Manifest, open, read
from omniscv.dataset.origin import digest, plain
from omniscv.errors import ArgumentError, DamagedFileError, MissingFileError, OmniscvError
from omniscv.frame import Frame, FrameFiles
from omniscv.storage import Folder, in_the_way
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json
from omniscv.storage.local import folder_beside, locked, remove_parts

LISTS = ".exported.json"
"""The file in the folder of exports that lists the files of each, by its format."""


@dataclass(frozen=True)
class Listed:
    """An export in a folder, as its list there describes it.

    Attributes:
        export: what was written.
        state: of the frames that it is of, a digest; empty while it is written.
        files: their names.
        of_job: whether the job of the dataset asked for it, not somebody by hand.
    """

    export: Export
    state: str = ""
    files: Sequence[str] = ()
    of_job: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        options = plain(dict(self.export.options))
        cameras = list(self.export.cameras)
        described = {"options": options, "cameras": cameras, "of_job": self.of_job}
        return {**described, "state": self.state, "files": list(self.files)}


def export(
    folder: str | Path, /, to: str, out: str | Path | None = None, cameras: Sequence[str] = (), **options: Any
) -> list[str | Path]:
    """Export a dataset to a format.

    Args:
        folder: the dataset, by path or URL.
        to: a name of :func:`omniscv.dataset.names`.
        out: the folder to write into, by path or URL, beside other files; if not given, ``exports/NAME`` in
            the dataset, which is replaced.
        cameras: names of those whose frames are exported; all if not given.
        options: of the format.

    Returns:
        The files: paths, or URLs.

    Raises:
        ArgumentError: no dataset, no such format, a camera that it cannot carry, an unknown option, or a
            dataset in ``out``.
        DatasetError: the dataset is not complete, or damaged.
    """
    wanted = Export(to, options=options, cameras=cameras)
    source = storage.folder(folder)
    frames = open(source)
    kinds = []
    camera_of = {}
    for frame in frames:
        camera_of[frame.camera_name] = frame.camera
        if wanted.shows(frame.camera_name):
            kinds.append(frame.kinds)
    common = set.intersection(*kinds) if kinds else set(get(to).needs)
    wanted.check(camera_of, common)
    if out is None:
        check_free(source, read(source), [wanted])
        return replace_export(wanted, frames, source)
    target = storage.folder(out)
    if target.exists(DATASET):  # whose files would be taken for frames, or replaced
        raise ArgumentError(f"{target}: expected a folder that holds no dataset; write beside it")
    return _place(wanted, frames, target, within_dataset=False)


def replace_export(
    wanted: Export, frames: Sequence[Frame], out: Folder, of_job: bool = False
) -> list[str | Path]:
    """Write an export into its folder of a dataset, in place of an existing one.

    In a store, files are put one by one, those that list others last; then those of an earlier one are gone.

    Args:
        wanted: the export.
        frames: of the dataset, all of them.
        out: its folder.
        of_job: whether the dataset's job asks for it.

    Raises:
        ArgumentError: files that no export has written have names of the new ones; or as a format.
    """
    return _place(wanted, frames, out.below(f"{EXPORTS}/{wanted.out}"), True, of_job)


def _place(
    wanted: Export, frames: Sequence[Frame], target: Folder, within_dataset: bool, of_job: bool = False
) -> list[str | Path]:
    """Write an export beside a local folder, or for a store into a temporary one, and move it when it is
    complete; return its files, as paths or URLs.

    The files that an earlier export listed are replaced or removed; those of others stay, and are refused
    where they have names of the new ones. Within a dataset, files of frames in a store are named as seen from
    there.
    """
    with ExitStack() as stack:
        if target.local is not None:  # relative paths out of it stay true
            part = stack.enter_context(folder_beside(Path(os.path.abspath(target.local))))
            paths = wanted.write_into(frames, part)
        else:
            root = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="omniscv-")))
            part = root / EXPORTS / wanted.out
            part.mkdir(parents=True)
            paths = wanted.write_into(with_stand_in(frames, root) if within_dataset else frames, part)
        last = [path.relative_to(part).as_posix() for path in paths]  # these list others
        names = _names_below(part)
        if target.local is not None:
            stack.enter_context(_locked(target.local))
        new = Listed(wanted, state_of(wanted, frames), sorted(names), of_job)
        _move(new, part, sorted(names.difference(last)), last, target, within_dataset)
    if target.local is None:
        return [f"{target}/{name}" for name in last]
    return [target.local / name for name in last]


@contextmanager
def _locked(target: Path) -> Iterator[None]:
    target.mkdir(parents=True, exist_ok=True)
    with locked(target):
        yield


def _move(
    new: Listed,
    part: Path,
    others: Sequence[str],
    last: Sequence[str],
    target: Folder,
    within_dataset: bool,
) -> None:
    """Move the files of a new export to their place, and remove the others of the one that it replaces.

    Args:
        new: the export with the names of its files.
        part: the local folder that holds them.
        others: their names, but for those that list others.
        last: the names of these.
        target: their place.
        within_dataset: whether the place is a folder of a dataset, which is that of one export.
    """
    format = new.export.format
    names = set(new.files)
    if target.local is not None:  # which is locked
        remove_parts(target.local / LISTS)
    present = set(target.names())
    lists = read_lists(target)
    if lists is None:
        lists = {}
        if within_dataset:  # of version 0.2, which kept no list: names of the new export are its own
            lists[format] = replace(new, files=[*present & names])
    earlier: set[str] = set()
    kept = {}
    for other, listed in lists.items():
        if within_dataset or other == format:
            earlier.update(listed.files)
        else:
            kept[other] = listed
    if strange := sorted(present & names - earlier):
        raise in_the_way(target, strange, f"the export to {format}")
    # Listed before they are there: whatever kills the process, the next export knows them.
    _write_lists(target, {**kept, format: replace(new, state="", files=sorted(earlier | names))})

    def put(name: str) -> None:
        if target.local is None:
            target.put(name, part / name)
        else:
            (target.local / name).parent.mkdir(parents=True, exist_ok=True)
            (part / name).replace(target.local / name)

    target.each(put, others)
    for name in last:
        put(name)
    target.remove_files(sorted(earlier & present - names))
    _write_lists(target, {**kept, format: new})


# -- lists of files --------------------------------------------------------------------------------------


def state_of(export: Export, frames: Sequence[Frame]) -> str:
    """Return a digest of those of ``frames`` that an ``export`` shows, and of what their ids mean.

    Files are left out: the same frames always have the same.
    """
    lines: list[dict[str, Any]] = []
    names: dict[str, int] = {}
    classes: list[dict[str, Any]] = []
    for frame in frames:
        if not export.shows(frame.camera_name):
            continue
        if not lines:  # all frames share names and classes
            names = dict(frame.instances)
            classes = [] if frame.classes is None else [asdict(frame.classes)]
        lines.append({**frame.to_dict(), "files": {}})
    return digest([lines, names, classes])


def read_lists(target: Folder, out: str = "") -> dict[str, Listed] | None:
    """Return the exports in the folder ``target`` by format; None if no list is there.

    ``out`` is the name of the folder below ``exports/``; that of the format if empty. ArgumentError: the list
    is damaged.
    """
    try:
        content = parse_json(target.read(LISTS, MOST_JSON_BYTES))
        lists = {}
        for format, values in content.items():
            export = Export(format, out, values["options"], tuple(values["cameras"]))
            files = [text("files", name) for name in values["files"]]
            lists[format] = Listed(export, str(values["state"]), files, bool(values["of_job"]))
        return lists
    except MissingFileError:
        return None
    except (ArgumentError, DamagedFileError, AttributeError, KeyError, TypeError) as cause:
        expected = f"expected the list of an export in {LISTS}, got: {cause}"
        raise ArgumentError(f"{target}: {expected}; remove the file, or write elsewhere") from cause


def _write_lists(target: Folder, lists: Mapping[str, Listed]) -> None:
    content = {format: listed.to_dict() for format, listed in lists.items()}
    target.put(LISTS, f"{json.dumps(content, indent=1)}\n".encode())


def listed_in(folder: Folder) -> dict[str, list[Listed]]:
    """Return the exports in a dataset's folder that have lists, by the names of their folders."""
    listed = {}
    for out in _outs(folder):
        lists = read_lists(folder.below(f"{EXPORTS}/{out}"), out)
        if lists:
            listed[out] = list(lists.values())
    return listed


def _outs(folder: Folder) -> list[str]:
    """Return the names of the folders below ``exports/`` that have files, in order."""
    outs = set()
    for path in folder.names(f"{EXPORTS}/"):
        if path.count("/") > 1:
            outs.add(path.split("/")[1])
    return sorted(outs)


def renew_exports(folder: Folder, exports: Sequence[Export], frames: Sequence[Frame]) -> list[str]:
    """Write the exports of a job into its dataset, and bring others there up to date.

    Exports of the job that it does not list any more are removed. Those that somebody has added by hand are
    written again if they are of other frames.

    Args:
        folder: of the dataset.
        exports: that the job lists.
        frames: of the dataset, all of them.

    Returns:
        A line for each export added by hand that could not be written.
    """
    lines = []
    outs = {export.out for export in exports}
    for out, others in listed_in(folder).items():
        if out in outs:
            continue
        for listed in others:
            if listed.of_job:
                remove_exports(folder, [f"{EXPORTS}/{out}/{name}" for name in (LISTS, *listed.files)])
            elif listed.state != state_of(listed.export, frames):
                try:
                    replace_export(listed.export, frames, folder)
                except OmniscvError as cause:
                    lines.append(f"{EXPORTS}/{out} is of earlier frames: {cause.message}")
    for export in exports:  # each replaces the one that exists
        replace_export(export, frames, folder, of_job=True)
    return lines


def check_free(folder: Folder, whole: Manifest | None, exports: Iterable[Export]) -> None:
    """Raise ArgumentError for files in the folder of an export that no export has written.

    Args:
        folder: of the dataset.
        whole: its manifest, as the exports that are there were made with it; None for a new dataset.
        exports: that are to be written into it.
    """
    earlier: set[str] = set()
    if whole is not None:
        earlier.update(export["out"] for export in whole.settings.get("exports", ()))
    for export in exports:
        target = folder.below(f"{EXPORTS}/{export.out}")
        if export.out not in earlier and read_lists(target) is None and (names := target.names()):
            raise in_the_way(target, names, f"the export to {export.format}")


def remove_exports(folder: Folder, files: Sequence[str]) -> None:
    """Remove files of exports.

    Args:
        folder: of the dataset.
        files: their names in it, such as ``exports/coco/annotations.json``.

    A folder that holds other files, too, gets an empty list. By it, the next export knows that they are not
    its own, and they stay.
    """
    folder.remove_files(files)
    for out in {name.split("/")[1] for name in files}:
        target = folder.below(f"{EXPORTS}/{out}")
        if target.names():
            _write_lists(target, {})


def _names_of(export: Export, frames: Sequence[Frame]) -> set[str]:
    """Return the names of the files that an export of frames has; none if they do not give it."""
    try:
        with tempfile.TemporaryDirectory(prefix="omniscv-") as root:
            part = Path(root) / EXPORTS / export.out
            export.write_into(with_stand_in(frames, Path(root)), part)
            return _names_below(part)
    except OmniscvError:
        return set()


def _names_below(folder: Path) -> set[str]:
    """Return the names of all files below a local folder, relative to it."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def files_of_exports(folder: Folder, whole: Manifest, frames: Sequence[Frame]) -> list[str]:
    """Return the files of all exports in the ``folder`` of a dataset, with their lists, as seen from there.

    ``whole`` is its manifest. Exports of version 0.2 have no list: their files are known by making them again
    of ``frames``.
    """
    earlier = {}
    for export in whole.settings.get("exports", ()):
        earlier[export["out"]] = Export(**export)
    files = []
    for out in _outs(folder):
        target = folder.below(f"{EXPORTS}/{out}")
        lists = read_lists(target)
        if lists is not None:
            names = {LISTS}
            for listed in lists.values():
                names.update(listed.files)
        elif out in earlier:  # version 0.2 kept no list
            names = _names_of(earlier[out], frames).intersection(target.names())
        else:
            continue
        files += [f"{EXPORTS}/{out}/{name}" for name in sorted(names)]
    return files


def with_stand_in(frames: Sequence[Frame], root: Path) -> list[Frame]:
    """Return ``frames`` whose files have the local folder ``root`` as stand-in for that of a store."""
    changed = []
    for frame in frames:
        files = frame.files
        if isinstance(files, FrameFiles):
            files = replace(files, stand_in=root)
        changed.append(replace(frame, files=files))
    return changed
