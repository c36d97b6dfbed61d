"""The files of a frame, checked where they are read: the one border between a dataset and its readers.

So what makes, checks, exports, packs, shows and loads frames reads the same bytes or raises the same
:class:`~omniscv.errors.DatasetError`.
"""

import hashlib
import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path
from typing import Any, Self

from omniscv import modalities, plugins
from omniscv.arguments import shown, text, whole_number, within
from omniscv.compose.files import check_header, formats
from omniscv.errors import ArgumentError, DatasetError, MissingFileError
from omniscv.pictures.forms import ARRAY
from omniscv.storage import Folder
from omniscv.storage.bounded import MOST_JSON_BYTES, open_regular

_SHA256 = re.compile("[0-9a-f]{64}")
_MOST_PIXEL_BYTES = 32

Size = tuple[int, int]
"""Width and height, px."""

IMAGE = "image"
"""The kind of ``STEM.json`` among the files of a frame."""


@dataclass(frozen=True)
class FileEntry:
    """A file of a frame, as the manifest lists it.

    Attributes:
        path: its name in the dataset's folder.
        bytes: its size.
        sha256: of its bytes, 64 lower-case hexadecimal digits: the cache of stores names folders by it.
    """

    path: str
    bytes: int
    sha256: str

    def __post_init__(self) -> None:
        name = self.path
        if not isinstance(name, str) or name != os.path.basename(name) or name.startswith("."):
            raise ArgumentError(f"path: expected the name of a file of the dataset, got {shown(self.path)}")
        text("path", self.path)
        whole_number("bytes", self.bytes, least=0)
        if not isinstance(self.sha256, str) or not _SHA256.fullmatch(self.sha256):
            raise ArgumentError(f"sha256: expected 64 hexadecimal digits, got {shown(self.sha256)}")

    @classmethod
    def of(cls, path: Path) -> Self:
        """Return the entry of a file as it is."""
        with path.open("rb") as file:
            return cls(path.name, os.fstat(file.fileno()).st_size, _checksum(file))

    def fault(self, folder: Path, deep: bool = True) -> str | None:
        """Return what is wrong with the file in the dataset's local folder, in a few words; None if nothing
        is. Its bytes are read only if ``deep``."""
        try:
            with open_regular(folder / self.path, links=False) as file:
                if (size := os.fstat(file.fileno()).st_size) != self.bytes:
                    return f"expected {self.bytes} bytes, got {size}"
                if deep and _checksum(file) != self.sha256:
                    return "expected the bytes of its checksum, got other ones"
        except FileNotFoundError:
            return "expected a file, it is missing"
        except ArgumentError as fault:
            return fault.message
        return None


def read_entries(
    key: str, size: Size, files: Mapping[str, Any], endings: Mapping[str, Collection[str]]
) -> dict[str, FileEntry]:
    """Return the files that the line of a frame lists, by kind.

    Args:
        key: of the frame.
        size: of its camera's images, width and height, px.
        files: as listed, by kind.
        endings: how names go on after the key, by kind: see :func:`file_endings`.

    Raises:
        ArgumentError: another kind or name, or a file larger than such a file can be.
    """
    most = MOST_JSON_BYTES + _MOST_PIXEL_BYTES * size[0] * size[1]
    entries = {}
    for kind, values in files.items():
        entry = FileEntry(**values)
        entries[kind] = entry
        if entry.path not in [key + ending for ending in endings.get(kind, ())]:
            wanted = f"expected the name {key}.KIND.SUFFIX of a layer or record, of {', '.join(endings)}"
            raise ArgumentError(f"{key}: files.{shown(kind)}: {wanted}; got {shown(entry.path)}")
        if entry.bytes > most:
            raise ArgumentError(f"{entry.path}: expected at most {most} bytes, got {entry.bytes}")
    return entries


def file_endings(records: Iterable[str]) -> dict[str, frozenset[str]]:
    """Return, by the kinds of files that a frame may have, how their names go on after its key.

    Layers are pictures or arrays, all else, as the kinds of records, is JSON: loaders choose what to do with
    a file by its suffix, and for some they run what it holds.
    """
    plugins.load()
    suffixes = (*formats(), ARRAY)
    endings = {}
    for row in modalities.layers():
        endings[row.name] = frozenset(f".{row.name}.{suffix}" for suffix in suffixes)
    for kind in records:
        endings[kind] = frozenset([f".{kind}.json"])
    endings[IMAGE] = frozenset([".json"])
    return endings


def _checksum(file: BufferedReader) -> str:
    return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True, eq=False)
class ImageFiles(Mapping[str, Path]):
    """The files of an image by kind; access checks that one is a regular file, and of a layer a picture of
    the camera's size.

    Attributes:
        entries: paths by kind.
        size: of the camera's images.
    """

    entries: Mapping[str, Any]
    size: Size

    def __contains__(self, kind: object) -> bool:
        return kind in self.entries

    def __iter__(self) -> Iterator[str]:
        return iter(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, kind: str) -> Path:
        """Return the path of a file; ArgumentError if it is none."""
        path: Path = self.entries[kind]
        with within(path):
            try:
                open_regular(path, links=False).close()
            except OSError as fault:
                raise ArgumentError(f"expected a file, got: {fault.strerror}") from fault
            wrong = _layer_fault(path, kind, self.size)
            if wrong:
                raise ArgumentError(wrong)
        return path


@dataclass(frozen=True, eq=False)
class FrameFiles(ImageFiles):
    """The files of a frame of a dataset by kind: paths in a local folder, or of copies of a store's files.

    Access also compares a file with its size and checksum in the manifest, once; DatasetError if it differs.

    Attributes:
        entries: the manifest's entries by kind.
        size: of the camera's images.
        folder: of the dataset.
        stand_in: a local folder that stands for that of a store while an export below it is written.
    """

    entries: Mapping[str, FileEntry]
    folder: Folder
    stand_in: Path | None = None
    _checked: set[str] = field(default_factory=set, repr=False)  # shared by copies of the record

    def __getitem__(self, kind: str) -> Path:
        entry = self.entries[kind]
        if self.folder.local is None:
            try:  # compared with its checksum each time: others use the cache, too
                path = self.folder.fetch(entry.path, entry.sha256, entry.bytes)
            except MissingFileError as fault:
                raise DatasetError(str(fault)) from fault
            wrong = None if kind in self._checked else _layer_fault(path, kind, self.size)
        else:
            path = self.folder.local / entry.path
            wrong = self.fault(kind)
        if wrong:
            raise DatasetError(f"{self.folder}/{entry.path}: {wrong}")
        self._checked.add(kind)
        return path

    def fault(self, kind: str, deep: bool = True) -> str | None:
        """Return what is wrong with a file of a ``kind`` in a local folder; ``deep`` also reads its content.

        See :meth:`FileEntry.fault`.
        """
        local = self.folder.local
        entry = self.entries[kind]
        if local is None or (deep and kind in self._checked):
            return None
        wrong = entry.fault(local, deep)
        return _layer_fault(local / entry.path, kind, self.size) if deep and wrong is None else wrong

    def reference(self, kind: str, out: Path) -> str:
        """Return the name of a local file, which is checked, as seen from the folder ``out``; of a store the
        file's URL, unless it has a stand-in. ``kind`` is the file's."""
        if self.folder.local is not None:
            return relative(self[kind], out)
        name = self.entries[kind].path
        if self.stand_in is None or self.stand_in not in out.parents:
            return f"{self.folder}/{name}"
        return relative(self.stand_in / name, out)


def _layer_fault(path: Path, kind: str, size: Size) -> str | None:
    """Return how a layer's file differs from a picture of the layer in the camera's size; None if it does
    not, or is no layer's."""
    if kind not in {row.name for row in modalities.layers()}:
        return None
    try:
        check_header(path, kind, size)
    except ArgumentError as fault:
        return fault.message
    return None


def relative(file: Path, out: Path) -> str:
    """Return the name of a file as seen from the folder ``out``."""
    return Path(os.path.relpath(file, out)).as_posix()
