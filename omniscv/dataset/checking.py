"""Check a dataset, one line for each fault; count what it holds."""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities, storage
from omniscv.arguments import shown
from omniscv.dataset import manifest, registry
from omniscv.dataset.exporting import EXPORTS, Export, with_stand_in
from omniscv.dataset.manifest import Manifest
from omniscv.errors import ArgumentError, DatasetError, MissingFileError, OmniscvError
from omniscv.frame import Frame, FrameFiles
from omniscv.parallel import side_by_side
from omniscv.storage import Folder

T = TypeVar("T")
R = TypeVar("R")

_FETCHES = 16  # at a time
_UNIT = 1e-3  # how far the length of a normal may be off 1, or off 0


def check(out: str | Path | Folder, deep: bool = False, format: str | None = None) -> list[str]:
    """Return what is wrong with a dataset, a line for each fault.

    Args:
        out: the dataset, by path or URL. Files of a URL are fetched for the check, and not
            kept, but for those of which an export is made again.
        deep: whether layers and records are read, and compared with each other and with the manifest.
        format: an export to check too; with ``deep``, all that the manifest lists are.

    Raises:
        ArgumentError: no dataset exists there, or no such format.
    """
    folder = storage.folder(out)
    try:
        whole = manifest.read(folder)
        frames = manifest.read_frames(folder, whole)
    except DatasetError as damaged:
        return [str(damaged)]
    faults = [*_manifest_faults(folder, whole), *_list_faults(folder, frames)]
    for of_frame in _for_each(folder, lambda frame: _frame_faults(folder, whole, frame, deep), frames):
        faults += of_frame
    wanted = [Export.from_dict(each) for each in whole.settings["exports"]]
    if format is not None:
        name = registry.get(format).name
        wanted = [each for each in wanted if each.format == name] or [Export(name)]
    if not faults:  # of damaged frames, every export would have faults
        for each in wanted:
            faults += _export_faults(folder, frames, each, deep or format is not None)
    return faults


def _manifest_faults(folder: Folder, whole: Manifest) -> Iterator[str]:
    content = json.loads(folder.read(manifest.DATASET))
    if len(set(whole.names.values())) != len(whole.names):
        yield f"{manifest.DATASET}: names: expected another id for each"
    try:
        expected = whole.to_dict()
    except OmniscvError as fault:
        yield f"{manifest.DATASET}: {fault}"
        return
    for key, value in expected.items():
        if content.get(key) != value:
            got = shown(content.get(key))
            yield f"{manifest.DATASET}: {key}: expected what its rules and names give, got {got}"


def _list_faults(folder: Folder, frames: list[Frame]) -> Iterator[str]:
    """Yield faults of ``frames.jsonl`` as a whole."""
    keys = [frame.key for frame in frames]
    if keys != sorted(set(keys)):
        yield f"{manifest.FRAMES}: expected every key once, in their order"
    split_of: dict[str, str] = {}
    for frame in frames:
        if frame.place and split_of.setdefault(frame.place, frame.split) != frame.split:
            wanted = split_of[frame.place]
            yield f"{frame.key}: expected the split {wanted!r} of its place, got {frame.split!r}"
    known = set(keys)
    for name in folder.names():
        stem, dot, suffix = name.partition(".")
        if dot + suffix == ".json" and "/" not in name and stem not in known and name != manifest.DATASET:
            yield f"{name}: expected a frame that {manifest.FRAMES} lists; make it with --resume"


def _frame_faults(folder: Folder, whole: Manifest, frame: Frame, deep: bool) -> list[str]:
    with _local(folder, [entry.path for entry in frame.entries.values()]) as path:
        files = FrameFiles(storage.folder(path), frame.entries)
        faults = [f"{file.path}: {fault}" for file in frame.entries.values() if (fault := file.fault(path))]
        faults = faults or [*_entry_faults(files.folder, whole, frame)]
        if deep and not faults:
            local = replace(frame, files=files)
            faults = [*_layer_faults(local), *_record_faults(local)]
        return faults


def _entry_faults(folder: Folder, whole: Manifest, frame: Frame) -> Iterator[str]:
    """Yield how a frame's own file differs from its line."""
    name = f"{frame.key}.json"
    try:
        if whole.frame_of_file(name, folder.read(name), folder).to_dict() != frame.to_dict():
            yield f"{name}: expected what {manifest.FRAMES} says of it, got something else"
    except OmniscvError as fault:
        yield str(fault)


def _record_faults(frame: Frame) -> Iterator[str]:
    """Yield faults of the records of truths: no JSON, no numbers, objects that the manifest does not have."""
    instances = set(frame.instances.values())
    for kind, path in frame.files.items():
        if path.suffix != ".json":
            continue
        try:
            record = json.loads(path.read_bytes(), parse_constant=_refused)
        except ValueError as fault:
            yield f"{path.name}: expected records in JSON, got: {fault}"
            continue
        unknown = {number for number in _values(record, "instance_id") if number not in instances}
        if unknown:
            got = shown(sorted(unknown, key=str))
            yield f"{path.name}: {kind}: expected instance ids of {manifest.DATASET}, got {got}"


def _refused(word: str) -> None:
    raise ValueError(f"{word}, which JSON does not have")


def _values(record: Any, key: str) -> Iterator[Any]:
    """Yield every value of a key in nested records."""
    if isinstance(record, dict) and key in record:
        yield record[key]
    for item in record.values() if isinstance(record, dict) else record if isinstance(record, list) else ():
        yield from _values(item, key)


# -- layers -----------------------------------------------------------------------------------------------


def _layer_faults(frame: Frame) -> Iterator[str]:
    """Yield a line for every fault of a frame's layers."""
    layers: dict[str, NDArray[Any]] = {}
    size = (frame.camera.height, frame.camera.width)
    for row in modalities.layers():
        if row.name not in frame.files:
            continue
        try:
            layers[row.name] = frame.layer(row.name)
        except ArgumentError as wrong:
            yield str(wrong)
            continue
        if layers[row.name].shape[:2] != size:
            yield f"{frame.key}: {row.name}: expected {size} pixels, got {layers.pop(row.name).shape[:2]}"
    for name, faults in _CHECKS.items():
        if name in layers:
            for fault in faults(frame, layers):
                yield f"{frame.key}: {name}: {fault}"


def _depth(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    depth, valid = layers["depth"], frame.valid
    yield from _count(np.isnan(depth) | (depth < 0), "metres >= 0, or inf")
    yield from _count(valid & (depth == 0), "more than 0 m inside the field of view")
    yield from _count(~valid & (depth != 0), "0 outside the field of view")


def _labels(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    known = np.zeros(1 << 16, bool)
    known[[0, *frame.instances.values()]] = True
    yield from _count(~known[layers["labels"]], "instance ids of the dataset")
    yield from _count(~frame.valid & (layers["labels"] != 0), "0 outside the field of view")


def _classes(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    if frame.classes is None or "labels" not in layers:
        yield "expected no such layer without labels, and classes in the manifest"
        return
    wanted = frame.classes.ids(frame.instances)[layers["labels"]]
    yield from _count(layers["classes"] != wanted, "the class of the object in labels")


def _normals(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    length = np.linalg.norm(layers["normals"].astype(np.float64), axis=-1)
    yield from _count(~((np.abs(length - 1) <= _UNIT) | (length <= _UNIT)), "unit vectors, or 0")


def _count(wrong: NDArray[np.bool_], wanted: str) -> Iterator[str]:
    if count := int(np.count_nonzero(wrong)):
        yield f"expected {wanted}, got {count} other pixels"


_CHECKS = {"depth": _depth, "labels": _labels, "classes": _classes, "normals": _normals}


# -- exports ----------------------------------------------------------------------------------------------


def _export_faults(folder: Folder, frames: list[Frame], wanted: Export, deep: bool) -> list[str]:
    """Return faults of an export: those that its format finds, else how it differs from a new one."""
    start = f"{EXPORTS}/{wanted.folder}/"
    names = folder.names(start)
    if not names:
        return [f"{EXPORTS}/{wanted.folder}: expected an export to {wanted.format}, it is missing"]
    if not deep:
        return []
    with _local(folder, names) as root:
        return [f"{EXPORTS}/{wanted.folder}: {fault}" for fault in _faults_there(root, frames, wanted)]


def _faults_there(root: Path, frames: list[Frame], wanted: Export) -> list[str]:
    """Return faults of a local export, below a folder that stands for the dataset's."""
    place = root / EXPORTS / wanted.folder
    format = registry.get(wanted.format)
    shown = [frame for frame in frames if wanted.shows(frame.camera_name)]
    if (faults := format.check(shown, place)) is not None:
        return faults
    with tempfile.TemporaryDirectory(dir=place.parent, prefix=".") as again:
        wanted.write_into(with_stand_in(frames, root), Path(again))
        return list(_differences(Path(again), place))


@contextmanager
def _local(folder: Folder, names: Iterable[str]) -> Iterator[Path]:
    """Give a local folder with some files of a dataset: its own, or a temporary one with copies of a
    store's."""
    if folder.local is not None:
        yield folder.local
        return
    with tempfile.TemporaryDirectory(prefix="omniscv-") as place:
        for name in names:
            path = Path(place) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with suppress(MissingFileError):
                folder.copy(name, path)
        yield Path(place)


def _for_each(folder: Folder, check: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """Return the results of a check: on all cores, or by threads that wait for a store."""
    if folder.local is not None:
        return side_by_side(check, items)
    with ThreadPoolExecutor(_FETCHES) as threads:
        return list(threads.map(check, items))


def _differences(wanted: Path, got: Path) -> Iterator[str]:
    """Yield how the files below a folder differ from those below another."""
    files = {path.relative_to(wanted) for path in wanted.rglob("*") if path.is_file()}
    for name in sorted(files | {path.relative_to(got) for path in got.rglob("*") if path.is_file()}):
        if name not in files:
            yield f"{name}: expected no such file"
        elif not (got / name).is_file():
            yield f"{name}: expected a file, it is missing"
        elif (got / name).read_bytes() != (wanted / name).read_bytes():
            yield f"{name}: expected what the frames give, got other bytes"


# -- counts -----------------------------------------------------------------------------------------------


def info(out: str | Path | Folder) -> dict[str, Any]:
    """Return counts of a dataset: frames, cameras, splits, places, objects, classes, bytes by kind of file.

    Raises:
        ArgumentError: no dataset exists there.
        DatasetError: its manifest is damaged.
    """
    folder = storage.folder(out)
    whole = manifest.read(folder)
    there = set(folder.names())
    complete = manifest.FRAMES in there
    frames = manifest.read_frames(folder, whole) if complete else []
    sizes: Counter[str] = Counter()
    missing: Counter[str] = Counter()
    for frame in frames:
        for kind, file in frame.entries.items():
            sizes[kind] += file.bytes
            missing[kind] += file.path not in there
    classes = whole.classes
    objects = Counter() if classes is None else Counter(classes.of_object.values())
    return {
        "complete": complete,
        "frames": len(frames),
        "cameras": dict(Counter(frame.camera_name for frame in frames)),
        "splits": dict(sorted(Counter(frame.split for frame in frames if frame.split).items())),
        "places": len({frame.place for frame in frames if frame.place}),
        "objects": len(whole.names),
        "taxonomy": None if classes is None else classes.taxonomy,
        "classes": {} if classes is None else {name: objects[name] for name in classes.classes},
        "exports": [each["out"] for each in whole.settings["exports"]],
        "bytes": dict(sorted(sizes.items())),
        "missing": {kind: count for kind, count in sorted(missing.items()) if count},
        "versions": dict(whole.versions),
    }
