"""What a dataset holds, counted."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from omniscv import storage
from omniscv.dataset import manifest
from omniscv.storage import Folder


def info(out: str | Path | Folder) -> dict[str, Any]:
    """Return counts of a dataset: frames, cameras, splits, places, objects, classes, bytes by kind of file.

    Raises:
        ArgumentError: no dataset is there.
        DatasetError: its manifest is damaged.
    """
    folder = storage.folder(out)
    whole = manifest.read(folder)
    there = set(folder.names())
    complete = manifest.FRAMES in there
    frames = manifest.read_frames(folder, whole) if complete else []
    sizes: Counter[str] = Counter()
    missing: Counter[str] = Counter()
    for frame in frames:
        for kind, file in frame.entries.items():
            sizes[kind] += file.bytes
            missing[kind] += file.path not in there
    classes = whole.classes
    objects = Counter() if classes is None else Counter(classes.of_object.values())
    return {
        "complete": complete,
        "frames": len(frames),
        "cameras": dict(Counter(frame.camera_name for frame in frames)),
        "splits": dict(sorted(Counter(frame.split for frame in frames if frame.split).items())),
        "places": len({frame.place for frame in frames if frame.place}),
        "objects": len(whole.names),
        "taxonomy": None if classes is None else classes.taxonomy,
        "classes": {} if classes is None else {name: objects[name] for name in classes.classes},
        "exports": [each["out"] for each in whole.settings["exports"]],
        "bytes": dict(sorted(sizes.items())),
        "missing": {kind: count for kind, count in sorted(missing.items()) if count},
        "versions": dict(whole.versions),
    }
