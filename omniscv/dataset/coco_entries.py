"""Entries of images, categories and annotations, for all files in the form of COCO."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.dataset.pictures import reference
from omniscv.frame import Frame
from omniscv.frame.classes import SemanticClass
from omniscv.storage.local import whole_file
from omniscv.truth import rle
from omniscv.truth.object_boxes import boxes

_FROM_TRUTH = {
    "boxes": {"distance": "distance", "truncated": "truncated"},
    "bfov": {"bfov": "bfov", "rbfov": "rbfov"},
    "amodal": {"visib_fract": "visib_fract", "px_all": "area_amodal", "bbox": "bbox_amodal"},
}
"""By truth: fields of its records, and their names in annotations."""


def entries(
    frames: Sequence[Frame],
    image: Callable[[Frame, int], dict[str, Any]],
    objects: Callable[[Frame], Iterable[dict[str, Any]]],
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the entries of ``images`` and ``annotations`` of frames, numbered from 1.

    Args:
        frames: in their order.
        image: returns the entry of a frame and its number.
        objects: returns the annotations of a frame, without ids.
    """
    images, annotations = [], list[dict[str, Any]]()
    for number, frame in enumerate(frames, start=1):
        images.append(image(frame, number))
        for entry in objects(frame):
            annotations.append({"id": len(annotations) + 1, "image_id": number, **entry})
    return images, annotations


def image_entry(frame: Frame, number: int, out: Path) -> dict[str, Any]:
    """Return the entry of ``images`` of a frame; its file's name is relative to a folder."""
    return {
        "id": number,
        "file_name": reference(frame, "lit" if "lit" in frame.files else "labels", out),
        "width": frame.camera.width,
        "height": frame.camera.height,
        "key": frame.key,
        "camera": frame.camera.to_dict(),
        "pose": frame.pose.to_dict(),
        "split": frame.split,
        "place": frame.place,
        **({} if frame.time is None else {"time": frame.time}),
    }


def category_entries(frames: Sequence[Frame], stuff: bool) -> list[dict[str, Any]]:
    """Return the entries of ``categories``: the classes, or without classes every object."""
    categories: dict[int, SemanticClass] = {}
    for frame in frames:
        if frame.classes is not None:
            classes = frame.classes.classes.values()
            categories |= {category.id: category for category in classes if stuff or not category.stuff}
        else:
            categories |= {number: SemanticClass(number, name) for name, number in frame.instances.items()}
    return [
        {
            "id": number,
            "name": category.name,
            "supercategory": category.supercategory,
            "isthing": int(not category.stuff),
        }
        for number, category in sorted(categories.items())
    ]


def class_of(frame: Frame, object_name: str) -> SemanticClass | None:
    """Return the category of an object; None without one."""
    if frame.classes is None:
        return SemanticClass(frame.instances[object_name], object_name)
    return frame.classes.of(object_name)


def object_entries(frame: Frame, split: bool) -> Iterator[dict[str, Any]]:
    """Yield the entries of ``annotations`` of a frame, without ids.

    Objects without a class, and stuff, have none. With ``split``, objects that cross the seam have one on
    either side.
    """
    labels = frame.layer("labels")
    from_truth = _fields_from_truth(frame)
    for record in boxes(labels, frame.instances, frame.classes, wrap=frame.camera.wraps):
        category = class_of(frame, record["name"])
        if category is None or category.stuff:
            continue
        instance = record["instance_id"]
        shared: dict[str, Any] = {"category_id": category.id, "iscrowd": 0, "instance_id": instance}
        shared["name"] = record["name"]
        shared |= {key: record[key] for key in ("bbox_wrap", "crosses_seam") if key in record}
        shared |= from_truth.get(instance, {})
        for mask in _parts_of(labels == instance, record, split):
            yield {**_mask_fields(mask), **shared}


def _parts_of(mask: NDArray[np.bool_], record: Mapping[str, Any], split: bool) -> list[NDArray[np.bool_]]:
    """Return a mask, or if it crosses the seam without going all the way round, its parts on either side."""
    x, _, width, _ = record.get("bbox_wrap", record["bbox"])
    if not split or x + width <= mask.shape[1]:
        return [mask]
    right, left = mask.copy(), mask.copy()
    right[:, :x] = False
    left[:, x:] = False
    return [right, left]


def _mask_fields(mask: NDArray[np.bool_]) -> dict[str, Any]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    x, y = int(columns[0]), int(rows[0])
    box = [x, y, int(columns[-1]) + 1 - x, int(rows[-1]) + 1 - y]
    return {"bbox": box, "area": int(np.count_nonzero(mask)), "segmentation": rle.encode(mask)}


def _fields_from_truth(frame: Frame) -> dict[int, dict[str, Any]]:
    """Return fields of annotations from a frame's truth, by instance id."""
    fields: dict[int, dict[str, Any]] = {}
    for truth, names in _FROM_TRUTH.items():
        for record in frame.truth.get(truth, ()):
            instance = fields.setdefault(record["instance_id"], {})
            instance |= {new: record[old] for old, new in names.items() if record.get(old) is not None}
    return fields


def write_compact(path: Path, data: Mapping[str, Any]) -> Path:
    """Write JSON without spaces, as masks are long, whole or not at all; return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        text = json.dumps(data, separators=(",", ":"), allow_nan=False)
        part.write_text(text + "\n", encoding="utf-8")
    return path
