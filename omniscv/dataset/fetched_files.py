"""The files of a frame, by kind: where they lie, or fetched when they are used."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from omniscv.dataset.manifest import FileEntry, FrameEntry
from omniscv.storage import Folder


@dataclass(frozen=True, eq=False)
class FetchedFiles(Mapping[str, Path]):
    """Local copies of the files of a frame: each is fetched, and checked, when it is looked up.

    Attributes:
        folder: of the dataset.
        entries: the files by kind.
        place: a local folder that stands for the dataset's while an export below it is written.
    """

    folder: Folder
    entries: Mapping[str, FileEntry]
    place: Path | None = None

    def __getitem__(self, kind: str) -> Path:
        entry = self.entries[kind]
        return self.folder.fetch(entry.path, entry.sha256)

    def __contains__(self, kind: object) -> bool:
        return kind in self.entries

    def __iter__(self) -> Iterator[str]:
        return iter(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def reference(self, kind: str, out: Path) -> str:
        """Return the name of a file as seen from a folder below ``place``; elsewhere its URL."""
        name = self.entries[kind].path
        if self.place is None or self.place not in out.parents:
            return f"{self.folder}/{name}"
        return _seen_from(out, self.place / name)


def files_of(folder: Folder, entry: FrameEntry) -> Mapping[str, Path]:
    """Return the files of a frame in the folder of its dataset, by kind."""
    if folder.local is None:
        return FetchedFiles(folder, entry.files)
    return {kind: folder.local / file.path for kind, file in entry.files.items()}


def reference(files: Mapping[str, Path], kind: str, out: Path) -> str:
    """Return how a file in a folder names a file of a frame."""
    return files.reference(kind, out) if isinstance(files, FetchedFiles) else _seen_from(out, files[kind])


def _seen_from(out: Path, file: Path) -> str:
    return Path(os.path.relpath(file, out)).as_posix()
