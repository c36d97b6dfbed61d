"""WebDataset shards: ``SPLIT-000000.tar`` and ``shards.json``, their contents with checksums.

A member is named as the file in the dataset, ``KEY.KIND.SUFFIX``; members of one key follow each other. Equal
frames make equal shards: USTAR, sorted members, no times, no owners. Frames without a split are in
``frames-000000.tar``.
"""

import tarfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from omniscv import storage
from omniscv.arguments import shown, whole_number
from omniscv.compose.files import write_json
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.manifest import Manifest, read_cameras, read_names
from omniscv.errors import ArgumentError, DatasetError, OmniscvError
from omniscv.frame import FileEntry, Frame
from omniscv.records import checked, record
from omniscv.storage import Folder
from omniscv.storage.base import MOST_BYTES
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json
from omniscv.storage.local import whole_file

SHARDS = "shards.json"
_LONGEST_NAME = 100


@record
class WebDatasetOptions:
    """Options of the format."""

    max_count: int = checked(whole_number, least=1, default=1000, help="frames in a shard")
    max_bytes: int = checked(
        whole_number,
        least=1,
        default=10**9,
        help="bytes of members in a shard; a larger frame has a shard of its own",
    )


@register
class WebDataset(Format):
    """See the module."""

    name = "webdataset"
    options = WebDatasetOptions

    def write(self, frames: Sequence[Frame], out: Path, options: WebDatasetOptions) -> list[Path]:
        """Write shards of ``frames`` and their list into ``out``, as large as ``options`` allow."""
        by_split: dict[str, list[Frame]] = {}
        for frame in sorted(frames, key=lambda frame: frame.key):
            by_split.setdefault(frame.split or "frames", []).append(frame)
        written = []
        shards = []
        for split, of_split in sorted(by_split.items()):
            for number, shard in enumerate(_shards(of_split, options)):
                path = out / f"{split}-{number:06d}.tar"
                _write_tar(path, shard)
                entry = FileEntry.of(path)
                keys = [frame.key for frame in shard]
                shards.append({"path": path.name, "bytes": entry.bytes, "sha256": entry.sha256, "keys": keys})
                written.append(path)
        return [*written, write_json(out / SHARDS, {"shards": shards, **_common(frames)})]

    def check(self, frames: Sequence[Frame], out: Path) -> list[str]:
        """Return a line for each shard in ``out`` that is missing or damaged, and each of ``frames`` in no
        shard."""
        try:
            _, shards = read_list(storage.folder(out))
        except OmniscvError as damaged:
            return [damaged.message.removeprefix(f"{out}/")]
        faults = []
        keys: set[str] = set()
        for entry, keys_of_shard in shards.items():
            keys.update(keys_of_shard)
            if fault := entry.fault(out):
                faults.append(f"{entry.path}: {fault}")
        for frame in frames:
            if frame.key not in keys:
                faults.append(f"{SHARDS}: expected a shard with {frame.key}, got none")
        return faults


def _shards(frames: Sequence[Frame], limits: WebDatasetOptions) -> Iterator[list[Frame]]:
    shard = list[Frame]()
    size = 0
    for frame in frames:
        added = sum(path.stat().st_size for path in frame.files.values())
        if shard and (len(shard) == limits.max_count or size + added > limits.max_bytes):
            yield shard
            shard = []
            size = 0
        shard.append(frame)
        size += added
    if shard:
        yield shard


def _write_tar(path: Path, frames: Sequence[Frame]) -> None:
    with whole_file(path) as part, tarfile.open(part, "w", format=tarfile.USTAR_FORMAT) as tar:
        for frame in frames:
            for file in sorted(frame.files.values(), key=lambda file: file.name):
                if len(file.name.encode()) > _LONGEST_NAME:
                    wanted = f"expected names of files of at most {_LONGEST_NAME} bytes, as USTAR has"
                    raise ArgumentError(f"{wanted}, got {shown(file.name)}; shorten the camera's name")
                member = tarfile.TarInfo(file.name)  # no time, no owner, mode 644
                with file.open("rb") as content:
                    member.size = file.stat().st_size
                    tar.addfile(member, content)


def _common(frames: Sequence[Frame]) -> dict[str, Any]:
    """The cameras of the frames, and the ids of objects and of classes."""
    cameras = {}
    for frame in frames:
        cameras[frame.camera_name] = frame.camera.to_dict()
    names: dict[str, int] = {}
    classes: dict[str, int] = {}
    if frames:  # all share names and classes
        names.update(frames[0].instances)
        if frames[0].classes is not None:
            for category in frames[0].classes.classes.values():
                classes[category.name] = category.id
    return {"cameras": cameras, "names": names, "classes": classes}


def read_list(folder: Folder) -> tuple[Manifest, dict[FileEntry, tuple[str, ...]]]:
    """Return the cameras and names of ``shards.json``, and by shard the keys of its samples."""
    if not folder.exists(SHARDS):
        advice = "write it by 'omniscv dataset pack DIR --as webdataset --out FOLDER'"
        raise ArgumentError(f"{folder}: expected a folder of shards, it has no {SHARDS}; {advice}")
    try:
        content = parse_json(folder.read(SHARDS, MOST_BYTES), MOST_BYTES)
        shards = {}
        for shard in content["shards"]:
            entry = FileEntry(shard["path"], shard["bytes"], shard["sha256"])
            shards[entry] = tuple(map(str, shard["keys"]))
        cameras = read_cameras(content["cameras"])
        names = read_names(content["names"])
        return Manifest(cameras, names, versions={}), shards
    except (ValueError, TypeError, KeyError, AttributeError) as cause:
        raise DatasetError(f"{folder}/{SHARDS}: expected a list of shards, got: {cause}") from cause


class Shard:
    """An open shard.

    Args:
        folder: in which the shard is.
        file: its entry in the list of shards.
        manifest: the cameras and names of its frames.

    Raises:
        DatasetError: it has another size, is no tar file, or holds anything but files, or it is missing in a
            local folder.
        MissingFileError: it is missing in a store.
    """

    def __init__(self, folder: Folder, file: FileEntry, manifest: Manifest) -> None:
        self._manifest = manifest
        if folder.local is None:
            self._path = folder.fetch(file.path, file.sha256, file.bytes)
        else:
            self._path = folder.local / file.path
        if fault := file.fault(self._path.parent, deep=False):
            raise DatasetError(f"{self._path}: {fault}")
        try:
            with ExitStack() as opened:
                self._tar = opened.enter_context(tarfile.open(self._path, "r:"))
                self._members = {member.name: member for member in self._files()}
                opened.pop_all()  # close() closes it
        except (OSError, tarfile.TarError, ValueError, RecursionError) as cause:
            raise DatasetError(f"{self._path}: expected a shard, got: {cause}") from cause

    def _files(self) -> Iterator[tarfile.TarInfo]:
        """Yield the members; DatasetError for a link, a device, a sparse file, or a size that leads back."""
        for member in self._tar:
            if not member.isreg() or member.issparse() or member.size < 0:
                raise DatasetError(f"{self._path}: expected files of samples, got {shown(member.name)}")
            yield member

    def close(self) -> None:
        """Close its file."""
        self._tar.close()

    def extract(self, key: str, kinds: Sequence[str], folder: Path) -> Frame:
        """Write files of the sample ``key`` into a ``folder``, and return their frame.

        Files are those of ``kinds`` that the sample has. DatasetError: the shard lacks the sample, or a file
        is damaged.
        """
        name = f"{key}.json"
        if name not in self._members:
            wanted = f"expected the sample {shown(key)}, it has none"
            raise DatasetError(f"{self._path}: {wanted}; pack the dataset again")
        try:
            content = self._read(name, MOST_JSON_BYTES)
            frame = self._manifest.frame_of_file(name, content, storage.folder(folder))
            entries = {}
            for kind in kinds:
                entry = frame.entries.get(kind)
                if entry is not None and entry.path in self._members:
                    entries[kind] = entry
                    (folder / entry.path).write_bytes(self._read(entry.path, entry.bytes))
            frame = frame.with_files(storage.folder(folder), entries)
            for kind in frame.files:
                frame.files[kind]  # checks it
        except DatasetError as fault:
            raise DatasetError(f"{self._path}: {fault.message.removeprefix(f'{folder}/')}") from fault
        return frame

    def _read(self, name: str, most: int) -> bytes:
        content = self._tar.extractfile(self._members[name])
        if content is None or self._members[name].size > most:
            raise DatasetError(f"{name}: expected at most {most} bytes, got {self._members[name].size}")
        return content.read(most)
