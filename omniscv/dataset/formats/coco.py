"""COCO: ``annotations.json`` with run-length encoded masks, and one such file for each split.

An annotation is an object in an image; ``bbox`` and ``area`` are those that pycocotools computes from its
mask. Readers ignore further keys: ``instance_id``, ``name``, those of ``_FROM_TRUTH``, and of a panorama
``bbox_wrap`` and ``crosses_seam``. Categories are the classes that are not stuff; without classes every
object's name is one, with its instance id. Objects without a class, and stuff, have no annotation.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import flag, one_of
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import reference, write_pixels
from omniscv.frame import Frame
from omniscv.frame.classes import SemanticClass
from omniscv.records import checked, record
from omniscv.storage.local import write_text
from omniscv.truth.object_boxes import boxes
from omniscv.truth.visibility import run_lengths

_FROM_TRUTH = {
    "boxes": {"distance": "distance", "truncated": "truncated"},
    "bfov": {"bfov": "bfov", "rbfov": "rbfov"},
    "amodal": {"visib_fract": "visib_fract", "px_all": "area_amodal", "bbox": "bbox_amodal"},
}
"""By truth: fields of its records, and their names in annotations."""


def image_entry(frame: Frame, number: int, out: Path) -> dict[str, Any]:
    """Return the entry of ``images`` of a ``frame``, with the id ``number``.

    The name of its picture is relative to the folder ``out``.
    """
    entry = {
        "id": number,
        "file_name": reference(frame, "lit" if "lit" in frame.files else "labels", out),
        "width": frame.camera.width,
        "height": frame.camera.height,
        "key": frame.key,
        "camera": frame.camera.to_dict(),
        "pose": frame.pose.to_dict(),
        "split": frame.split,
        "place": frame.place,
    }
    if frame.time is not None:
        entry["time"] = frame.time
    return entry


def category_entries(frames: Sequence[Frame], stuff: bool) -> list[dict[str, Any]]:
    """Return the entries of ``categories`` of ``frames``: the classes, or without classes every object.

    Classes of stuff are left out unless ``stuff`` is set.
    """
    categories: dict[int, SemanticClass] = {}
    for frame in frames:
        for category in _categories(frame):
            if stuff or not category.stuff:
                categories[category.id] = category
    entries: list[dict[str, Any]] = []
    for number, category in sorted(categories.items()):
        entry = {"id": number, "name": category.name, "supercategory": category.supercategory}
        entries.append({**entry, "isthing": int(not category.stuff)})
    return entries


def _categories(frame: Frame) -> list[SemanticClass]:
    """Return the classes of a frame; without classes, one for every object."""
    if frame.classes is not None:
        return [*frame.classes.classes.values()]
    return [SemanticClass(number, name) for name, number in frame.instances.items()]


def class_of(frame: Frame, object_name: str) -> SemanticClass | None:
    """Return the category of the object ``object_name`` in a ``frame``; None if it has no class."""
    if frame.classes is None:
        return SemanticClass(frame.instances[object_name], object_name)
    return frame.classes.of(object_name)


def object_entries(frame: Frame, split: bool) -> Iterator[dict[str, Any]]:
    """Yield the entries of ``annotations`` of a frame, without ids; with ``split``, objects that cross the
    seam have one on either side."""
    labels = frame.layer("labels")
    from_truth = _fields_from_truth(frame)
    for box in boxes(labels, frame.instances, frame.classes, wrap=frame.camera.wraps):
        category = class_of(frame, box["name"])
        if category is None or category.stuff:
            continue
        instance = box["instance_id"]
        shared: dict[str, Any] = {"category_id": category.id, "iscrowd": 0, "instance_id": instance}
        for key in ("name", "bbox_wrap", "crosses_seam"):
            if key in box:
                shared[key] = box[key]
        shared |= from_truth.get(instance, {})
        for mask in _parts_of(labels == instance, box, split):
            yield {**_mask_fields(mask), **shared}


def _parts_of(mask: NDArray[np.bool_], record: Mapping[str, Any], split: bool) -> list[NDArray[np.bool_]]:
    """Return a mask, or if it crosses the seam without going all the way round, its parts on either side."""
    x, _, width, _ = record.get("bbox_wrap", record["bbox"])
    if not split or x + width <= mask.shape[1]:
        return [mask]
    right = mask.copy()
    right[:, :x] = False
    left = mask.copy()
    left[:, x:] = False
    return [right, left]


def _mask_fields(mask: NDArray[np.bool_]) -> dict[str, Any]:
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    x = int(columns[0])
    y = int(rows[0])
    box = [x, y, int(columns[-1]) + 1 - x, int(rows[-1]) + 1 - y]
    return {"bbox": box, "area": int(np.count_nonzero(mask)), "segmentation": run_lengths(mask)}


def _fields_from_truth(frame: Frame) -> dict[int, dict[str, Any]]:
    """Return fields of annotations from a frame's truth, by instance id."""
    fields: dict[int, dict[str, Any]] = {}
    for truth, names in _FROM_TRUTH.items():
        for values in frame.truth.get(truth, ()):
            annotation = fields.setdefault(values["instance_id"], {})
            for name, name_in_coco in names.items():
                if values.get(name) is not None:
                    annotation[name_in_coco] = values[name]
    return fields


def write_compact(path: Path, data: Mapping[str, Any]) -> Path:
    """Write ``data`` to ``path`` as JSON without spaces, since masks are long; return the path."""
    return write_text(path, json.dumps(data, separators=(",", ":"), allow_nan=False) + "\n")


@record
class CocoOptions:
    """Options of the format."""

    seam: str = checked(
        one_of,
        words=("whole", "split"),
        default="whole",
        help="split: an annotation on each side of a panorama's seam for objects that cross it",
    )
    panoptic: bool = checked(
        flag, default=False, help="panoptic.json and panoptic/STEM.png, too, with stuff, as of panopticapi"
    )


@register
class Coco(Format):
    """See the module."""

    name = "coco"
    needs = ("labels",)
    options = CocoOptions

    def write(self, frames: Sequence[Frame], out: Path, options: CocoOptions) -> list[Path]:
        """Write ``annotations.json`` of all ``frames``, and of each split, into ``out``.

        ``options`` say whether annotations are cut at the seam, and whether panoptic files are written.
        """
        ordered = sorted(frames, key=lambda frame: frame.key)
        images = []
        annotations = list[dict[str, Any]]()
        for number, frame in enumerate(ordered, start=1):
            images.append(image_entry(frame, number, out))
            for entry in object_entries(frame, split=options.seam == "split"):
                annotations.append({"id": len(annotations) + 1, "image_id": number, **entry})
        content = _content(images, ordered, stuff=False)
        written = [write_compact(out / "annotations.json", {**content, "annotations": annotations})]
        for split in sorted({frame.split for frame in ordered} - {""}):
            of_split = [image for image in images if image["split"] == split]
            ids = {image["id"] for image in of_split}
            of_images = [entry for entry in annotations if entry["image_id"] in ids]
            data = {**content, "images": of_split, "annotations": of_images}
            written.append(write_compact(out / f"annotations_{split}.json", data))
        if options.panoptic:
            written += _panoptic(ordered, images, out)
        return written


def _panoptic(frames: Sequence[Frame], images: Sequence[Mapping[str, Any]], out: Path) -> list[Path]:
    """Write instance ids as ``R + 256 G + 65536 B``, and their segments."""
    annotations = []
    written = []
    for frame, image in zip(frames, images, strict=True):
        labels = frame.layer("labels")
        segments = []
        for box in boxes(labels, frame.instances, frame.classes):
            if category := class_of(frame, box["name"]):
                segment = {"id": box["instance_id"], "category_id": category.id, "iscrowd": 0}
                segments.append({**segment, "area": box["area"], "bbox": box["bbox"]})
        ids = np.where(np.isin(labels, [segment["id"] for segment in segments]), labels, np.uint16(0))
        colors = np.stack([ids & 255, ids >> 8, np.zeros_like(ids)], axis=-1).astype(np.uint8)
        written.append(write_pixels(out / "panoptic" / f"{frame.key}.png", colors))
        entry = {"image_id": image["id"], "file_name": f"{frame.key}.png", "segments_info": segments}
        annotations.append(entry)
    content = {**_content(images, frames, stuff=True), "annotations": annotations}
    return [*written, write_compact(out / "panoptic.json", content)]


def _content(images: Sequence[Mapping[str, Any]], frames: Sequence[Frame], stuff: bool) -> dict[str, Any]:
    """Return what a file holds beside annotations."""
    return {"info": {}, "licenses": [], "images": images, "categories": category_entries(frames, stuff)}
