"""Check a dataset, one line for each fault; count what it holds."""

import filecmp
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities, storage
from omniscv.arguments import shown
from omniscv.dataset import exported, exporting, manifest
from omniscv.dataset.belongings import Belongings
from omniscv.dataset.exported import with_stand_in
from omniscv.dataset.exporting import EXPORTS, Export
from omniscv.dataset.manifest import Manifest
from omniscv.dataset.mixtures import mixed
from omniscv.errors import DatasetError, MissingFileError, OmniscvError
from omniscv.frame import IMAGE, Frame
from omniscv.frame.classes import ClassTable
from omniscv.storage import Folder
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json

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
        faults = [*_manifest_faults(folder, whole), *_list_faults(folder, whole, frames)]
    except DatasetError as damaged:
        return [str(damaged)]
    faults += mixed(whole, frames)
    for of_frame in folder.each(lambda frame: _frame_faults(folder, whole, frame, deep), frames):
        faults += of_frame
    faults += _stale_exports(folder, frames)
    exports = _exports(whole, format)
    if not faults:  # of damaged frames, every export would have faults
        for export in exports:
            faults += _export_faults(folder, frames, export, deep or format is not None)
    return faults


def _exports(whole: Manifest, format: str | None) -> list[Export]:
    """Return the exports that a manifest lists; with a format those of it, or the one with its defaults."""
    exports = [Export(**export) for export in whole.settings["exports"]]
    if format is None:
        return exports
    name = exporting.get(format).name
    matching = [export for export in exports if export.format == name]
    return matching if matching else [Export(name)]


def _manifest_faults(folder: Folder, whole: Manifest) -> Iterator[str]:
    """Yield keys of ``dataset.json`` whose values do not follow from its own rules and names."""
    content = parse_json(folder.read(manifest.DATASET, MOST_JSON_BYTES))
    try:
        expected = replace(whole).to_dict()  # with the classes that its rules give
    except OmniscvError as fault:
        yield f"{manifest.DATASET}: {fault}"
        return
    for key, value in expected.items():
        if content.get(key) != value:
            other = shown(content.get(key))
            yield f"{manifest.DATASET}: {key}: expected what its rules and names give, got {other}"


def _list_faults(folder: Folder, whole: Manifest, frames: list[Frame]) -> Iterator[str]:
    """Yield faults of ``frames.jsonl`` as a whole."""
    split_of: dict[str, str] = {}
    for frame in frames:
        if frame.place and split_of.setdefault(frame.place, frame.split) != frame.split:
            wanted = split_of[frame.place]
            yield f"{frame.key}: expected the split {wanted!r} of its place, got {frame.split!r}"
    known = {frame.key for frame in frames}
    failed = {line["key"] for line in manifest.read_failed(folder)}
    for key in sorted(failed & known):
        yield f"{manifest.FAILED}: expected frames that are not in {manifest.FRAMES}, got {key}"
    advice = manifest.advice_to_complete(whole)
    for key in sorted(Belongings(folder, whole).frames.keys() - known - failed):
        wanted = f"expected a frame that {manifest.FRAMES} lists"
        yield f"{key}.json: {wanted}; {advice}, if the frame is theirs; else remove {key}.*"


def _frame_faults(folder: Folder, whole: Manifest, frame: Frame, deep: bool) -> list[str]:
    """Return a line for each fault of a frame's files.

    Args:
        folder: of the dataset.
        whole: the manifest of all frames.
        frame: its line in ``frames.jsonl``.
        deep: whether layers are decoded and compared, too, if no file is missing or damaged.
    """
    faults: list[str] = []
    sizes = {entry.path: entry.bytes for entry in frame.entries.values()}
    with _faults_in(folder, faults), local_copy(folder, sizes) as path:
        local = frame.with_files(storage.folder(path), frame.entries)
        for kind in local.files:
            with _faults_in(path, faults):
                local.files[kind]  # access compares the file with the manifest
        if not faults:
            with _faults_in(path, faults):
                _check_own_file(whole, local)
        if deep and not faults:
            layers = _read_layers(path, local, faults)
            faults += _layer_faults(local, layers)
    return faults


def _read_layers(path: Path, frame: Frame, faults: list[str]) -> dict[str, NDArray[Any]]:
    """Return the layers of a frame in a local folder, and read its records; append a line for each fault."""
    layers: dict[str, NDArray[Any]] = {}
    names = {modality.name for modality in modalities.layers()}
    for kind in frame.files:
        with _faults_in(path, faults):
            if kind in names:
                layers[kind] = frame.layer(kind)
            elif kind != IMAGE:
                frame.records(kind)
    return layers


@contextmanager
def _faults_in(folder: Path | Folder, faults: list[str]) -> Iterator[None]:
    """Append a DatasetError to a list, without the name of the folder."""
    try:
        yield
    except DatasetError as fault:
        faults.append(fault.message.removeprefix(f"{folder}/"))


def _check_own_file(whole: Manifest, frame: Frame) -> None:
    """Raise DatasetError if a frame's own file is not listed, or differs from its line."""
    name = f"{frame.key}.json"
    if IMAGE in frame.files:
        path = frame.files[IMAGE]
        content = path.read_bytes()  # whose size has been checked
        own = whole.frame_of_file(name, content, storage.folder(path.parent))
        if own.made_of not in ("", whole.made_of(own.world)):
            wanted = f"expected a frame of what {manifest.DATASET} says that the dataset is made of"
            raise DatasetError(f"{name}: {wanted}, got one of another job or source")
        if own.to_dict() == frame.to_dict():
            return
    raise DatasetError(f"{name}: expected what {manifest.FRAMES} says of it, got something else")


# -- layers -----------------------------------------------------------------------------------------------


def _layer_faults(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    """Yield a line for every fault of the pixels of a frame's layers."""
    for name, faults in _CHECKS.items():
        if name in layers:
            for fault in faults(frame, layers):
                yield f"{frame.key}: {name}: {fault}"


def _depth(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    depth = layers["depth"]
    valid = frame.valid
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
    expected = frame.classes.ids(frame.instances)[layers["labels"]]
    yield from _count(layers["classes"] != expected, "the class of the object in labels")


def _normals(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    length = np.linalg.norm(layers["normals"].astype(np.float64), axis=-1)
    yield from _count(~((np.abs(length - 1) <= _UNIT) | (length <= _UNIT)), "unit vectors, or 0")


def _count(wrong: NDArray[np.bool_], expected: str) -> Iterator[str]:
    if count := int(np.count_nonzero(wrong)):
        yield f"expected {expected}, got {count} other pixels"


_CHECKS = {"depth": _depth, "labels": _labels, "classes": _classes, "normals": _normals}


# -- exports ----------------------------------------------------------------------------------------------


def _stale_exports(folder: Folder, frames: list[Frame]) -> Iterator[str]:
    """Yield a line for each export in the dataset's folder that is of other frames than it has now."""
    for out, exports in exported.listed_in(folder).items():
        for listed in exports:
            place = f"{EXPORTS}/{out}"
            if not listed.state:
                yield f"{place}: expected a whole export, got one that was interrupted; export it again"
            elif listed.state != exported.state_of(listed.export, frames):
                yield f"{place}: expected an export of these frames, got one of others; export it again"


def _export_faults(folder: Folder, frames: list[Frame], export: Export, deep: bool) -> list[str]:
    """Return faults of an export: those that its format finds, else how it differs from a new one."""
    start = f"{EXPORTS}/{export.out}/"
    names = folder.names(start)
    if not names:
        return [f"{EXPORTS}/{export.out}: expected an export to {export.format}, it is missing"]
    if not deep:
        return []
    shown = [frame for frame in frames if export.shows(frame.camera_name)]
    with local_copy(folder, dict.fromkeys(names)) as root:
        place = root / EXPORTS / export.out
        try:
            faults = exporting.get(export.format).check(shown, place)
            if faults is None:
                with tempfile.TemporaryDirectory(dir=place.parent, prefix=".") as again:
                    export.write_into(with_stand_in(frames, root), Path(again))
                    faults = list(_differences(Path(again), place))
        except OmniscvError as cause:  # the frames do not give it any more
            faults = [f"expected frames that it can be made of again, got: {cause.message}"]
    return [f"{EXPORTS}/{export.out}: {fault}" for fault in faults]


@contextmanager
def local_copy(folder: Folder, sizes: Mapping[str, int | None]) -> Iterator[Path]:
    """A local folder with files of a dataset: its own, or a temporary one with copies of those in a store.

    Args:
        folder: of the dataset.
        sizes: by name, the bytes that each file may have; None for as many as the store says.
    """
    if folder.local is not None:
        yield folder.local
        return
    with tempfile.TemporaryDirectory(prefix="omniscv-") as place:

        def copy(name: str) -> None:
            path = Path(place) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with suppress(MissingFileError):
                folder.copy(name, path, sizes[name])

        folder.each(copy, list(sizes))
        yield Path(place)


def _differences(expected: Path, folder: Path) -> Iterator[str]:
    """Yield how files below a folder differ from the expected ones."""
    files = _files_below(expected)
    present = _files_below(folder)
    for name in sorted(files | present - {Path(exported.LISTS)}):
        if name not in files:
            yield f"{name}: expected no such file"
        elif not (folder / name).is_file():
            yield f"{name}: expected a file, it is missing"
        elif not filecmp.cmp(folder / name, expected / name, shallow=False):
            yield f"{name}: expected what the frames give, got other bytes"


def _files_below(folder: Path) -> set[Path]:
    """Return the paths of all files below a folder, relative to it."""
    return {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}


# -- counts -----------------------------------------------------------------------------------------------


def info(out: str | Path | Folder) -> dict[str, Any]:
    """Return counts of a dataset: frames, cameras, splits, places, objects, classes, bytes by kind."""
    folder = storage.folder(out)
    whole = manifest.read(folder)
    names = set(folder.names())
    complete = manifest.FRAMES in names
    frames = manifest.read_frames(folder, whole) if complete else []
    cameras = Counter[str]()
    splits = Counter[str]()
    places = set[str]()
    sizes = Counter[str]()  # bytes by kind of file
    missing = Counter[str]()  # files by kind
    for frame in frames:
        cameras[frame.camera_name] += 1
        if frame.split:
            splits[frame.split] += 1
        if frame.place:
            places.add(frame.place)
        for kind, file in frame.entries.items():
            sizes[kind] += file.bytes
            if file.path not in names:
                missing[kind] += 1
    counts: dict[str, Any] = {"complete": complete, "frames": len(frames)}
    if failed := manifest.read_failed(folder):
        counts["failed"] = len(failed)
    if varied := _ranges(frames):
        counts["varied"] = varied
    return {
        **counts,
        "cameras": dict(cameras),
        "splits": dict(sorted(splits.items())),
        "places": len(places),
        "objects": len(whole.names),
        "taxonomy": None if whole.classes is None else whole.classes.taxonomy,
        "classes": {} if whole.classes is None else _objects_by_class(whole.classes),
        "exports": [export["out"] for export in whole.settings["exports"]],
        "bytes": dict(sorted(sizes.items())),
        "missing": dict(sorted(missing.items())),
        "versions": dict(whole.versions),
    }


def _objects_by_class(classes: ClassTable) -> dict[str, int]:
    """Return the number of objects of each class."""
    objects = Counter(classes.of_object.values())
    return {name: objects[name] for name in classes.classes}


def _ranges(frames: list[Frame]) -> dict[str, str]:
    """Return by setting of all objects, lights and materials the least and the greatest value drawn."""
    values: dict[str, list[float]] = {}
    for frame in frames:
        for kind, by_name in frame.varied.items():
            for settings in by_name.values():
                for setting, value in settings.items():
                    if not isinstance(value, str):
                        values.setdefault(f"{kind}.{setting}", []).extend(np.ravel(value).tolist())
    ranges = {}
    for name, drawn in sorted(values.items()):
        ranges[name] = f"{min(drawn):.4g} to {max(drawn):.4g}"
    return ranges
