"""A frame: one image of a job or a dataset, from the plan to the loader, and the border of its files.

:class:`Frame` is the only record of a frame. ``omniscv.make.instants`` plans it; truths are derived of it
while its image and the world are in memory; ``omniscv.dataset.Writer`` writes its files, and its line in
``frames.jsonl``; ``omniscv.dataset.manifest`` reads that back for all readers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import within
from omniscv.cameras import Camera
from omniscv.cameras.rolling_shutter import path_of
from omniscv.compose.files import read
from omniscv.compose.layers import MARKS, doubt_of
from omniscv.errors import ArgumentError, DatasetError
from omniscv.frame import forms
from omniscv.frame.classes import ClassTable
from omniscv.frame.files import IMAGE, FileEntry, FrameFiles, ImageFiles, file_endings
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.geometry.trajectory import NS
from omniscv.storage import Folder
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, read_bytes

__all__ = ["IMAGE", "FileEntry", "Frame", "FrameFiles", "ImageFiles", "file_endings"]


if TYPE_CHECKING:
    from omniscv.compose.image import OmniImage
    from omniscv.compose.renderer import Renderer
    from omniscv.sensor.imu import ImuTrack


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
        time_ns: whole nanoseconds; None if poses have no times.
        place: frames of one place are never split.
        split: ``train``, ``val``, ``test``, ...; empty without splits.
        scene: identity of what was captured; empty if it is not known.
        state: of the world (:attr:`omniscv.geometry.instant.Instant.state`); empty for a still one.
        shows: a digest of the instants and poses of its exposure; empty for one instant and pose.
        varied: what was drawn for it (:mod:`omniscv.job.vary`), by kind, name and setting.
        world: its name in a job of several; empty in others.
        watch: objects that the world has left out of the image (:mod:`omniscv.make.frames`).
        made_of: a digest of what the dataset was made of when the frame was, where its own file was read.
        blank: marks that no pixel has: layers without a file.
        imu: of the dataset's rig, with its trajectory; None without.
        image: in memory, until its files are written; ``labels`` are instance ids of the dataset.
        geometry, object_poses: with the image: the shapes that the source knows, and by name the poses of
            objects.
        renderer: of the source, to capture more; None offline.
    """

    key: str
    camera_name: str
    camera: Camera
    pose: Pose
    files: Mapping[str, Path] = field(default_factory=dict)
    instances: Mapping[str, int] = field(default_factory=dict)
    classes: ClassTable | None = None
    time_ns: int | None = None
    place: str = ""
    split: str = ""
    scene: str = ""
    state: str = ""
    shows: str = ""
    varied: Mapping[str, Any] = field(default_factory=dict)
    world: str = ""
    watch: tuple[str, ...] = ()
    made_of: str = ""
    blank: tuple[str, ...] = ()
    imu: ImuTrack | None = None
    image: OmniImage | None = None
    geometry: SceneGeometry = field(default_factory=SceneGeometry)
    object_poses: Mapping[str, Pose] = field(default_factory=dict)
    renderer: Renderer | None = None

    def __repr__(self) -> str:
        split = f", {self.split}" if self.split else ""
        return f"<Frame {self.key}: {self.camera_name}{split}: {', '.join(self.files)}>"

    def layer(self, name: str) -> NDArray[Any]:
        """Return a layer as it is, or was, in memory: dtype and shape as :mod:`omniscv.modalities` has it.

        ``doubt`` is that of the frame's other layers. ArgumentError: the frame has no such layer, or the file
        of an image in no dataset is damaged. DatasetError: the file is missing, or no such layer.
        """
        if self.image is not None and name in self.image.layers:
            return self.image[name]
        if name in self.blank:
            return np.zeros((self.camera.height, self.camera.width), np.bool_)
        if name == "doubt" and name not in self.files:
            marks = self.layers(*MARKS, "depth", "depth_error")
            return doubt_of(marks, (self.camera.height, self.camera.width))
        if name not in self.files:
            kinds = ", ".join(self.image.layers if self.image is not None else self.files) or "none"
            wanted = f"expected a frame with {name}, it has {kinds}"
            raise ArgumentError(f"{self.key}: {wanted}; make it with {name}")
        path = self.files[name]
        with self._damage():
            return read(path, name)

    def rendered(self) -> OmniImage:
        """Return the image in memory; ArgumentError where there is none, or its files have been written."""
        if self.image is None:
            raise ArgumentError(f"{self.key}: expected a frame with its image in memory, got none")
        return self.image

    def layers(self, *names: str) -> dict[str, NDArray[Any]]:
        """Return the layers of these names that the frame has, as :meth:`layer` does."""
        known = {*self.files, *self.blank}
        return {name: self.layer(name) for name in names if name in known}

    @cached_property
    def truth(self) -> Mapping[str, Any]:
        """The records of STEM.truth.json, by the name of the truth; empty without the file."""
        return self.records("truth") if "truth" in self.files else {}

    @cached_property
    def layout(self) -> Mapping[str, Any]:
        """The record of STEM.layout.json; empty without the file."""
        return self.records("layout") if "layout" in self.files else {}

    def with_files(self, folder: Folder, entries: Mapping[str, FileEntry]) -> Frame:
        """Return the frame with files, ``entries`` by kind, in the ``folder`` of a dataset; its image is no
        longer in memory."""
        files = FrameFiles(entries, (self.camera.width, self.camera.height), folder)
        return replace(
            self, files=files, image=None, geometry=SceneGeometry(), object_poses={}, renderer=None
        )

    def records(self, kind: str) -> Any:
        """Return the content of a file of records, such as STEM.truth.json; DatasetError if it is damaged, or
        a record has another form than its truth gives it."""
        path = self.files[kind]
        with self._damage(), within(f"{path}: expected {kind} records, got"):
            content = parse_json(read_bytes(path, MOST_JSON_BYTES))
            return forms.checked(kind, content, self.camera, self.instances)

    @contextmanager
    def _damage(self) -> Iterator[None]:
        """Raise what is wrong with a file of a dataset as DatasetError."""
        try:
            yield
        except ArgumentError as fault:
            raise (DatasetError(fault.message) if isinstance(self.files, FrameFiles) else fault) from fault

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: the pixels inside the field of view that recorded views show."""
        valid = self.camera.valid()
        return valid & ~self.layer("unseen") if "unseen" in self.files else valid

    @property
    def time(self) -> float | None:
        """Seconds, for people; None without a time. Since 1970 they have six decimals."""
        return None if self.time_ns is None else self.time_ns / NS

    @property
    def kinds(self) -> set[str]:
        """The kinds of its files, and ``imu`` if the dataset has one."""
        kinds = set(self.files)
        if self.imu:
            kinds.add("imu")
        return kinds

    @property
    def entries(self) -> Mapping[str, FileEntry]:
        """Sizes and checksums of its files, by kind; empty unless it is of a dataset."""
        return self.files.entries if isinstance(self.files, FrameFiles) else {}

    def to_dict(self) -> dict[str, Any]:
        """Return the frame's line of ``frames.jsonl`` as plain values.

        A state only of a world that moves; a path only of a camera that moved on it during the image.
        """
        line: dict[str, Any] = {
            "key": self.key,
            "camera": self.camera_name,
            "pose": self.pose.to_dict(),
            "time_ns": self.time_ns,
        }
        path = path_of(self.camera)
        if path:
            line["path"] = path
        line |= {"place": self.place, "split": self.split, "scene": self.scene}
        for key in ("world", "state", "shows", "varied"):
            if getattr(self, key):
                line[key] = getattr(self, key)
        line["files"] = {kind: asdict(entry) for kind, entry in sorted(self.entries.items())}
        if self.watch:
            line["watch"] = list(self.watch)
        if self.blank:
            line["blank"] = sorted(self.blank)
        return line
