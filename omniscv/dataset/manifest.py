"""The manifest of a dataset: ``dataset.json``, what all frames share, and ``frames.jsonl``, a line for each.

``dataset.json`` is there before the first frame, so that object names and their ids are frozen; it grows when
an object or camera comes that it does not have. ``STEM.json`` is the last file of a frame: a frame is whole
when it is there. ``frames.jsonl`` is written last of all, in the order of keys. No file holds a time of a
clock, an address, or a path outside the dataset: the same frames make the same bytes.
"""

import hashlib
import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from omniscv import modalities, storage
from omniscv.arguments import one_of, shown, stem, texts, whole_number
from omniscv.cameras import Camera, from_dict
from omniscv.cameras.rolling_shutter import with_path
from omniscv.compose.files import versions
from omniscv.dataset.origin import Origin, digest, plain, without_defaults
from omniscv.errors import ArgumentError, DamagedFileError, DatasetError, MissingFileError, StorageError
from omniscv.frame import IMAGE, FileEntry, Frame, FrameFiles, file_endings
from omniscv.frame.classes import ClassRules, ClassTable, class_rules
from omniscv.frame.files import read_entries
from omniscv.geometry import Pose
from omniscv.records import mapping
from omniscv.sensor.imu import ImuTrack
from omniscv.storage import Folder
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json
from omniscv.truth import registry as truths

DATASET = "dataset.json"
FRAMES = "frames.jsonl"
FAILED = "failed.jsonl"
"""The frames that failed and were left out: key, world, what was drawn, and the error, a line each."""
PLANNED = "planned.jsonl"
"""The frames that a job makes, without files, a line each; there until the dataset is complete."""
FORMAT = 2
_MOST_NS = 1 << 62
CONVENTIONS = {
    "units": "metre",
    "world": "right-handed: X forward, Y left, Z up",
    "camera": "x right, y down, z forward",
    "pose": "camera to world",
    "pixels": "edge",
    "depth": "ray metres",
    "labels": "instance id of names; 0 nothing known",
}
"""``pixels: edge``: (0, 0) is the image's corner, pixel centres are at +0.5."""

MOST_IDS = (1 << 16) - 1
"""Instance ids: labels have 16 bits."""

_MOST_FRAMES_BYTES = 1 << 30
"""Of ``frames.jsonl``: more than half a million frames."""


@dataclass(frozen=True)
class Manifest:
    """What ``dataset.json`` holds.

    Attributes:
        cameras: by name.
        names: object name to the instance id that labels hold.
        rules: of its classes; None without classes.
        settings: how it was made: ``splits``, ``exports``, ``options``, as plain values.
        versions: of the packages that began it.
        origin: what its frames are made of; None of a dataset of version 0.2.
    """

    cameras: Mapping[str, Camera] = field(default_factory=dict)
    names: Mapping[str, int] = field(default_factory=dict)
    rules: ClassRules | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=versions)
    origin: Origin | None = field(default_factory=Origin)

    def made_of(self, world: str) -> str:
        """Return a digest of all that a world's frames depend on beside their lines; empty if it is not
        known. Each frame has it in its own file."""
        if self.origin is None:
            return ""
        described = dict(self.origin.worlds.get(world, {}))
        described.pop("poses", None)
        settings = {}
        for key, value in self.settings.items():
            if key != "exports":
                settings[key] = plain(value)
        rules = None if self.rules is None else self.rules.to_dict()
        return digest([without_defaults(settings), without_defaults(plain(described)), rules])

    @cached_property
    def classes(self) -> ClassTable | None:
        """The classes of the objects; None without classes.

        Raises:
            UnmatchedNamesError: no rule matches some names.
        """
        return None if self.rules is None else self.rules.table(self.names)

    @cached_property
    def imu(self) -> ImuTrack | None:
        """What the rig carries, and its trajectory; None without."""
        track = self.settings.get("options", {}).get("imu")
        return None if track is None else ImuTrack.from_dict(track)

    @cached_property
    def _endings(self) -> Mapping[str, Collection[str]]:
        return file_endings(truths.kinds())

    def frame(self, line: Any, folder: Folder) -> Frame:
        """Return the frame of a line of ``frames.jsonl``.

        Args:
            line: plain values.
            folder: of the dataset, which the names of its files are relative to.

        Raises:
            ArgumentError: the line is anything else.
        """
        try:
            key = stem("key", line["key"])
            camera_name = stem("camera", line["camera"])
            if camera_name not in self.cameras:
                known = ", ".join(self.cameras)
                raise ArgumentError(f"{key}: expected one of the cameras {known}; got {camera_name!r}")
            camera = with_path(self.cameras[camera_name], line.get("path"))
            size = camera.width, camera.height
            marks = [modality.name for modality in modalities.layers() if modality.mark]
            blank = tuple(one_of("blank", name, marks) for name in line.get("blank", ()))
            time_ns = line["time_ns"]
            if time_ns is not None:
                time_ns = whole_number("time_ns", time_ns, least=-_MOST_NS, most=_MOST_NS)
            return Frame(
                key=key,
                camera_name=camera_name,
                camera=camera,
                pose=Pose.from_dict(line["pose"]),
                files=FrameFiles(read_entries(key, size, line["files"], self._endings), size, folder),
                blank=blank,
                instances=self.names,
                classes=self.classes,
                imu=self.imu,
                time_ns=time_ns,
                place=any_text("place", line["place"]),
                split=line["split"] and stem("split", line["split"]),
                scene=any_text("scene", line["scene"]),
                state=any_text("state", line.get("state", "")),
                world=any_text("world", line.get("world", "")),
                shows=any_text("shows", line.get("shows", "")),
                varied=mapping("varied", line.get("varied", {})),
                watch=texts("watch", line["watch"]) if "watch" in line else (),
            )
        except (TypeError, KeyError, AttributeError) as cause:
            wanted = "expected a frame with key, camera, pose, time_ns, place, split, scene and files"
            raise ArgumentError(f"{wanted}; got {type(cause).__name__}: {shown(str(cause))}") from cause

    def frame_of_file(self, name: str, content: bytes, folder: Folder) -> Frame:
        """Return the frame that a ``STEM.json`` describes, that file among its files.

        Args:
            name: of the file.
            content: its bytes.
            folder: of the dataset.

        Raises:
            DatasetError: the file is damaged, or describes a frame of another name.
        """
        with _damage(name):
            described = parse_json(content)
            frame = self.frame(described["frame"], folder)
            frame = replace(frame, made_of=any_text("made_of", described.get("made_of", "")))
            if name != f"{frame.key}.json":
                raise ArgumentError(f"expected the frame of its name, got {shown(frame.key)}")
            image = FileEntry(name, len(content), hashlib.sha256(content).hexdigest())
            return frame.with_files(folder, {**frame.entries, IMAGE: image})

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        table = self.classes
        classes = None
        if self.rules is not None and table is not None:
            classes = self.rules.to_dict()
            classes["classes"] = list(map(asdict, table.classes.values()))
            classes["of_object"] = _select(table.of_object, self.names)
        content = {
            "format": FORMAT,
            "omniscv": self.versions["omniscv"],
            "versions": dict(self.versions),
            "conventions": CONVENTIONS,
            "cameras": {name: camera.to_dict() for name, camera in self.cameras.items()},
            "names": dict(self.names),
            "classes": classes,
            "splits": self.settings.get("splits"),
            "exports": self.settings.get("exports", []),
            "options": self.settings.get("options", {}),
        }
        if self.origin is not None:
            content["origin"] = self.origin.to_dict()
        return content

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """The inverse of :meth:`to_dict`; ArgumentError for anything else."""
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            other = data.get("format") if isinstance(data, dict) else data
            raise ArgumentError(f"expected a dataset of format {FORMAT}, got {shown(other)}")
        try:
            cameras = read_cameras(data["cameras"])
            names = read_names(data["names"])
            rules = None
            table = None
            if data["classes"] is not None:
                table, rules = _read_classes(data["classes"], names)
            exports = list(map(_read_export, data["exports"]))
            settings = {"splits": data["splits"], "exports": exports, "options": data["options"]}
            versions = {"omniscv": data["omniscv"], **data["versions"]}
            origin = Origin.from_dict(data["origin"]) if "origin" in data else None
            manifest = cls(cameras, names, rules, settings, versions, origin)
            manifest.imu  # noqa: B018 - refuses another track
            vars(manifest)["classes"] = table  # not matched again: foreign patterns may take for ever
            return manifest
        except (TypeError, KeyError, AttributeError) as cause:
            wanted = "expected cameras, names, classes, splits, exports, options"
            raise ArgumentError(f"{wanted}; got {type(cause).__name__}: {shown(str(cause))}") from cause


def _read_classes(classes: Any, names: Iterable[str]) -> tuple[ClassTable, ClassRules]:
    """Return the classes that a manifest describes for its objects, and their rules.

    ArgumentError: an object is of a class that the rules do not have.
    """
    stored = dict(classes.items())
    stored.pop("classes", None)
    stored.pop("of_object", None)
    rules = class_rules(stored)
    of_object = _select(classes["of_object"], names)
    for name, class_name in of_object.items():
        one_of(f"classes.of_object.{shown(name)}", class_name, rules.classes)
    return ClassTable(rules.classes, of_object, rules.taxonomy), rules


def _select(values: Any, names: Iterable[str]) -> dict[str, Any]:
    """Return the values of some names, in their order; names without a value are left out."""
    return {name: values[name] for name in names if name in values}


def _read_export(export: Any) -> dict[str, Any]:
    return {key: export[key] for key in ("format", "out", "options", "cameras")}


def read_cameras(cameras: Any) -> dict[str, Camera]:
    """Return the cameras that a manifest describes, by name."""
    by_name = {}
    for name, description in cameras.items():
        by_name[stem("camera", name)] = from_dict(description)
    return by_name


def read_names(names: Any) -> dict[str, int]:
    """Return the instance ids of a manifest, each another one, by the names of objects."""
    ids = {}
    for name, number in names.items():
        ids[name] = whole_number("names", number, most=MOST_IDS)
    if len(set(ids.values())) != len(ids):
        raise ArgumentError("names: expected another id for each")
    return ids


def any_text(name: str, value: object) -> str:
    """Return a text, which may be empty; ArgumentError, which begins with ``name``, if ``value`` is none."""
    if not isinstance(value, str):
        raise ArgumentError(f"{name}: expected a text, got {shown(value)}")
    return value


def find(folder: Folder) -> Manifest | None:
    """Return what ``dataset.json`` holds; None where there is none. DatasetError: it is damaged."""
    try:
        content = folder.read(DATASET, MOST_JSON_BYTES)
    except MissingFileError:
        return None
    with _damage(f"{folder}/{DATASET}"):
        return Manifest.from_dict(parse_json(content))


def is_dataset(folder: Folder) -> bool:
    """Return whether a folder holds a dataset, of whatever version."""
    try:
        content = parse_json(folder.read(DATASET, MOST_JSON_BYTES))
    except (MissingFileError, DamagedFileError, ArgumentError):
        return False
    return isinstance(content, Mapping) and content.keys() >= {"format", "conventions", "cameras"}


def read(out: str | Path | Folder) -> Manifest:
    """Return what ``dataset.json`` holds.

    ArgumentError: no dataset is there. DatasetError: the file is damaged, or missing beside frames.
    """
    folder = storage.folder(out)
    if (manifest := find(folder)) is not None:
        return manifest
    if folder.exists(FRAMES):
        raise DatasetError(f"{folder}/{DATASET}: expected a file of a dataset, it is missing")
    raise ArgumentError(f"{folder}: expected the folder of a dataset, got none: it has no {DATASET}")


def write(out: Folder, manifest: Manifest, first: bool = False) -> bool:
    """Write a ``manifest`` as ``dataset.json`` of the folder ``out``; with ``first`` only if there is none.

    Returns:
        Whether it was written.
    """
    text = json.dumps(manifest.to_dict(), indent=2, allow_nan=False)
    return out.put(DATASET, f"{text}\n".encode(), first)


def advice_to_complete(whole: Manifest) -> str:
    """Return how the dataset of a manifest is completed: by the job, or the loop, that began it."""
    if whole.origin is not None and whole.origin.worlds:
        return "'omniscv dataset make JOB' with its job completes it"
    return "the loop that writes it completes it, by dataset.Writer(out, resume=True)"


def read_frames(out: str | Path | Folder, whole: Manifest | None = None) -> list[Frame]:
    """Return the frames of ``frames.jsonl`` in the dataset ``out``, in the order of the file.

    ``whole`` is the manifest, which is read if it is not given. DatasetError: the file is damaged, or it is
    missing, as in a dataset that is not complete.
    """
    folder = storage.folder(out)
    manifest = read(folder) if whole is None else whole
    try:
        content = folder.read(FRAMES, _MOST_FRAMES_BYTES)
    except MissingFileError:
        wanted = f"expected a complete dataset, got no {FRAMES} in it"
        raise DatasetError(f"{folder}: {wanted}; {advice_to_complete(manifest)}") from None
    with _damage(f"{folder}/{FRAMES}"):
        frames = [manifest.frame(parse_json(line), folder) for line in content.splitlines()]
    keys = [frame.key for frame in frames]
    if keys != sorted(set(keys)):
        raise DatasetError(f"{folder}/{FRAMES}: expected every key once, in their order")
    return frames


def write_frames(out: str | Path | Folder, frames: Iterable[Frame]) -> None:
    """Write ``frames.jsonl`` of ``frames`` into the dataset ``out``, by their keys, whole or not at all."""
    _put_lines(storage.folder(out), FRAMES, map(Frame.to_dict, frames))


def _put_lines(folder: Folder, name: str, lines: Iterable[Mapping[str, Any]]) -> None:
    """Write lines of JSON in the order of their keys."""
    text = ""
    for line in sorted(lines, key=lambda line: str(line["key"])):
        text += f"{json.dumps(line, allow_nan=False)}\n"
    folder.put(name, text.encode())


def read_failed(out: str | Path | Folder) -> list[dict[str, Any]]:
    """Return the lines of ``failed.jsonl``; none without the file. DatasetError: it is damaged."""
    folder = storage.folder(out)
    if not folder.exists(FAILED):
        return []
    failed = []
    with _damage(f"{folder}/{FAILED}"):
        for line in folder.read(FAILED, _MOST_FRAMES_BYTES).splitlines():
            content = parse_json(line)
            failed.append({**content, "key": stem("key", content["key"]), "error": str(content["error"])})
    return failed


def write_failed(folder: Folder, lines: Iterable[Mapping[str, Any]]) -> None:
    """Write ``lines`` to ``failed.jsonl`` of a ``folder``, in the order of keys; without lines remove it."""
    if failed := list(lines):
        _put_lines(folder, FAILED, failed)
    else:
        folder.remove(FAILED)


def read_planned(folder: Folder, whole: Manifest) -> list[Frame]:
    """Return the frames of ``planned.jsonl`` in a ``folder``, without files; ``whole`` is its manifest.

    There are none if the file is missing, or damaged: frames that were made have files of their own.
    """
    try:
        content = folder.read(PLANNED, _MOST_FRAMES_BYTES)
        return [whole.frame(parse_json(line), folder) for line in content.splitlines()]
    except (MissingFileError, DamagedFileError, ArgumentError):
        return []


def write_planned(folder: Folder, frames: Iterable[Frame]) -> None:
    """Write ``frames`` to ``planned.jsonl`` of a ``folder``, in the order of keys."""
    _put_lines(folder, PLANNED, map(Frame.to_dict, frames))


def open(out: str | Path | Folder) -> tuple[Frame, ...]:
    """Return the frames of a dataset, by path or URL, in the order of their keys; their files are read on
    access. Those of a URL are fetched once, into the local cache, and compared with their checksums.

    ArgumentError: no dataset exists there. DatasetError: it is not complete, or its manifest is damaged.
    """
    folder = storage.folder(out)
    return tuple(read_frames(folder, read(folder)))


def with_names(names: Mapping[str, int], new: Iterable[str]) -> dict[str, int]:
    """Return ``names`` with their ids, and ``new`` ones, in sorted order, with the ids that follow."""
    extended = dict(names)
    for name_id, name in enumerate(sorted(new), start=len(names) + 1):
        extended[name] = name_id
    if len(extended) > MOST_IDS:
        raise ArgumentError(f"names: expected at most {MOST_IDS} objects in a dataset, got {len(extended)}")
    return extended


@contextmanager
def _damage(path: Path | str) -> Iterator[None]:
    """Raise what is wrong with a file as a DatasetError that names it."""
    try:
        yield
    except (OSError, StorageError, ValueError, TypeError, KeyError, AttributeError) as cause:
        raise DatasetError(f"{path}: expected a file of a dataset, got: {cause}") from cause
