"""COCO: ``annotations.json`` with run-length encoded masks, and one such file for each split.

An annotation is an object in an image. Its ``bbox`` and ``area`` equal those that pycocotools computes from
its mask. Further keys, which readers of COCO ignore, are ``instance_id``, ``name``; of a panorama
``bbox_wrap`` and ``crosses_seam``; from the frame's truth ``bfov``, ``rbfov``, ``distance``, ``truncated``,
``visib_fract``, ``area_amodal``, ``bbox_amodal``; of an image ``camera``, ``pose``, ``split``, ``place`` and
``time``.

Categories are the classes that are not stuff; without classes every object's name is a category, with its
instance id. Objects without a class, and stuff, have no annotation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import flag, one_of
from omniscv.dataset.coco_entries import (
    category_entries,
    class_of,
    entries,
    image_entry,
    object_entries,
    write_compact,
)
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import write_pixels
from omniscv.frame import Frame
from omniscv.records import checked, record
from omniscv.truth.object_boxes import boxes


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
    keys = ("seam",)
    options = CocoOptions

    def write(self, frames: Sequence[Frame], out: Path, options: CocoOptions) -> list[Path]:
        ordered = sorted(frames, key=lambda frame: frame.key)
        images, annotations = entries(
            ordered,
            lambda frame, number: image_entry(frame, number, out),
            lambda frame: object_entries(frame, split=options.seam == "split"),
        )
        content = {
            "info": {},
            "licenses": [],
            "images": images,
            "categories": category_entries(ordered, stuff=False),
        }
        written = [write_compact(out / "annotations.json", {**content, "annotations": annotations})]
        for split in sorted({frame.split for frame in ordered} - {""}):
            of_split = [image for image in images if image["split"] == split]
            ids = {image["id"] for image in of_split}
            of_images = [entry for entry in annotations if entry["image_id"] in ids]
            data = {**content, "images": of_split, "annotations": of_images}
            written.append(write_compact(out / f"annotations_{split}.json", data))
        return written + (_panoptic(ordered, images, out) if options.panoptic else [])


def _panoptic(frames: Sequence[Frame], images: Sequence[Mapping[str, Any]], out: Path) -> list[Path]:
    """Write instance ids as ``R + 256 G + 65536 B``, and their segments."""
    annotations, written = [], []
    for frame, image in zip(frames, images, strict=True):
        labels, segments = frame.layer("labels"), []
        for box in boxes(labels, frame.instances, frame.classes):
            if category := class_of(frame, box["name"]):
                segment = {"id": box["instance_id"], "category_id": category.id, "iscrowd": 0}
                segments.append({**segment, "area": box["area"], "bbox": box["bbox"]})
        ids = np.where(np.isin(labels, [segment["id"] for segment in segments]), labels, np.uint16(0))
        colors = np.stack([ids & 255, ids >> 8, np.zeros_like(ids)], axis=-1).astype(np.uint8)
        written.append(write_pixels(out / "panoptic" / f"{frame.key}.png", colors))
        entry = {"image_id": image["id"], "file_name": f"{frame.key}.png", "segments_info": segments}
        annotations.append(entry)
    content = {"info": {}, "licenses": [], "images": list(images)}
    content |= {"categories": category_entries(frames, stuff=True), "annotations": annotations}
    return [*written, write_compact(out / "panoptic.json", content)]
