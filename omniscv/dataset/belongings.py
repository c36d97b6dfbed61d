"""Which files of a folder belong to its dataset: only these are deleted or replaced.

The record of a dataset lists them: ``frames.jsonl``, before it the ``KEY.json`` of each frame and
``planned.jsonl``, and the list that each export keeps. All other files there are somebody else's.
"""

import re
from collections.abc import Collection
from contextlib import suppress
from functools import cached_property, partial
from pathlib import Path

from omniscv.dataset import exported, manifest
from omniscv.dataset.manifest import DATASET, FAILED, FRAMES, PLANNED, Manifest
from omniscv.errors import DamagedFileError, DatasetError, MissingFileError
from omniscv.frame import Frame, file_endings
from omniscv.storage import Folder
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json
from omniscv.storage.local import dead_scratch
from omniscv.truth import registry as truths

SCRATCH = ".omniscv-"
"""Start of the names of folders in which frames are written."""

_MARKER = re.compile(r"parts/[0-9]+-of-[0-9]+\.json")


class Belongings:
    """The frames and files of a dataset in a folder. The record is read when they are first needed.

    Args:
        folder: of the dataset, complete or not.
        whole: its manifest.
        keys: only frames of these keys, for a part of a large dataset; all frames if not given.
    """

    def __init__(self, folder: Folder, whole: Manifest, keys: Collection[str] | None = None) -> None:
        self._folder = folder
        self._whole = whole
        self._keys = keys
        self._endings = _endings()

    @cached_property
    def frames(self) -> dict[str, Frame]:
        """The whole frames by key: those that ``frames.jsonl`` lists, and others that have their own file."""
        described = []
        keys = set()
        for name in self._names:
            keys.add(self._key_of(name))
            if _is_description(name):
                described.append(name.removesuffix(".json"))
        lost = keys.difference(described)
        frames: dict[str, Frame] = {}
        # The list is read for a part, too, if some of its frames lack their own file.
        if (self._keys is None or lost) and self._folder.exists(FRAMES):
            with suppress(DatasetError):  # a damaged list: each frame has its own file
                for frame in manifest.read_frames(self._folder, self._whole):
                    frames[frame.key] = frame
        others = [key for key in described if key not in frames]
        for other in self._folder.each(partial(frame_of, self._folder, self._whole), others):
            if other is not None:
                frames[other.key] = other
        return frames

    @cached_property
    def begun(self) -> frozenset[str]:
        """The keys of frames that were planned or have failed: some of their files may exist."""
        keys = {frame.key for frame in manifest.read_planned(self._folder, self._whole)}
        with suppress(DatasetError):
            for line in manifest.read_failed(self._folder):
                keys.add(str(line["key"]))
        return frozenset(keys)

    def files(self) -> list[str]:
        """Return the names of the files of the dataset, but for exports and ``dataset.json``."""
        return list(filter(self._is_own, self._names))

    def exported(self) -> list[str]:
        """Return the names of the files of its exports."""
        return exported.files_of_exports(self._folder, self._whole, list(self.frames.values()))

    def strange(self, keys: Collection[str]) -> list[str]:
        """Return files of somebody else that have names of files of frames of some keys.

        In a store, an interrupted writer leaves files without the last one of their frame, and nothing else
        says whose they are. So there only files that would be that last one are taken for somebody else's.
        """
        strange = []
        for name in self._names:
            if self._folder.local is None and not _is_description(name):
                continue
            if self._key_of(name) in keys and not self._is_own(name):
                strange.append(name)
        return strange

    @cached_property
    def _names(self) -> list[str]:
        """The names of all files, or of those of the frames in question."""
        if self._keys is None:
            return self._folder.names()
        endings = [".json"] if self._folder.local is None else sorted(self._endings)
        possible = []
        for key in self._keys:
            for ending in endings:
                possible.append(f"{key}{ending}")
        names = []
        for name, exists in zip(possible, self._folder.each(self._folder.exists, possible), strict=True):
            if exists:
                names.append(name)
        return names

    def _is_own(self, name: str) -> bool:
        if is_listing(name):
            return True
        key = self._key_of(name)
        frame = self.frames.get(key)
        if frame is not None and name in {entry.path for entry in frame.entries.values()}:
            return True
        return bool(key) and key in self.begun

    def _key_of(self, name: str) -> str:
        return _key_of(name, self._endings)


def frame_of(folder: Folder, whole: Manifest, key: str) -> Frame | None:
    """Return the frame that ``KEY.json`` in the folder of a dataset describes.

    Args:
        folder: of the dataset.
        whole: its manifest.
        key: of the frame.

    Returns:
        None if the file is missing, damaged, or somebody else's.
    """
    name = f"{key}.json"
    try:
        return whole.frame_of_file(name, folder.read(name, MOST_JSON_BYTES), folder)
    except (DatasetError, DamagedFileError, MissingFileError):
        return None


def is_listing(name: str) -> bool:
    """Return whether a file has a name of those that list the frames of a dataset, or of its parts."""
    return name in (FRAMES, FAILED, PLANNED) or is_marker(name)


def is_marker(name: str) -> bool:
    """Return whether a file has the name of the marker of a finished part."""
    return _MARKER.fullmatch(name) is not None


def _is_description(name: str) -> bool:
    """Return whether a file may be the ``KEY.json`` of a frame, by its name."""
    return "/" not in name and name.partition(".")[2] == "json" and name != DATASET


def _key_of(name: str, endings: Collection[str]) -> str:
    """Return the key of the frame that a file may be of, by its name; empty for other names."""
    key, dot, ending = name.partition(".")
    return key if "/" not in key and f"{dot}{ending}" in endings and name != DATASET else ""


def _endings() -> frozenset[str]:
    """Return how the names of files of frames may go on after the key."""
    endings = file_endings(truths.kinds())
    return frozenset().union(*endings.values())


def roll_back(folder: Folder) -> None:
    """Remove the files of frames that killed writers have moved in part into a local folder.

    The scratch folder of such a writer still holds ``KEY.json``, a frame's last file, which lists the others.
    Call it under the lock of the folder.
    """
    if folder.local is None:
        return
    endings = _endings()
    for scratch in dead_scratch(folder.local, SCRATCH):
        for path in scratch.glob("*.json"):
            if _key_of(path.name, endings) == path.stem and not (folder.local / path.name).exists():
                for name in _listed_by(path, endings):
                    (folder.local / name).unlink(missing_ok=True)


def _listed_by(path: Path, endings: Collection[str]) -> set[str]:
    """Return the names of the other files that a ``KEY.json`` lists, of its own key only."""
    try:
        frame = parse_json(path.read_bytes())["frame"]
        names = {str(entry["path"]) for entry in frame["files"].values()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return set()
    return {name for name in names if _key_of(name, endings) == path.stem}
