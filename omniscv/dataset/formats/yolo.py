"""YOLO: ``images/SPLIT/KEY.png``, ``labels/SPLIT/KEY.txt`` and ``data.yaml``, for three tasks.

A row of labels is an object: its class, then its box (centre, width, height), or the contour of its largest
part, which is cut open to each hole along a line without width. Numbers are shares of the image's width and
height. Classes are numbered from 0: those that are not stuff; without classes, the names of objects. Readers
cut or round a contour to whole pixels and fill it with its border, by the even-odd rule, so it goes nearly
through the middles of pixels. Rows have no second part: ``lost`` of data.yaml is the share of the objects'
area by which filled rows differ from masks.

The pose of an object is its box in the image, then the corners (:meth:`ObjectBox.corners_w`) and the middle
of its box in space: x, y, and 2 for seen, 1 for behind something nearer, or 0 0 0 for a point outside.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from omniscv.arguments import one_of
from omniscv.cameras import Camera
from omniscv.compose.pictures import uint8_colors
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.formats.coco import category_entries, object_entries
from omniscv.dataset.formats.outlines import outline
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.records import checked, record
from omniscv.storage.local import write_text

_LEAST_PX = 10  # of a side of an image: readers drop smaller ones
_MIDDLE = 0.45  # of a pixel, of contours: 0.5 would be rounded up and down
_TOUCHING = 0.01  # of a point's distance: what is nearer by less, as the floor under a chair, hides no point
_FLIPPED = (3, 2, 1, 0, 7, 6, 5, 4, 8)
"""Points of a pose in a mirrored image, whose object is mirrored in its own y axis."""


@record
class YoloOptions:
    """Options of the format."""

    task: str = checked(
        one_of,
        words=("detect", "segment", "pose"),
        default="detect",
        help="rows are boxes, contours, or boxes with the points of a box in space: detect, segment, pose",
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
    options = YoloOptions

    def needs_of(self, cameras: Mapping[str, Camera], options: YoloOptions) -> Sequence[str]:
        """Return ``needs``, for all ``cameras``; with depth and truth if the task of ``options`` is poses."""
        if options.task == "pose":
            return [*self.needs, "depth", "truth"]
        return self.needs

    def write(self, frames: Sequence[Frame], out: Path, options: YoloOptions) -> list[Path]:
        """Write pictures and labels of ``frames`` into ``out``, for the task that ``options`` name.

        ArgumentError: an image is so small that readers drop it.
        """
        ordered = sorted(frames, key=lambda frame: frame.key)
        categories = category_entries(ordered, stuff=False)
        number_of: dict[int, int] = {}
        names: dict[int, str] = {}
        for number, category in enumerate(categories):
            number_of[category["id"]] = number
            names[number] = category["name"]
        written = list[Path]()
        splits = dict[str, str]()
        areas = [0.0, 0.0]  # of all objects, and what of them is lost, px
        for frame in ordered:
            width = frame.camera.width
            height = frame.camera.height
            if min(height, width) < _LEAST_PX:
                raise ArgumentError(
                    f"{frame.key}: expected an image of at least {_LEAST_PX} px, got {width} x {height}"
                )
            split = frame.split or "train"
            splits[split] = f"images/{split}"
            rows = _rows(frame, number_of, options, areas)
            colors = uint8_colors(frame.layer("lit"))
            written.append(write_pixels(out / "images" / split / f"{frame.key}.png", colors))
            (out / "labels" / split).mkdir(parents=True, exist_ok=True)
            written.append(write_text(out / "labels" / split / f"{frame.key}.txt", "".join(rows)))
        first = next(iter(splits.values()), "images/train")
        data: dict[str, Any] = {"path": ".", "train": first, "val": first, **splits, "names": names}
        if options.task == "segment":
            data["lost"] = round(areas[1] / max(1, areas[0]), 6)
        elif options.task == "pose":
            data |= {"kpt_shape": [len(_FLIPPED), 3], "flip_idx": list(_FLIPPED)}
        return [*written, write_text(out / "data.yaml", yaml.safe_dump(data, sort_keys=False))]


def _rows(
    frame: Frame, number_of: Mapping[int, int], options: YoloOptions, areas: list[float]
) -> Iterable[str]:
    """Return the lines of a frame's objects, equal ones once, as readers merge them.

    Args:
        frame: with labels.
        number_of: the number of a class by the id of its category.
        options: of the format.
        areas: to which the area of the objects, and what of it is lost, are added, px.
    """
    rows: dict[str, None] = {}
    for entry in object_entries(frame, split=options.seam == "split"):
        words = [str(number_of[entry["category_id"]])]
        for number in _numbers(frame, entry, options, areas):
            words.append(f"{number:.6f}")
        rows[" ".join(words) + "\n"] = None
    return rows


def _numbers(frame: Frame, entry: Mapping[str, Any], options: YoloOptions, areas: list[float]) -> list[float]:
    """Return the numbers of an object's row, as shares of the image; add its area, and what of it is lost."""
    size = np.array([frame.camera.width, frame.camera.height])
    x, y, across, down = entry["bbox"]
    box = (np.array([x + across / 2, y + down / 2, across, down]) / np.tile(size, 2)).tolist()
    if options.task == "detect":
        return [*box]
    if options.task == "pose":
        return [*box, *_points(frame, entry["instance_id"]).ravel().tolist()]
    if options.seam == "whole" and entry.get("crosses_seam"):
        wanted = "expected an object in one part, got one across the seam; set seam: split"
        raise ArgumentError(f"{frame.key}: {entry['name']}: {wanted}")
    mask = (frame.layer("labels") == entry["instance_id"])[y : y + down, x : x + across].astype(np.uint8)
    points = outline(mask)
    filled = cv2.fillPoly(np.zeros_like(mask), [points], 1)
    areas[0] += entry["area"]
    areas[1] += int(np.count_nonzero(mask != filled))
    points = np.concatenate([points, np.repeat(points[-1:], max(0, 3 - len(points)), axis=0)])
    numbers: list[float] = ((points + np.array([x + _MIDDLE, y + _MIDDLE])) / size).ravel().tolist()
    return numbers


def _points(frame: Frame, instance: int) -> NDArray[np.float64]:
    """Return x, y and visibility (9, 3) of the corners and the middle of an object's box in space.

    A point is seen if nothing nearer but the object itself is where it is in the image.
    """
    for box in frame.truth.get("boxes3d", ()):
        if box["instance_id"] == instance:
            break
    else:
        wanted = "expected the truth boxes3d of all objects, got none"
        raise ArgumentError(f"{frame.key}: {wanted} of instance {instance}; make the dataset with it")
    center = np.array(box["center_camera"])
    box_c = ObjectBox(center, np.array(box["R_camera_box"]), np.array(box["size"]), box["source"])
    points_c = np.vstack([box_c.corners_w(), center])
    pixels, valid = frame.camera.project(points_c)
    width = frame.camera.width
    height = frame.camera.height
    inside = valid & (pixels >= 0).all(axis=1) & (pixels < [width, height]).all(axis=1)
    column, row = np.where(inside[:, None], pixels, 0).astype(int).T
    nearer = frame.layer("depth")[row, column] < (1 - _TOUCHING) * np.linalg.norm(points_c, axis=1)
    seen = ~nearer | (frame.layer("labels")[row, column] == instance)
    rows = np.column_stack([pixels / [width, height], 1 + seen])
    return np.where(inside[:, None], rows, 0)
