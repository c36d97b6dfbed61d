"""COCO: ``annotations.json`` with run-length encoded masks, and one such file for each split.

An annotation is an object in an image. Its ``bbox`` and ``area`` are what pycocotools makes of its mask.
There is more than COCO has, which its readers ignore: ``instance_id``, ``name``; of a panorama ``bbox_wrap``
and ``crosses_seam``; from the frame's truth ``bfov``, ``rbfov``, ``distance``, ``truncated``,
``visib_fract``, ``area_amodal``, ``bbox_amodal``; of an image ``camera``, ``pose``, ``split``, ``place`` and
``time``.

Categories are the classes that are no stuff; without classes every object's name is a category of its own,
with its instance id. Objects without a class, and stuff, have no annotation.

Options: ``seam``: ``whole``, one annotation for an object that crosses the seam of a panorama, or ``split``,
one for each side of it; ``panoptic``: whether to write ``panoptic.json`` and ``panoptic/STEM.png`` too, with
stuff, as panopticapi reads them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import Reader, fields, flag, one_of
from omniscv.cameras import Camera
from omniscv.compose.files import write_picture
from omniscv.dataset.coco_entries import (
    category_entries,
    class_of,
    image_entry,
    object_entries,
    write_compact,
)
from omniscv.frame import Frame
from omniscv.modalities import Modality
from omniscv.truth.object_boxes import boxes

name = "coco"
needs = ("labels",)
keys = ("seam",)

_OPTIONS: dict[str, Reader] = {"seam": partial(one_of, words=("whole", "split")), "panoptic": flag}
_PANOPTIC = Modality("panoptic", ("uint8",), 3)


def refuses(camera: Camera) -> str | None:
    """Return None: masks are of any camera."""
    return None


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for a wrong option."""
    fields("", options, _OPTIONS)


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the annotations of frames; the order of frames does not count.

    Raises:
        ArgumentError: a frame without labels, or a wrong option.
    """
    given = fields("", options, _OPTIONS)
    split = given.get("seam", "whole") == "split"
    ordered = sorted(frames, key=lambda frame: frame.key)
    out.mkdir(parents=True, exist_ok=True)
    images: list[dict[str, Any]] = []
    found: list[dict[str, Any]] = []
    for number, frame in enumerate(ordered, start=1):
        images.append(image_entry(frame, number, out))
        for each in object_entries(frame, split):
            found.append({"id": len(found) + 1, "image_id": number, **each})
    content = {
        "info": {},
        "licenses": [],
        "images": images,
        "categories": category_entries(ordered, stuff=False),
    }
    written = [write_compact(out / "annotations.json", {**content, "annotations": found})]
    for part in sorted({frame.split for frame in ordered} - {""}):
        chosen = [image for image in images if image["split"] == part]
        own = {image["id"] for image in chosen}
        some = [each for each in found if each["image_id"] in own]
        data = {**content, "images": chosen, "annotations": some}
        written.append(write_compact(out / f"annotations_{part}.json", data))
    return written + (_panoptic(ordered, images, out) if given.get("panoptic", False) else [])


def _panoptic(frames: Sequence[Frame], images: Sequence[Mapping[str, Any]], out: Path) -> list[Path]:
    """Write instance ids as ``R + 256 G + 65536 B``, and what they are."""
    folder = out / "panoptic"
    folder.mkdir(parents=True, exist_ok=True)
    found, written = [], []
    for frame, image in zip(frames, images, strict=True):
        labels, segments = frame.layer("labels"), []
        for record in boxes(labels, frame.instances, frame.classes):
            if of := class_of(frame, record["name"]):
                segment = {"id": record["instance_id"], "category_id": of.id, "iscrowd": 0}
                segments.append({**segment, "area": record["area"], "bbox": record["bbox"]})
        shown = np.where(np.isin(labels, [each["id"] for each in segments]), labels, np.uint16(0))
        colors = np.stack([shown & 255, shown >> 8, np.zeros_like(shown)], axis=-1).astype(np.uint8)
        written.append(write_picture(folder / f"{frame.key}.png", colors, _PANOPTIC))
        entry = {"image_id": image["id"], "file_name": f"{frame.key}.png", "segments_info": segments}
        found.append(entry)
    content = {"info": {}, "licenses": [], "images": list(images)}
    content |= {"categories": category_entries(frames, stuff=True), "annotations": found}
    return [*written, write_compact(out / "panoptic.json", content)]
