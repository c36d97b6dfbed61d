"""What files in the form of COCO have in common: entries of images, categories and annotations."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.frame import Frame
from omniscv.storage.local import whole_file
from omniscv.truth import rle
from omniscv.truth.classes import SemanticClass
from omniscv.truth.object_boxes import boxes

_FROM_TRUTH = {
    "boxes": {"distance": "distance", "truncated": "truncated"},
    "bfov": {"bfov": "bfov", "rbfov": "rbfov"},
    "amodal": {"visib_fract": "visib_fract", "px_all": "area_amodal", "bbox": "bbox_amodal"},
}
"""By truth, the fields of its records and what annotations call them."""


def image_entry(frame: Frame, number: int, out: Path) -> dict[str, Any]:
    """Return the entry of ``images`` of a frame, whose file is named as seen from a folder."""
    name = frame.reference("lit" if "lit" in frame.files else "labels", out)
    camera = frame.camera
    found: dict[str, Any] = {"id": number, "file_name": name}
    found |= {"width": camera.width, "height": camera.height, "key": frame.key}
    found |= {"camera": camera.to_dict(), "pose": frame.pose.to_dict(), "split": frame.split}
    return found | {"place": frame.place} | ({} if frame.time is None else {"time": frame.time})


def category_entries(frames: Sequence[Frame], stuff: bool) -> list[dict[str, Any]]:
    """Return the entries of ``categories``: the classes; without, every object is one."""
    found: dict[int, dict[str, Any]] = {}
    for frame in frames:
        if frame.classes is not None:
            for each in frame.classes.classes.values():
                if stuff or not each.stuff:
                    found[each.id] = _category(each)
        else:
            for object_name, instance in frame.instances.items():
                found[instance] = _category(SemanticClass(instance, object_name))
    return [found[each] for each in sorted(found)]


def _category(each: SemanticClass) -> dict[str, Any]:
    return {
        "id": each.id,
        "name": each.name,
        "supercategory": each.supercategory,
        "isthing": int(not each.stuff),
    }


def class_of(frame: Frame, object_name: str) -> SemanticClass | None:
    """Return the category of an object; None without one."""
    if frame.classes is None:
        return SemanticClass(frame.instances[object_name], object_name)
    return frame.classes.of(object_name)


def object_entries(frame: Frame, split: bool) -> Iterator[dict[str, Any]]:
    """Yield the entries of ``annotations`` of a frame, without ids; in parts where they cross the seam, if
    ``split``. Objects without a class, and stuff, have none."""
    labels = frame.layer("labels")
    known = _known(frame)
    for record in boxes(labels, frame.instances, frame.classes, wrap=frame.camera.wraps):
        of = class_of(frame, record["name"])
        if of is None or of.stuff:
            continue
        instance = record["instance_id"]
        shared: dict[str, Any] = {"category_id": of.id, "iscrowd": 0, "instance_id": instance}
        shared["name"] = record["name"]
        shared |= {key: record[key] for key in ("bbox_wrap", "crosses_seam") if key in record}
        shared |= known.get(instance, {})
        for mask in _parts(labels == instance, record, split):
            yield {**_outlined(mask), **shared}


def _parts(mask: NDArray[np.bool_], record: Mapping[str, Any], split: bool) -> list[NDArray[np.bool_]]:
    """The mask; or, where it crosses the seam without going all the way round, its parts on either side."""
    x, _, width, _ = record.get("bbox_wrap", record["bbox"])
    if not split or x + width <= mask.shape[1]:
        return [mask]
    right, left = mask.copy(), mask.copy()
    right[:, :x] = False
    left[:, x:] = False
    return [right, left]


def _outlined(mask: NDArray[np.bool_]) -> dict[str, Any]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    x, y = int(columns[0]), int(rows[0])
    box = [x, y, int(columns[-1]) + 1 - x, int(rows[-1]) + 1 - y]
    return {"bbox": box, "area": int(np.count_nonzero(mask)), "segmentation": rle.encode(mask)}


def _known(frame: Frame) -> dict[int, dict[str, Any]]:
    """What a frame's truth knows of instances, by their ids."""
    found: dict[int, dict[str, Any]] = {}
    for truth, names in _FROM_TRUTH.items():
        for record in frame.truth.get(truth, ()):
            own = found.setdefault(record["instance_id"], {})
            own |= {new: record[old] for old, new in names.items() if record.get(old) is not None}
    return found


def write_compact(path: Path, data: Mapping[str, Any]) -> Path:
    """Write JSON without spaces, whole or not at all, and return the path: masks are long."""
    with whole_file(path) as part:
        text = json.dumps(data, separators=(",", ":"), allow_nan=False)
        part.write_text(text + "\n", encoding="utf-8")
    return path
