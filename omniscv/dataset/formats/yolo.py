"""YOLO: ``images/SPLIT/KEY.png``, ``labels/SPLIT/KEY.txt`` and ``data.yaml``, for detection or segmentation.

A row of labels is an object: its class, then its box (centre, width, height), or the outer contour of its
largest part. Numbers are shares of the image's width and height. Classes are numbered from 0: those that are
not stuff; without classes, the names of objects. Readers cut a contour to whole pixels and fill it with its
border, so it goes through the middles of pixels. Rows have no holes and no second part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from omniscv.arguments import one_of
from omniscv.compose.pictures import uint8_colors
from omniscv.dataset.coco_entries import category_entries, object_entries
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.records import checked, record
from omniscv.storage.local import write_text

_LEAST_PX = 10  # of a side of an image: readers drop smaller ones


@record
class YoloOptions:
    """Options of the format."""

    task: str = checked(
        one_of,
        words=("detect", "segment"),
        default="detect",
        help="rows are boxes, or contours: detect, segment",
    )
    seam: str = checked(
        one_of,
        words=("whole", "split"),
        default="whole",
        help="split: a row on each side of a panorama's seam for objects that cross it",
    )


@register
class Yolo(Format):
    """See the module."""

    name = "yolo"
    needs = ("lit", "labels")
    keys = ("seam",)
    options = YoloOptions

    def write(self, frames: Sequence[Frame], out: Path, options: YoloOptions) -> list[Path]:
        """Write the files; ArgumentError for an image that readers drop."""
        ordered = sorted(frames, key=lambda frame: frame.key)
        categories = category_entries(ordered, stuff=False)
        number_of = {category["id"]: number for number, category in enumerate(categories)}
        written, splits = list[Path](), dict[str, str]()
        for frame in ordered:
            height, width = frame.camera.height, frame.camera.width
            if min(height, width) < _LEAST_PX:
                raise ArgumentError(
                    f"{frame.key}: expected an image of at least {_LEAST_PX} px, got {width} x {height}"
                )
            split = frame.split or "train"
            splits[split] = f"images/{split}"
            rows = [
                " ".join([str(number_of[entry["category_id"]]), *(f"{x:.6f}" for x in numbers)])
                for entry in object_entries(frame, split=options.seam == "split")
                for numbers in [_numbers(frame, entry, options)]
            ]
            written.append(
                write_pixels(out / "images" / split / f"{frame.key}.png", uint8_colors(frame.layer("lit")))
            )
            text = "".join(f"{row}\n" for row in dict.fromkeys(rows))  # readers merge equal rows
            (out / "labels" / split).mkdir(parents=True, exist_ok=True)
            written.append(write_text(out / "labels" / split / f"{frame.key}.txt", text))
        names = {number: category["name"] for number, category in enumerate(categories)}
        first = next(iter(splits.values()), "images/train")
        data = {"path": ".", "train": first, "val": first, **splits, "names": names}
        return [*written, write_text(out / "data.yaml", yaml.safe_dump(data, sort_keys=False))]


def _numbers(frame: Frame, entry: Mapping[str, Any], options: YoloOptions) -> list[float]:
    """Return the numbers of an object's row, as shares of the image."""
    size = np.array([frame.camera.width, frame.camera.height])
    x, y, across, down = entry["bbox"]
    if options.task == "detect":
        center = np.array([x + across / 2, y + down / 2])
        return [*(center / size).tolist(), *(np.array([across, down]) / size).tolist()]
    if options.seam == "whole" and entry.get("crosses_seam"):
        wanted = "expected an object in one part, got one across the seam; set seam: split"
        raise ArgumentError(f"{frame.key}: {entry['name']}: {wanted}")
    mask = (frame.layer("labels") == entry["instance_id"])[y : y + down, x : x + across]
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = max(contours, key=_filled_px)[:, 0]
    points = np.concatenate([points, np.repeat(points[-1:], max(0, 3 - len(points)), axis=0)])
    numbers: list[float] = ((points + np.array([x + 0.5, y + 0.5])) / size).ravel().tolist()
    return numbers


def _filled_px(contour: NDArray[Any]) -> float:
    """Return how many pixels a contour through the middles of pixels encloses, its own included."""
    return float(cv2.contourArea(contour) + len(contour) / 2 + 1)
