"""The manifest of a dataset: ``dataset.json``, what all frames share, and ``frames.jsonl``, a line for each.

``dataset.json`` is there before the first frame, so that object names and their ids are frozen; it grows when
an object or camera comes that it does not have. ``STEM.json`` is the last file of a frame: a frame is whole
when it is there. ``frames.jsonl`` is written last of all, in the order of keys. No file holds a time of a
clock, an address, or a path outside the dataset: the same frames make the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from omniscv import storage
from omniscv.arguments import optional_number, shown, text, whole_number
from omniscv.cameras import Camera, from_dict
from omniscv.compose.files import versions
from omniscv.errors import ArgumentError, DatasetError, StorageError
from omniscv.geometry import Pose
from omniscv.storage import Folder
from omniscv.truth.classes import ClassRules, ClassTable

DATASET, FRAMES = "dataset.json", "frames.jsonl"
FORMAT = 1
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

IMAGE = "image"
"""The kind of ``STEM.json`` among the files of a frame."""


def check_key(name: str, key: object) -> None:
    """Raise ArgumentError unless a text can start file names, without a dot, which ends it in WebDataset."""
    if not isinstance(key, str) or not key or key != Path(key).name or "." in key or "\0" in key:
        raise ArgumentError(f"{name}: expected the start of a file name without a dot, got {shown(key)}")


@dataclass(frozen=True)
class FileEntry:
    """A file of a frame.

    Attributes:
        path: its name in the dataset's folder.
        bytes: its size.
        sha256: of its bytes, hexadecimal.
    """

    path: str
    bytes: int
    sha256: str

    def __post_init__(self) -> None:
        if not isinstance(self.path, str) or self.path != Path(self.path).name or self.path.startswith("."):
            raise ArgumentError(f"path: expected the name of a file of the dataset, got {shown(self.path)}")
        text("path", self.path)
        whole_number("bytes", self.bytes, least=0)

    @classmethod
    def of(cls, path: Path) -> FileEntry:
        """Return the entry of a file as it is."""
        return cls(path.name, path.stat().st_size, checksum(path))

    def fault(self, folder: Path, deep: bool = True) -> str | None:
        """Return what is wrong with the file below a folder, in a few words; None where nothing is.

        Args:
            folder: of the dataset.
            deep: whether its bytes are read.
        """
        path = folder / self.path
        if not path.is_file():
            return "expected a file, it is missing"
        if (size := path.stat().st_size) != self.bytes:
            return f"expected {self.bytes} bytes, got {size}"
        if deep and checksum(path) != self.sha256:
            return "expected the bytes of its checksum, got other ones"
        return None


@dataclass(frozen=True, eq=False)
class FrameEntry:
    """A line of ``frames.jsonl``; the fields are those of :class:`omniscv.dataset.Frame`, and its scene."""

    key: str
    camera: str
    pose: Pose
    files: Mapping[str, FileEntry]
    time: float | None = None
    place: str = ""
    split: str = ""
    scene: str = ""
    state: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; a state only of a world that moves."""
        state = {"state": self.state} if self.state else {}
        return {
            "key": self.key,
            "camera": self.camera,
            "pose": self.pose.to_dict(),
            "time": self.time,
            "place": self.place,
            "split": self.split,
            "scene": self.scene,
            **state,
            "files": {kind: asdict(entry) for kind, entry in sorted(self.files.items())},
        }

    @classmethod
    def from_dict(cls, data: Any) -> FrameEntry:
        """The inverse of :meth:`to_dict`; ArgumentError for anything else."""
        try:
            files = {str(kind): FileEntry(**each) for kind, each in data["files"].items()}
            for name in ("key", "camera", *(("split",) if data["split"] != "" else ())):
                check_key(name, data[name])
            data = {"state": "", **data}
            for name in ("place", "scene", "state"):
                if not isinstance(data[name], str):
                    raise ArgumentError(f"{name}: expected a text, got {shown(data[name])}")
            plain = {name: data[name] for name in ("key", "camera", "place", "split", "scene", "state")}
            time = optional_number("time", data["time"])
            return cls(pose=Pose.from_dict(data["pose"]), files=files, time=time, **plain)
        except (TypeError, KeyError, AttributeError) as cause:
            wanted = "expected a frame with key, camera, pose, time, place, split, scene and files"
            raise ArgumentError(f"{wanted}; got {type(cause).__name__}: {shown(str(cause))}") from cause


@dataclass(frozen=True)
class Manifest:
    """What ``dataset.json`` holds.

    Attributes:
        cameras: by name.
        names: object name to the instance id that labels hold.
        rules: of its classes; None without classes.
        settings: how it was made: ``splits``, ``exports``, ``options``, as plain values.
        versions: of the packages that began it.
    """

    cameras: Mapping[str, Camera] = field(default_factory=dict)
    names: Mapping[str, int] = field(default_factory=dict)
    rules: ClassRules | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=versions)

    @cached_property
    def classes(self) -> ClassTable | None:
        """The classes of the objects; None without classes.

        Raises:
            UnmatchedNamesError: no rule matches some names.
        """
        return None if self.rules is None else self.rules.table(self.names)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        table = self.classes
        classes = None
        if self.rules is not None and table is not None:
            listed = [asdict(each) for each in table.classes.values()]
            of_object = {name: table.of_object[name] for name in self.names if name in table.of_object}
            classes = {**self.rules.to_dict(), "classes": listed, "of_object": of_object}
        return {
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

    @classmethod
    def from_dict(cls, data: Any) -> Manifest:
        """The inverse of :meth:`to_dict`; ArgumentError for anything else."""
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            got = data.get("format") if isinstance(data, dict) else data
            raise ArgumentError(f"expected a dataset of format {FORMAT}, got {shown(got)}")
        try:
            cameras = {name: from_dict(each) for name, each in data["cameras"].items()}
            for name in cameras:
                check_key("camera", name)
            names = {name: whole_number(name, each, most=MOST_IDS) for name, each in data["names"].items()}
            said = data["classes"]
            rules = None
            if said is not None:
                said = {key: value for key, value in said.items() if key not in ("classes", "of_object")}
                rules = ClassRules.from_dict(said)
            keys = ("format", "out", "options", "cameras")
            exports = [{key: each[key] for key in keys} for each in data["exports"]]
            settings = {"splits": data["splits"], "exports": exports, "options": data["options"]}
            versions = {"omniscv": data["omniscv"], **data["versions"]}
            return cls(cameras, names, rules, settings, versions)
        except (TypeError, KeyError, AttributeError) as cause:
            wanted = "expected cameras, names, classes, splits, exports, options"
            raise ArgumentError(f"{wanted}; got {type(cause).__name__}: {shown(str(cause))}") from cause


def read(out: str | Path | Folder) -> Manifest:
    """Return what ``dataset.json`` holds.

    Raises:
        ArgumentError: no dataset is there.
        DatasetError: the file is damaged, or missing beside frames.
    """
    folder = storage.folder(out)
    if not folder.exists(DATASET) and not folder.exists(FRAMES):
        raise ArgumentError(f"{folder}: expected the folder of a dataset, got none: it has no {DATASET}")
    with _damage(f"{folder}/{DATASET}"):
        return Manifest.from_dict(json.loads(folder.read(DATASET)))


def write(out: Folder, manifest: Manifest, first: bool = False) -> bool:
    """Write ``dataset.json``, whole or not at all; with ``first``, only where there is none.

    Returns:
        Whether it was written.

    Raises:
        UnmatchedNamesError: no rule of the classes matches some names.
    """
    text = json.dumps(manifest.to_dict(), indent=2, allow_nan=False)
    return out.put(DATASET, f"{text}\n".encode(), first)


def read_frames(out: str | Path | Folder) -> list[FrameEntry]:
    """Return the lines of ``frames.jsonl``, in their order.

    Raises:
        DatasetError: the file is damaged, or missing: the dataset is not complete.
    """
    folder = storage.folder(out)
    if not folder.exists(FRAMES):
        advice = "finish it by 'omniscv dataset make JOB --resume'"
        raise DatasetError(f"{folder}: expected a complete dataset, got no {FRAMES} in it; {advice}")
    with _damage(f"{folder}/{FRAMES}"):
        lines = folder.read(FRAMES).decode("utf-8").splitlines()
        return [FrameEntry.from_dict(json.loads(line)) for line in lines]


def write_frames(out: str | Path | Folder, frames: Iterable[FrameEntry]) -> None:
    """Write ``frames.jsonl`` in the order of keys, whole or not at all."""
    lines = [json.dumps(each.to_dict(), allow_nan=False) for each in sorted(frames, key=lambda f: f.key)]
    storage.folder(out).put(FRAMES, "".join(f"{line}\n" for line in lines).encode())


def read_entry(path: Path) -> FrameEntry:
    """Return the frame that its ``STEM.json`` describes, as :func:`entry_of`."""
    with _damage(path):
        return entry_of(path.name, path.read_bytes())


def entry_of(name: str, content: bytes) -> FrameEntry:
    """Return the frame that a ``STEM.json`` of some bytes describes, that file among its files.

    Raises:
        DatasetError: the file is no such description.
    """
    with _damage(name):
        entry = FrameEntry.from_dict(json.loads(content)["frame"])
        own = FileEntry(name, len(content), hashlib.sha256(content).hexdigest())
        return replace(entry, files={**entry.files, IMAGE: own})


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def _damage(path: Path | str) -> Iterator[None]:
    """Raise what is wrong with a file as a DatasetError that names it."""
    try:
        yield
    except (
        OSError, StorageError, ValueError, TypeError, KeyError, AttributeError, RecursionError
    ) as cause:  # fmt: skip
        raise DatasetError(f"{path}: expected a file of a dataset, got: {cause}") from cause
