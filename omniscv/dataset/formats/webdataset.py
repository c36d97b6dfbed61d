"""WebDataset shards: ``SPLIT-000000.tar`` and ``shards.json``, what is in them with checksums.

A member is named as the file in the dataset, ``KEY.KIND.SUFFIX``; those of one key follow each other. Equal
frames make equal shards: USTAR, sorted members, no times, no owners. Frames without a split are in
``frames-000000.tar``. Options: ``max_count`` frames and ``max_bytes`` of members in a shard (1000, 10^9); a
frame that is larger has a shard of its own.
"""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from omniscv.arguments import fields, whole_number
from omniscv.cameras import Camera
from omniscv.compose.files import write_json
from omniscv.errors import ArgumentError
from omniscv.frame import FileEntry, Frame
from omniscv.storage.local import whole_file

name = "webdataset"

SHARDS = "shards.json"
_COUNT, _BYTES = 1000, 10**9


def refuses(camera: Camera) -> None:
    """Return None: shards hold files as they are."""


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for a wrong option."""
    _bounds(options)


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the shards.

    Raises:
        ArgumentError: a wrong option, or a key with a dot, where WebDataset would end it.
    """
    max_count, max_bytes = _bounds(options)
    out.mkdir(parents=True, exist_ok=True)
    by_split: dict[str, list[Frame]] = {}
    for frame in sorted(frames, key=lambda frame: frame.key):
        if "." in frame.key:
            raise ArgumentError(f"key: expected one without a dot, which ends it, got {frame.key!r}")
        by_split.setdefault(frame.split or "frames", []).append(frame)
    written, listed = [], []
    for split, mine in sorted(by_split.items()):
        for number, part in enumerate(_shards(mine, max_count, max_bytes)):
            path = out / f"{split}-{number:06d}.tar"
            _write_tar(path, part)
            entry = FileEntry.of(path)
            keys = [frame.key for frame in part]
            listed.append({"path": path.name, "bytes": entry.bytes, "sha256": entry.sha256, "keys": keys})
            written.append(path)
    return [*written, write_json(out / SHARDS, {"shards": listed, **_shared(frames)})]


def check(frames: Sequence[Frame], out: Path) -> list[str]:
    """Return a line for each shard that is missing or not as it was written, and each frame in none."""
    try:
        listed = json.loads((out / SHARDS).read_bytes())["shards"]
        entries = [FileEntry(each["path"], each["bytes"], each["sha256"]) for each in listed]
        held = {key for each in listed for key in each["keys"]}
    except (OSError, ValueError, TypeError, KeyError) as cause:
        return [f"{SHARDS}: expected a list of shards, got: {cause}"]
    faults = [f"{entry.path}: {fault}" for entry in entries if (fault := entry.fault(out))]
    missing = [frame.key for frame in frames if frame.key not in held]
    return faults + [f"{SHARDS}: expected a shard with {key}, got none" for key in missing]


def _bounds(options: Mapping[str, Any]) -> tuple[int, int]:
    count = partial(whole_number, least=1)
    given = fields(name, options, {"max_count": count, "max_bytes": count})
    return given.get("max_count", _COUNT), given.get("max_bytes", _BYTES)


def _shards(frames: Sequence[Frame], max_count: int, max_bytes: int) -> Iterator[list[Frame]]:
    shard: list[Frame] = []
    size = 0
    for frame in frames:
        own = sum(path.stat().st_size for path in frame.files.values())
        if shard and (len(shard) == max_count or size + own > max_bytes):
            yield shard
            shard, size = [], 0
        shard.append(frame)
        size += own
    if shard:
        yield shard


def _write_tar(path: Path, frames: Sequence[Frame]) -> None:
    with whole_file(path) as part, tarfile.open(part, "w", format=tarfile.USTAR_FORMAT) as tar:
        for frame in frames:
            for file in sorted(frame.files.values(), key=lambda file: file.name):
                member = tarfile.TarInfo(file.name)  # no time, no owner, mode 644
                with file.open("rb") as content:
                    member.size = file.stat().st_size
                    tar.addfile(member, content)


def _shared(frames: Sequence[Frame]) -> dict[str, Any]:
    """What all frames share: their cameras, the ids of objects and of classes."""
    if not frames:
        return {"cameras": {}, "names": {}, "classes": {}}
    classes = frames[0].classes
    return {
        "cameras": {frame.camera_name: frame.camera.to_dict() for frame in frames},
        "names": dict(frames[0].instances),
        "classes": {} if classes is None else {each.name: each.id for each in classes.classes.values()},
    }
