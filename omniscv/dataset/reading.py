"""Frames of a dataset that is there."""

from __future__ import annotations

from pathlib import Path

from omniscv import storage
from omniscv.dataset import manifest
from omniscv.dataset.fetched_files import files_of
from omniscv.dataset.frames import Frame
from omniscv.dataset.manifest import FrameEntry, Manifest
from omniscv.errors import DatasetError
from omniscv.storage import Folder


def open(out: str | Path | Folder) -> tuple[Frame, ...]:
    """Return the frames of a dataset in the order of their keys; their files are read when they are used.

    Args:
        out: its folder, by path or URL. Files of a URL are fetched when they are used, once, into the local
            cache, and compared with their checksums.

    Raises:
        ArgumentError: no dataset is there.
        DatasetError: it is not complete, or its manifest is damaged.
    """
    folder = storage.folder(out)
    whole = manifest.read(folder)
    return tuple(frame(folder, whole, entry) for entry in manifest.read_frames(folder))


def frame(folder: Folder, whole: Manifest, entry: FrameEntry) -> Frame:
    """Return a frame of a dataset's folder from its line.

    Raises:
        DatasetError: the manifest does not have its camera.
    """
    if entry.camera not in whole.cameras:
        known = ", ".join(whole.cameras)
        raise DatasetError(f"{entry.key}: expected one of the cameras {known}; got {entry.camera!r}")
    return Frame(
        key=entry.key,
        camera_name=entry.camera,
        camera=whole.cameras[entry.camera],
        pose=entry.pose,
        files=files_of(folder, entry),
        instances=whole.names,
        classes=whole.classes,
        time=entry.time,
        place=entry.place,
        split=entry.split,
        scene=entry.scene,
        state=entry.state,
    )
