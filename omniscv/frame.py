"""A frame: one image of a job or a dataset, from the plan to the loader.

:class:`Frame` is the only record of a frame. It is the same class at every step; each step fills in more of
it:

1. ``omniscv.make.moments`` plans it: key, camera, pose, time; for datasets place, split, scene and state.
2. A truth is derived of it, an image and the world: :class:`omniscv.dataset.Observation`.
3. ``omniscv.dataset.Writer`` writes its files: ``files`` are then :class:`FrameFiles`, with sizes and
checksums.
4. Its line in ``frames.jsonl`` is :meth:`Frame.to_dict`; :meth:`Frame.from_dict` reads it back.
5. Formats, checks, viewers and loaders read ``files``, ``layer(name)``, ``truth`` and ``layout``.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import optional_number, shown, stem, text, whole_number
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.storage import Folder

if TYPE_CHECKING:
    from omniscv.truth.classes import ClassTable


@dataclass(frozen=True)
class FileEntry:
    """A file of a frame, as the manifest lists it.

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
        return cls(path.name, path.stat().st_size, _checksum(path))

    def fault(self, folder: Path, deep: bool = True) -> str | None:
        """Return what is wrong with the file in a folder, in a few words; None if nothing is.

        Args:
            folder: of the dataset.
            deep: whether its bytes are read.
        """
        path = folder / self.path
        if not path.is_file():
            return "expected a file, it is missing"
        if (size := path.stat().st_size) != self.bytes:
            return f"expected {self.bytes} bytes, got {size}"
        if deep and _checksum(path) != self.sha256:
            return "expected the bytes of its checksum, got other ones"
        return None


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True, eq=False)
class FrameFiles(Mapping[str, Path]):
    """The files of a frame, by kind: paths in a local folder, or of a store, fetched and checked on access.

    Attributes:
        folder: of the dataset.
        entries: the files by kind.
        stand_in: a local folder that stands for that of a store while an export below it is written.
    """

    folder: Folder
    entries: Mapping[str, FileEntry]
    stand_in: Path | None = None

    def __getitem__(self, kind: str) -> Path:
        entry = self.entries[kind]
        local = self.folder.local
        return self.folder.fetch(entry.path, entry.sha256) if local is None else local / entry.path

    def __contains__(self, kind: object) -> bool:
        return kind in self.entries

    def __iter__(self) -> Iterator[str]:
        return iter(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def reference(self, kind: str, out: Path) -> str:
        """Return the name of a file as seen from a folder; of a store its URL, unless it has a stand-in."""
        name = self.entries[kind].path
        root = self.folder.local
        if root is None:
            if self.stand_in is None or self.stand_in not in out.parents:
                return f"{self.folder}/{name}"
            root = self.stand_in
        return _relative(root / name, out)


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """One image, and what is known of it. Formats read nothing else.

    Attributes:
        key: start of its file names, unique in the dataset; without a dot in datasets.
        camera_name, camera: as the job or the dataset names it.
        pose: of the camera, world frame.
        files: by kind: a layer's name, ``truth`` (STEM.truth.json), ``layout`` (STEM.layout.json), or
            ``image`` (STEM.json); empty before the frame is written.
        instances: object name to the instance id that ``labels`` holds, the same in the whole dataset.
        classes: of the dataset; None without.
        time: seconds; None if poses have no times.
        place: frames of one place are never split.
        split: ``train``, ``val``, ``test``, ...; empty without splits.
        scene: identity of what was captured; empty if it is not known.
        state: of the world (:attr:`omniscv.geometry.instant.Instant.state`); empty for a still one.
    """

    key: str
    camera_name: str
    camera: Camera
    pose: Pose
    files: Mapping[str, Path] = field(default_factory=dict)
    instances: Mapping[str, int] = field(default_factory=dict)
    classes: ClassTable | None = None
    time: float | None = None
    place: str = ""
    split: str = ""
    scene: str = ""
    state: str = ""

    def __repr__(self) -> str:
        split = f", {self.split}" if self.split else ""
        return f"<Frame {self.key}: {self.camera_name}{split}: {', '.join(self.files)}>"

    def layer(self, name: str) -> NDArray[Any]:
        """Return a layer as it was in memory: dtype and shape as :mod:`omniscv.modalities` has it.

        Raises:
            ArgumentError: the frame has no such layer, or its file cannot be read.
        """
        from omniscv.compose.files import read

        if name not in self.files:
            kinds = ", ".join(self.files) or "none"
            raise ArgumentError(
                f"{self.key}: expected a frame with {name}, it has {kinds}; make it with {name}"
            )
        return read(self.files[name], name)

    def layers(self, *names: str) -> dict[str, NDArray[Any]]:
        """Return the layers of these names that the frame has, as :meth:`layer` does."""
        return {name: self.layer(name) for name in names if name in self.files}

    @cached_property
    def truth(self) -> Mapping[str, Any]:
        """The records of STEM.truth.json, by the name of the truth; empty without the file."""
        return self._records("truth")

    @cached_property
    def layout(self) -> Mapping[str, Any]:
        """The record of STEM.layout.json; empty without the file."""
        return self._records("layout")

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: the pixels inside the field of view."""
        return self.camera.valid()

    @property
    def entries(self) -> Mapping[str, FileEntry]:
        """Sizes and checksums of its files, by kind; empty unless it is of a dataset."""
        return self.files.entries if isinstance(self.files, FrameFiles) else {}

    def reference(self, kind: str, out: Path) -> str:
        """Return the name of a file as seen from a folder, or its URL."""
        if isinstance(self.files, FrameFiles):
            return self.files.reference(kind, out)
        return _relative(self.files[kind], out)

    def to_dict(self) -> dict[str, Any]:
        """Return the frame's line of ``frames.jsonl`` as plain values; a state only of a world that moves."""
        return {
            "key": self.key,
            "camera": self.camera_name,
            "pose": self.pose.to_dict(),
            "time": self.time,
            "place": self.place,
            "split": self.split,
            "scene": self.scene,
            **({"state": self.state} if self.state else {}),
            "files": {kind: asdict(entry) for kind, entry in sorted(self.entries.items())},
        }

    @classmethod
    def from_dict(
        cls,
        data: Any,
        folder: Folder,
        cameras: Mapping[str, Camera],
        instances: Mapping[str, int] | None = None,
        classes: ClassTable | None = None,
    ) -> Frame:
        """Return the frame of a line.

        Args:
            data: what :meth:`to_dict` returned.
            folder: of the files.
            cameras, instances, classes: of the dataset.

        Raises:
            ArgumentError: no such line, or a camera that the dataset does not have.
        """
        try:
            key, camera_name = stem("key", data["key"]), stem("camera", data["camera"])
            if camera_name not in cameras:
                known = ", ".join(cameras)
                raise ArgumentError(f"{key}: expected one of the cameras {known}; got {camera_name!r}")
            return cls(
                key=key,
                camera_name=camera_name,
                camera=cameras[camera_name],
                pose=Pose.from_dict(data["pose"]),
                files=FrameFiles(
                    folder, {str(kind): FileEntry(**entry) for kind, entry in data["files"].items()}
                ),
                instances=instances or {},
                classes=classes,
                time=optional_number("time", data["time"]),
                place=_text("place", data["place"]),
                split=data["split"] and stem("split", data["split"]),
                scene=_text("scene", data["scene"]),
                state=_text("state", data.get("state", "")),
            )
        except (TypeError, KeyError, AttributeError) as cause:
            wanted = "expected a frame with key, camera, pose, time, place, split, scene and files"
            raise ArgumentError(f"{wanted}; got {type(cause).__name__}: {shown(str(cause))}") from cause

    def _records(self, kind: str) -> Mapping[str, Any]:
        if kind not in self.files:
            return {}
        try:
            return dict(json.loads(self.files[kind].read_text(encoding="utf-8")))
        except (OSError, ValueError) as cause:
            raise ArgumentError(f"{self.files[kind]}: expected records in JSON, got: {cause}") from cause


def _text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise ArgumentError(f"{name}: expected a text, got {shown(value)}")
    return value


def _relative(file: Path, out: Path) -> str:
    return Path(os.path.relpath(file, out)).as_posix()
