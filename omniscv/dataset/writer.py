"""Writes frames into a dataset: instance ids frozen by name, every file whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Any, Self

import numpy as np

from omniscv import storage
from omniscv.arguments import optional_number, shown, stem
from omniscv.cameras import Camera
from omniscv.compose.files import OBJECTS, check_format, write_json, write_layers
from omniscv.compose.image import OmniImage
from omniscv.dataset import manifest, spherical_metadata, stored
from omniscv.dataset.classes import class_rules
from omniscv.dataset.manifest import MOST_IDS, Manifest
from omniscv.errors import ArgumentError, DatasetError
from omniscv.frame import FileEntry, Frame, FrameFiles
from omniscv.geometry import Pose
from omniscv.parallel import side_by_side
from omniscv.storage import Folder
from omniscv.truth.classes import ClassRules


class Writer:
    """A dataset that frames are added to; a context manager. Safe to use from several threads.

    The list of frames is written when it is left without an error, or by :meth:`finish`. A process that is
    killed leaves whole files; what it had added is taken up with ``resume``.

    Args:
        out: the folder, by path or URL; made if it is not there.
        classes: path or content of a ``classes.yaml``, or :class:`omniscv.truth.classes.ClassRules`; those of
            a dataset that is resumed if not given.
        resume: go on with a dataset that is there.
        image_format: of colour.
        begun: what the manifest holds from the start: cameras, names, settings.
        closed: refuse objects that the manifest does not have, as where several processes write one dataset.
        media: ``xmp``, whether pictures of equirectangular cameras get Photo Sphere metadata, and ``north``,
            the compass heading of the world's X axis in degrees.

    Raises:
        ArgumentError: a dataset is there and ``resume`` is not set, or it was begun with other cameras,
            classes or settings; or images that are no dataset are there.
        DatasetError: its manifest is damaged.
        UnmatchedNamesError: no rule of the classes matches some names.
    """

    def __init__(
        self,
        out: str | Path,
        classes: str | Path | Mapping[str, Any] | ClassRules | None = None,
        resume: bool = False,
        image_format: str = "png",
        begun: Manifest | None = None,
        closed: bool = False,
        media: Mapping[str, Any] | None = None,
    ) -> None:
        check_format(image_format)
        self._media = {"xmp": False, "north": 0.0, **(media or {})}
        if self._media["xmp"] and image_format not in spherical_metadata.PICTURE_SUFFIXES:
            suffixes = " or ".join(spherical_metadata.PICTURE_SUFFIXES)
            raise ArgumentError(f"media.xmp: expected image_format {suffixes}, got {image_format}")
        self._folder, self._image_format, self._closed = storage.folder(out), image_format, closed
        self._lock = Lock()
        wanted = begun or Manifest()
        if classes is not None:
            wanted = replace(wanted, rules=class_rules(classes))
        self._frames: dict[str, Frame] = {}
        self._written: set[str] = set()
        if self._folder.local is not None:
            self._folder.local.mkdir(parents=True, exist_ok=True)
        with stored.alone(self._folder):
            self.manifest = self._begun(wanted, resume)

    def _begun(self, wanted: Manifest, resume: bool) -> Manifest:
        """The manifest, written: that of the dataset that is there, with what is wanted of it."""
        if not resume:
            check_new(self._folder)
        elif self._folder.exists(OBJECTS):
            raise _taken(self._folder, "images of 'render';")
        if not is_there(self._folder) and manifest.write(self._folder, wanted, first=True):
            return wanted
        had = manifest.read(self._folder)
        found = _resumed(had, wanted, self._folder)
        if had.to_dict() != found.to_dict():
            manifest.write(self._folder, found)
        return found

    def has(self, frame: Frame) -> bool:
        """Return whether a frame is in the dataset, whole, and with the same values."""
        if frame.key not in self._frames:
            self.take_up([frame.key])
        written = self._frames.get(frame.key)
        return written is not None and written.to_dict() == replace(frame, files=written.files).to_dict()

    def add(
        self,
        key: str,
        image: OmniImage,
        pose: Pose | None = None,
        split: str = "",
        time: float | None = None,
        place: str = "",
        truth: Mapping[str, Any] | None = None,
    ) -> bool:
        """Write an image as a frame, unless a resumed dataset has it.

        Args:
            key: start of its file names, unique, without a dot.
            image: its labels become instance ids of the dataset; with classes, it gets a layer ``classes``.
            pose: of its camera, world frame; the image's if not given.
            split: ``train``, ``val``, ``test``, or another word.
            time: seconds.
            place: frames of one place belong in one split.
            truth: records by name, for ``STEM.truth.json``.

        Returns:
            Whether it was written.

        Raises:
            ArgumentError: a key that is none or was added before, or a truth that is no plain JSON.
            UnmatchedNamesError: no rule of the classes matches some of its objects.
            OmniscvError: a file cannot be written.
        """
        if not isinstance(place, str):
            raise ArgumentError(f"place: expected a text, got {shown(place)}")
        frame = Frame(
            key=stem("key", key),
            camera_name=self._camera_name(image.camera),
            camera=image.camera,
            pose=pose or image.pose,
            time=optional_number("time", time),
            place=place,
            split=split and stem("split", split),
            scene=str(image.provenance.get("scene", "")),
        )
        if self.has(frame):
            return False
        self.write(frame, self.with_ids(image), {"truth": truth} if truth else {})
        return True

    def with_ids(self, image: OmniImage) -> OmniImage:
        """Return an image whose labels are instance ids of the dataset, with its classes where it has some.

        Raises:
            ArgumentError: more objects than labels can tell apart.
            DatasetError: an object that a closed dataset does not have.
            UnmatchedNamesError: no rule of the classes matches some of its objects.
        """
        names = [] if image.objects is None or image.labels is None else image.objects.names()
        held = self._freeze(names)
        if image.labels is None:
            return image
        id_of = np.zeros(MOST_IDS + 1, np.uint16)
        id_of[1 : len(names) + 1] = [held.names[name] for name in names]
        layers = {**image.layers, "labels": id_of[image.labels]}
        if held.classes is not None:
            layers["classes"] = held.classes.ids(held.names)[layers["labels"]]
        return replace(image, layers=layers)

    def write(self, frame: Frame, image: OmniImage, records: Mapping[str, Any]) -> None:
        """Write a frame.

        Args:
            frame: without files.
            image: as :meth:`with_ids` returns it.
            records: by kind: the content of ``STEM.KIND.json``.

        Raises:
            ArgumentError: a key that was written before, or a record that is no plain JSON.
            OmniscvError: a file cannot be written.
        """
        with self._lock:
            if frame.key in self._written:
                raise ArgumentError(
                    f"key: expected one that no other frame has, got {shown(frame.key)} again"
                )
            self._written.add(frame.key)
        with stored.workplace(self._folder) as scratch:
            files = write_layers(image.layers, scratch, frame.key, self._image_format)
            if self._media["xmp"] and "lit" in files and spherical_metadata.refuses(frame.camera) is None:
                spherical_metadata.tag_picture(files["lit"], frame.camera, frame.pose, self._media["north"])
            for kind, record in records.items():
                # Not indented: curves are long lists.
                files[kind] = write_json(scratch / f"{frame.key}.{kind}.json", record, indent=None)
            entries = {kind: FileEntry.of(path) for kind, path in files.items()}
            line = replace(frame, files=FrameFiles(self._folder, entries)).to_dict()
            path = write_json(scratch / f"{frame.key}.json", {**_described(image), "frame": line})
            written = self.manifest.frame_of_file(path.name, path.read_bytes(), self._folder)
            stored.put(self._folder, (*files.values(), path))
        with self._lock:
            self._frames[frame.key] = written

    def frames(self, keys: Iterable[str]) -> list[Frame]:
        """Return frames of the dataset by their keys."""
        return [self._frames[key] for key in keys]

    def finish(self) -> list[Frame]:
        """Write ``frames.jsonl`` of all frames that are there, and return its lines in the order of keys."""
        names = (name.removesuffix(".json") for name in self._folder.names() if name.endswith(".json"))
        self.take_up([key for key in names if "." not in key and "/" not in key])
        frames = self.frames(sorted(self._frames))
        with stored.alone(self._folder):
            manifest.write_frames(self._folder, frames)
            stored.tidy(self._folder)
        return frames

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()

    def take_up(self, keys: Iterable[str]) -> None:
        """Find those of some frames that are there; damaged ones are left out."""
        missing = [key for key in keys if key not in self._frames]
        for frame in side_by_side(partial(stored.frame_of, self._folder, self.manifest), missing):
            if frame is not None:
                self._frames[frame.key] = frame

    def take_up_marked(self, marked: Iterable[Frame]) -> None:
        """Take frames as the marker of a finished part lists them, but for those whose files are gone."""
        for frame in marked:
            if not stored.damaged(self._folder, frame, deep=False):
                self._frames[frame.key] = frame

    def _camera_name(self, camera: Camera) -> str:
        """The name of a camera; a new one after its model where the dataset does not have it."""
        with self._lock:
            known = self.manifest.cameras
            for name, each in known.items():
                if each == camera:
                    return name
            fresh = (f"{camera.name}-{i}" if i else camera.name for i in range(len(known) + 1))
            name = next(name for name in fresh if name not in known)
            self._grow(replace(self.manifest, cameras={**known, name: camera}))
            return name

    def _freeze(self, names: list[str]) -> Manifest:
        """The manifest with all names, on disk before a file that needs it."""
        with self._lock:
            if fresh := [name for name in names if name not in self.manifest.names]:
                if self._closed:
                    got = f"{len(fresh)} others such as {shown(fresh[0])}"
                    raise DatasetError(
                        f"names: expected the objects that the dataset was begun with, got {got}"
                    )
                self._grow(replace(self.manifest, names=_numbered(self.manifest.names, fresh)))
            return self.manifest

    def _grow(self, grown: Manifest) -> None:
        with stored.alone(self._folder):
            manifest.write(self._folder, grown)
        self.manifest = grown


def check_new(folder: Folder) -> None:
    """Refuse a folder that holds a dataset, or images of ``render``.

    Raises:
        ArgumentError: it does.
    """
    if is_there(folder):
        raise _taken(folder, "a dataset; resume it, or")
    if folder.exists(OBJECTS):
        raise _taken(folder, "images of 'render';")


def is_there(folder: Folder) -> bool:
    """Return whether a folder holds a dataset, complete or not."""
    return any(folder.exists(name) for name in (manifest.DATASET, manifest.FRAMES))


def _taken(folder: Folder, got: str) -> ArgumentError:
    return ArgumentError(f"{folder}: expected a new folder, got {got} write elsewhere")


def _numbered(names: Mapping[str, int], fresh: Iterable[str]) -> dict[str, int]:
    """Names with ids, new ones after those that are there, in sorted order.

    Raises:
        ArgumentError: more than labels can tell apart.
    """
    found = {**names, **{name: i for i, name in enumerate(sorted(fresh), start=len(names) + 1)}}
    if len(found) > MOST_IDS:
        raise ArgumentError(f"names: expected at most {MOST_IDS} objects in a dataset, got {len(found)}")
    return found


def _resumed(had: Manifest, wanted: Manifest, out: Folder) -> Manifest:
    """The manifest of a dataset that goes on; ArgumentError where it was begun otherwise."""
    for name, camera in wanted.cameras.items():
        if had.cameras.get(name, camera) != camera:
            raise _other(out, f"camera {name!r} as {had.cameras[name]!r}")
    if wanted.rules is not None and had.rules != wanted.rules:
        raise _other(out, "other classes" if had.rules else "no classes")
    settings = json.loads(json.dumps(wanted.settings))  # as it is read: lists for tuples
    if differ := [key for key, value in settings.items() if had.settings.get(key) != value]:
        raise _other(out, f"other {', '.join(differ)}")
    names = _numbered(had.names, [name for name in wanted.names if name not in had.names])
    return replace(had, names=names, cameras={**had.cameras, **wanted.cameras})


def _other(out: Folder, had: str) -> ArgumentError:
    return ArgumentError(
        f"{out}: expected the dataset that is resumed to be the same, it has {had}; write elsewhere"
    )


def _described(image: OmniImage) -> dict[str, Any]:
    """What an image's own file says of it, without where and when its captures came from."""
    said = image.description()
    return {key: said[key] for key in said if key != "source"}
