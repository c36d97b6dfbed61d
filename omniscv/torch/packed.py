"""What lies in WebDataset shards: the samples of one, by the headers of its members."""

from __future__ import annotations

import json
import tarfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from omniscv import storage
from omniscv.cameras import Camera, from_dict
from omniscv.dataset import Frame
from omniscv.dataset.formats.webdataset import SHARDS
from omniscv.dataset.manifest import IMAGE, Manifest
from omniscv.errors import ArgumentError, DatasetError
from omniscv.frame import FileEntry

_RECORDS = "truth", "layout"


@dataclass(frozen=True, eq=False)
class Packed:
    """What ``shards.json`` holds.

    Attributes:
        folder: with the shards.
        shards: each one's file and the keys of its samples.
        cameras: by name.
        names: object name to instance id.
    """

    folder: Path
    shards: tuple[tuple[FileEntry, tuple[str, ...]], ...]
    cameras: Mapping[str, Camera]
    names: Mapping[str, int]

    @classmethod
    def read(cls, folder: Path) -> Packed:
        """Read it.

        Raises:
            ArgumentError: the folder has none.
            DatasetError: it is damaged.
        """
        path = folder / SHARDS
        if not path.is_file():
            advice = "write it by 'omniscv dataset pack DIR --as webdataset --out FOLDER'"
            raise ArgumentError(f"{folder}: expected a folder of shards, it has no {SHARDS}; {advice}")
        try:
            said = json.loads(path.read_bytes())
            shards = tuple(
                (FileEntry(each["path"], each["bytes"], each["sha256"]), tuple(map(str, each["keys"])))
                for each in said["shards"]
            )
            cameras = {name: from_dict(each) for name, each in said["cameras"].items()}
            return cls(folder, shards, cameras, dict(said["names"]))
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as cause:
            raise DatasetError(f"{path}: expected a list of shards, got: {cause}") from cause


class Shard:
    """An open shard.

    Args:
        packed: what it is one of.
        file: what it should be.

    Raises:
        DatasetError: it is missing, has another size, or is no tar file.
    """

    def __init__(self, packed: Packed, file: FileEntry) -> None:
        self._packed, self._path = packed, packed.folder / file.path
        if fault := file.fault(packed.folder, deep=False):
            raise DatasetError(f"{self._path}: {fault}")
        self._members: dict[str, dict[str, tarfile.TarInfo]] = defaultdict(dict)
        try:
            self._tar = tarfile.open(self._path, "r:")  # noqa: SIM115, closed by close()
            for member in self._tar.getmembers():
                key, _, rest = member.name.partition(".")
                self._members[key][rest.partition(".")[0] if "." in rest else IMAGE] = member
        except (OSError, tarfile.TarError) as cause:
            raise DatasetError(f"{self._path}: expected a shard, got: {cause}") from cause

    def close(self) -> None:
        """Close its file."""
        self._tar.close()

    def extract(self, key: str, layers: Sequence[str], folder: Path) -> Frame:
        """Write files of a sample into a folder, and return the frame that they are.

        Args:
            key: of the sample.
            layers: those of its layers that are read, as far as it has them.
            folder: holds the files as long as the frame is used.

        Raises:
            DatasetError: the shard lacks the sample, or a file is not what it was.
        """
        held = self._members.get(key, {})
        if IMAGE not in held:
            raise DatasetError(
                f"{self._path}: expected the sample {key}, it has none; pack the dataset again"
            )
        image = self._extract(held[IMAGE], folder)
        manifest = Manifest(self._packed.cameras, self._packed.names, versions={})
        frame = manifest.frame_of_file(image.name, image.read_bytes(), storage.folder(folder))
        files = {}
        for kind in held.keys() & frame.entries.keys() & {*layers, *_RECORDS}:
            files[kind] = self._extract(held[kind], folder)
            if fault := frame.entries[kind].fault(folder):
                raise DatasetError(f"{self._path}: {files[kind].name}: {fault}")
        return replace(frame, files=files)

    def _extract(self, member: tarfile.TarInfo, folder: Path) -> Path:
        content = self._tar.extractfile(member)
        if content is None or member.name != Path(member.name).name:
            raise DatasetError(f"{self._path}: expected files of samples, got {member.name!r}")
        path = folder / member.name
        path.write_bytes(content.read())
        return path
