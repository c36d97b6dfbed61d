"""WebDataset shards: ``SPLIT-000000.tar`` and ``shards.json``, their contents with checksums.

A member is named as the file in the dataset, ``KEY.KIND.SUFFIX``; members of one key follow each other. Equal
frames make equal shards: USTAR, sorted members, no times, no owners. Frames without a split are in
``frames-000000.tar``.
"""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from omniscv.arguments import whole_number
from omniscv.compose.files import write_json
from omniscv.dataset.registry import Format, register
from omniscv.errors import ArgumentError
from omniscv.frame import FileEntry, Frame
from omniscv.records import checked, record
from omniscv.storage.local import whole_file

SHARDS = "shards.json"


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


class WebDataset(Format):
    """See the module."""

    name = "webdataset"
    options = WebDatasetOptions

    def write(self, frames: Sequence[Frame], out: Path, options: WebDatasetOptions) -> list[Path]:
        """Write the shards; ArgumentError for a key with a dot, where WebDataset would end it."""
        out.mkdir(parents=True, exist_ok=True)
        by_split: dict[str, list[Frame]] = {}
        for frame in sorted(frames, key=lambda frame: frame.key):
            if "." in frame.key:
                raise ArgumentError(f"key: expected one without a dot, which ends it, got {frame.key!r}")
            by_split.setdefault(frame.split or "frames", []).append(frame)
        written, shards = [], []
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
        """Return a line for each shard that is missing or damaged, and each frame in none."""
        try:
            shards = json.loads((out / SHARDS).read_bytes())["shards"]
            entries = [FileEntry(shard["path"], shard["bytes"], shard["sha256"]) for shard in shards]
            keys = {key for shard in shards for key in shard["keys"]}
        except (OSError, ValueError, TypeError, KeyError) as cause:
            return [f"{SHARDS}: expected a list of shards, got: {cause}"]
        faults = [f"{entry.path}: {fault}" for entry in entries if (fault := entry.fault(out))]
        missing = [frame.key for frame in frames if frame.key not in keys]
        return faults + [f"{SHARDS}: expected a shard with {key}, got none" for key in missing]


def _shards(frames: Sequence[Frame], limits: WebDatasetOptions) -> Iterator[list[Frame]]:
    shard: list[Frame] = []
    size = 0
    for frame in frames:
        added = sum(path.stat().st_size for path in frame.files.values())
        if shard and (len(shard) == limits.max_count or size + added > limits.max_bytes):
            yield shard
            shard, size = [], 0
        shard.append(frame)
        size += added
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


def _common(frames: Sequence[Frame]) -> dict[str, Any]:
    """The cameras of the frames, and the ids of objects and of classes."""
    if not frames:
        return {"cameras": {}, "names": {}, "classes": {}}
    classes = frames[0].classes
    return {
        "cameras": {frame.camera_name: frame.camera.to_dict() for frame in frames},
        "names": dict(frames[0].instances),
        "classes": {} if classes is None else {row.name: row.id for row in classes.classes.values()},
    }


register(WebDataset())
