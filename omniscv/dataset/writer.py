"""Writes frames into a dataset: instance ids frozen by name, every file whole or not at all."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from tempfile import gettempdir
from threading import Lock
from types import TracebackType
from typing import Any, Self, Unpack

import numpy as np

from omniscv import modalities, storage
from omniscv.arguments import file_key, number, shown, stem
from omniscv.cameras import Camera
from omniscv.compose.files import Forms, blank, check_format, write_json, write_layers
from omniscv.compose.image import OmniImage
from omniscv.dataset import manifest
from omniscv.dataset.beginning import Planned, begin, lock, tidy
from omniscv.dataset.belongings import SCRATCH, frame_of, roll_back
from omniscv.dataset.manifest import MOST_IDS, Manifest
from omniscv.dataset.media import PICTURE_SUFFIXES, photo_sphere_fields, refuses, with_photo_sphere
from omniscv.dataset.origin import differences, frame_difference, plain
from omniscv.errors import ArgumentError, DatasetError, ExistingDatasetError, OtherDatasetError
from omniscv.frame import IMAGE, FileEntry, Frame, FrameFiles
from omniscv.frame.classes import ClassRules, class_rules
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import nanoseconds
from omniscv.storage import in_the_way
from omniscv.storage.local import scratch_folder

_AHEAD = 8
"""Frames whose files are put into a store at a time, while the next one is made."""


class Writer:
    """Adds frames to a dataset; a context manager. Safe to use from several threads.

    The list of frames is written when the context ends without an error, or by :meth:`finish`. A process that
    is killed leaves whole files; ``resume`` keeps the frames that it had added. ``key in writer`` says
    whether a frame is there, whole, before it is rendered again.

    Args:
        out: the folder, by path or URL; made if it does not exist.
        classes: path or content of a ``classes.yaml``, or :class:`omniscv.frame.classes.ClassRules`; those of
            a dataset that is resumed if not given.
        resume: continue a dataset if there is one.
        begun: what the manifest holds from the start: cameras, names, settings.
        closed: refuse objects that the manifest does not have, as when several processes write one dataset.
        media: ``xmp``, whether pictures of equirectangular cameras get Photo Sphere metadata, and ``north``,
            the compass heading of the world's X axis in degrees.
        keys: of frames that will be written, as far as they are known: files of others that have their names
            are refused before anything is written.
        planned: all frames of the job of which it writes some.
        written_as: the image format, the store and the depth format: :class:`omniscv.compose.files.Forms`.

    Raises:
        ExistingDatasetError: a dataset exists and ``resume`` is not set.
        OtherDatasetError: it was begun with other cameras, classes or settings.
        ArgumentError: the folder holds images of ``render``, or files of others that are in the way.
        DatasetError: its manifest is damaged.
        UnmatchedNamesError: no rule of the classes matches some names.
    """

    def __init__(
        self,
        out: str | Path,
        classes: str | Path | Mapping[str, Any] | ClassRules | None = None,
        resume: bool = False,
        begun: Manifest | None = None,
        closed: bool = False,
        media: Mapping[str, Any] | None = None,
        keys: Collection[str] = (),
        planned: Planned | None = None,
        **written_as: Unpack[Forms],
    ) -> None:
        check_format(**written_as)
        image_format = written_as.get("image_format", "png")
        store = written_as.get("store", "files")
        self._media = {"xmp": False, "north": 0.0, **(media or {})}
        if self._media["xmp"] and (store == "fast" or image_format not in PICTURE_SUFFIXES):
            expected = f"expected store files and image_format {' or '.join(PICTURE_SUFFIXES)}"
            raise ArgumentError(f"media.xmp: {expected}, got {store} and {image_format}")
        self._folder = storage.folder(out)
        self._closed = closed
        self._written_as = written_as
        self._lock = Lock()
        self._keys = frozenset(keys)
        self._alive = ExitStack()
        wanted = begun or Manifest()
        if classes is not None:
            wanted = replace(wanted, rules=class_rules(classes))
        self._frames: dict[str, Frame] = {}
        self._written: set[str] = set()
        self._pool = ThreadPoolExecutor(_AHEAD, thread_name_prefix="put")  # without threads until it is used
        self._putting: list[Future[None]] = []
        if self._folder.local is not None:
            self._folder.local.mkdir(parents=True, exist_ok=True)
        with lock(self._folder):
            with _advice():
                self.manifest, self._there = begin(self._folder, wanted, resume, keys, planned)
            if self._folder.local is not None:  # which says that a writer is alive
                self._alive.enter_context(scratch_folder(self._folder.local, SCRATCH))

    def __contains__(self, key: str) -> bool:
        """Return whether the dataset has the frame of a key, with all of its files."""
        self._settle()
        self.keep([key])
        return key in self._frames

    def has(self, frame: Frame) -> bool:
        """Return whether a frame is in the dataset, whole, and with the same values."""
        return not self.missing([frame])

    def missing(self, frames: Collection[Frame]) -> set[str]:
        """Return the keys of frames that the dataset does not have whole, and with the same values."""
        if any(file_key(frame.key) in self._written for frame in frames):
            self._settle()
        self.keep([frame.key for frame in frames])
        missing = set()
        for frame in frames:
            written = self._frames.get(frame.key)
            if written is None or not is_same(written, frame):
                missing.add(frame.key)
        return missing

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
            split: ``train``, ``val``, ``test``, or another word; empty for a frame of no split.
            time: seconds; None for a frame without a time.
            place: frames of one place belong in one split; empty for a frame of no place.
            truth: records by name, for ``STEM.truth.json``; no such file if not given.

        Returns:
            Whether it was written.

        Raises:
            ArgumentError: a wrong key, or one that was added before, or a truth that is no plain JSON.
            UnmatchedNamesError: no rule of the classes matches some of its objects.
            OmniscvError: a file cannot be written.
        """
        self._check_made(image)
        frame = Frame(
            key=stem("key", key),
            camera_name=self._camera_name(image.camera),
            camera=image.camera,
            pose=pose or image.pose,
            time_ns=None if time is None else nanoseconds(number("time", time)),
            place=manifest.any_text("place", place),
            split=split and stem("split", split),
            scene=str(image.provenance.get("scene", "")),
        )
        if self.has(frame):
            return False
        self.write(*self.with_ids(frame, image), {"truth": truth} if truth else {})
        return True

    def _check_made(self, image: OmniImage) -> None:
        """Refuse an image that was made otherwise than the job of the dataset makes them."""
        options = self.manifest.settings.get("options", {})
        if "modes" not in options:  # no job has begun it
            return
        made = plain({**asdict(image.options), "modes": [*image.layers.keys() & set(modalities.names())]})
        made["modes"] = sorted(made["modes"])
        wanted = {key: options.get(key) for key in made}
        wanted["modes"] = sorted(options["modes"])
        if line := next(differences({"options": wanted}, {"options": made}), ""):
            expected = "expected an image as the job of the dataset makes them"
            raise ArgumentError(f"{expected}; its {line.replace('in the job', 'of the image')}")

    def with_ids(self, frame: Frame, image: OmniImage) -> tuple[Frame, OmniImage]:
        """Return a frame with the instances and classes of the dataset, and its image with the layers that
        show them: ``labels`` are instance ids of the dataset, ``classes`` the ids of their classes."""
        names: list[str] = []
        if image.objects is not None and image.labels is not None:
            names = image.objects.names()
        whole = self._with_names(names)
        frame = replace(frame, instances=whole.names, classes=whole.classes)
        if image.labels is None:
            return frame, image
        id_of = np.zeros(MOST_IDS + 1, np.uint16)
        for label, name in enumerate(names, start=1):
            id_of[label] = whole.names[name]
        layers = {**image.layers, "labels": id_of[image.labels]}
        if frame.classes is not None:
            layers["classes"] = frame.classes.ids(whole.names)[layers["labels"]]
        return frame, replace(image, layers=layers)

    def write(self, frame: Frame, image: OmniImage, records: Mapping[str, Any]) -> None:
        """Write a frame; in a store its files may still be on their way when this returns.

        Args:
            frame: as :meth:`with_ids` returns it, without files.
            image: as :meth:`with_ids` returns it.
            records: by kind: the content of ``STEM.KIND.json``.

        Raises:
            ArgumentError: this writer has written a frame of the key before, or files of others have its
                names, or the colours cannot hold Photo Sphere metadata that ``media`` asks for.
        """
        with self._lock:
            if file_key(frame.key) in self._written:  # as on Windows and macOS
                wanted = "expected one that no other frame has, in any case of letters"
                raise ArgumentError(f"key: {wanted}, got {shown(frame.key)} again")
            self._written.add(file_key(frame.key))
        frame = replace(frame, blank=tuple(blank(image.layers)))
        with ExitStack() as stack:
            # Each writer has its own: two may write one frame, as when a worker taken for dead goes on.
            parent = self._folder.local or Path(gettempdir())
            folder = stack.enter_context(scratch_folder(parent, SCRATCH))
            files = write_layers(image.layers, folder, frame.key, image.transfer, **self._written_as)
            if self._media["xmp"] and "lit" in files and refuses(frame.camera) is None:
                self._add_photo_sphere(frame, files["lit"])
            for kind, record in records.items():
                # Not indented: curves are long lists.
                files[kind] = write_json(folder / f"{frame.key}.{kind}.json", record, indent=None)
            written, path = self._write_own_file(frame, image, files, folder)
            put = partial(self._put, stack.pop_all(), written, [*files.values(), path])
        if self._folder.local is not None:
            put()
            return
        with self._lock:
            self._putting.append(self._pool.submit(put))
        self._settle(_AHEAD)

    def _write_own_file(
        self, frame: Frame, image: OmniImage, files: Mapping[str, Path], folder: Path
    ) -> tuple[Frame, Path]:
        """Write ``KEY.json`` of a frame, which lists its other files; return the frame and the path."""
        entries = {}
        for kind, path in sorted(files.items()):
            entries[kind] = FileEntry.of(path)
        content = _described(image)
        if made_of := self.manifest.made_of(frame.world):
            content["made_of"] = made_of
        content["frame"] = frame.with_files(self._folder, entries).to_dict()
        path = write_json(folder / f"{frame.key}.json", content)
        entries[IMAGE] = FileEntry.of(path)
        return frame.with_files(self._folder, entries), path

    def _add_photo_sphere(self, frame: Frame, picture: Path) -> None:
        """Write Photo Sphere metadata into a frame's picture; ArgumentError if its form cannot hold any."""
        if picture.suffix[1:] not in PICTURE_SUFFIXES:
            raise ArgumentError(f"media.xmp: expected colours of 8 bits, got {picture.name}")
        fields = photo_sphere_fields(frame.camera, frame.pose, self._media["north"])
        picture.write_bytes(with_photo_sphere(picture.read_bytes(), fields))

    def _put(self, stack: ExitStack, frame: Frame, paths: Sequence[Path]) -> None:
        """Move the files of a frame into the dataset, its own last, and remove their scratch folder."""
        with stack:
            *others, last = paths
            if self._folder.local is None:
                self._folder.each(lambda path: self._folder.put(path.name, path), others)
                self._folder.put(last.name, last)
            else:
                self._move(frame, paths, self._folder.local)
        with self._lock:
            self._frames[frame.key] = frame

    def _move(self, frame: Frame, paths: Sequence[Path], local: Path) -> None:
        """Move the files of a frame into a local dataset, in place of those of the same frame that is damaged
        there; ArgumentError for files of others that have their names."""
        with lock(self._folder):
            existing = _existing(paths, local)
            if existing and frame.key not in self._keys:
                roll_back(self._folder)  # what a killed writer has left
                existing = _existing(paths, local)
            before = frame_of(self._folder, self.manifest, frame.key) if existing else None
            earlier: set[str] = set()
            if before is not None:
                earlier.update(entry.path for entry in before.entries.values())
                if not is_same(before, frame):
                    wanted = "expected a key that no other frame of the dataset has"
                    raise ArgumentError(f"key: {wanted}, got {shown(frame.key)} again, with other values")
            strange = sorted(existing - earlier)
            if strange and frame.key not in self._keys:
                raise in_the_way(self._folder, strange, f"the frame {frame.key}")
            for path in paths:
                path.replace(local / path.name)
                earlier.discard(path.name)
            for name in earlier:
                (local / name).unlink(missing_ok=True)

    def _settle(self, ahead: int = 0) -> None:
        """Wait until at most ``ahead`` frames are on their way into a store, then raise what stopped one."""
        while True:
            running = []
            finished = []
            with self._lock:
                for future in self._putting:
                    if future.done():
                        finished.append(future)
                    else:
                        running.append(future)
                if len(running) <= ahead:
                    self._putting = running
                    break
            wait(running, return_when=FIRST_COMPLETED)
        try:
            for future in finished:
                future.result()
        except BaseException:
            wait(running)
            raise

    def frames(self, keys: Iterable[str]) -> list[Frame]:
        """Return frames of the dataset by their keys, when all of their files are in it."""
        self._settle()
        return [self._frames[key] for key in keys]

    def finish(self) -> list[Frame]:
        """Write ``frames.jsonl`` of all frames in the folder, and return them in the order of their keys."""
        with self._renewed():
            pass  # cameras and names of other writers are known now
        self._settle()
        keys = []
        for name in self._folder.names():
            key = name.removesuffix(".json")
            if key != name and "." not in key and "/" not in key:
                keys.append(key)
        self.keep(keys)
        frames = self.frames(sorted(self._frames))
        with lock(self._folder):
            manifest.write_frames(self._folder, frames)
            self.close()
            tidy(self._folder)
        return frames

    def close(self) -> None:
        """Wait for files that are on their way; no more frames are written."""
        wait(self._putting)
        self._alive.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
        self.close()

    def keep(self, keys: Iterable[str]) -> None:
        """Read the frames of these keys that the dataset has; damaged ones are left out."""
        missing = [key for key in keys if key not in self._frames]
        for frame in self._folder.each(self._read, missing):
            if frame is not None:
                self._frames[frame.key] = frame

    def _read(self, key: str) -> Frame | None:
        """Return a frame of the dataset; None if it is missing or damaged, of a store if its last file is."""
        frame = self._there.get(key) or frame_of(self._folder, self.manifest, key)
        if frame is None or _damaged(frame, deep=True):
            return None
        return replace(frame, instances=self.manifest.names, classes=self.manifest.classes)

    def keep_marked(self, marked: Iterable[Frame]) -> None:
        """Take frames from the marker of a finished part, except those whose files are gone."""
        for frame in marked:
            if not _damaged(frame, deep=False):
                self._frames[frame.key] = frame

    def refuse(self, keys: Iterable[str]) -> None:
        """Refuse to write frames of these keys, as those that this run has written."""
        self._written.update(file_key(key) for key in keys)

    def _camera_name(self, camera: Camera) -> str:
        """Return the name of a camera; a new camera is named after its model."""
        for name, other in self.manifest.cameras.items():
            if other == camera:
                return name
        with self._renewed():
            known = self.manifest.cameras
            for name, other in known.items():
                if other == camera:
                    return name
            name = camera.name
            number = 0
            while name in known:
                number += 1
                name = f"{camera.name}-{number}"
            self._write_manifest(replace(self.manifest, cameras={**known, name: camera}))
            return name

    def _with_names(self, names: list[str]) -> Manifest:
        """Return the manifest with all names; it is written before any file that needs it."""
        if set(names) <= self.manifest.names.keys():
            return self.manifest
        with self._renewed():
            if new := [name for name in names if name not in self.manifest.names]:
                if self._closed:
                    wanted = "expected the objects that the dataset was begun with"
                    others = f"{len(new)} others such as {shown(new[0])}"
                    raise DatasetError(f"names: {wanted}, got {others}")
                extended = manifest.with_names(self.manifest.names, new)
                self._write_manifest(replace(self.manifest, names=extended))
            return self.manifest

    @contextmanager
    def _renewed(self) -> Iterator[None]:
        """A context of changes of the manifest, which is read anew before: other writers extend it, too."""
        with self._lock, lock(self._folder):
            self.manifest = manifest.read(self._folder)
            yield

    def _write_manifest(self, extended: Manifest) -> None:
        """Write the manifest, under its lock, and take it for that of this writer."""
        manifest.write(self._folder, extended)
        self.manifest = extended


# -- files of frames -------------------------------------------------------------------------------------


@contextmanager
def _advice() -> Iterator[None]:
    """Say in errors of an existing dataset what a program does about it."""
    try:
        yield
    except ExistingDatasetError as error:
        goes_on = "dataset.Writer(out, resume=True) goes on with it, or write elsewhere"
        raise error.advised(goes_on) from None
    except OtherDatasetError as error:
        raise error.advised("write elsewhere") from None


def is_same(written: Frame, frame: Frame) -> bool:
    """Return whether ``written``, a frame of a dataset, is the ``frame`` that is to be made.

    Files, and what is found while a frame is made, may differ.
    """
    return not frame_difference(written.to_dict(), frame.to_dict())


def _existing(paths: Sequence[Path], folder: Path) -> set[str]:
    """Return the names of files that a folder has, too."""
    return {path.name for path in paths if (folder / path.name).exists()}


def _damaged(frame: Frame, deep: bool) -> bool:
    """Return whether a local file of a frame is missing, of another size, or, ``deep``, has other bytes;
    files of a store are written whole."""
    files = frame.files
    return isinstance(files, FrameFiles) and any(files.fault(kind, deep) for kind in files)


def _described(image: OmniImage) -> dict[str, Any]:
    """Return an image's description without the source of its captures."""
    description = dict(image.description())
    description.pop("source", None)
    return description
