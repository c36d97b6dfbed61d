"""Boxes of objects in an image, from labels: exact to the pixel, also across the seam of a panorama."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from omniscv.truth.classes import ClassTable

Labels = NDArray[np.uint16]
Names = Mapping[str, int] | Sequence[str]
"""Object name to the id that labels hold; or the names of the ids 1, 2, 3, ..."""

Box = list[int]
"""``[x, y, width, height]``, px: the edges of pixels, ``[0, 0, 1, 1]`` is the first one."""


def boxes(
    labels: Labels,
    names: Names,
    classes: ClassTable | None = None,
    *,
    wrap: bool = False,
    depth: NDArray[np.float32] | None = None,
) -> list[dict[str, Any]]:
    """Return a record for each object that is seen, in the order of ids.

    Args:
        labels: (H, W) ids.
        names: of ids; those without a name are left out.
        classes: of names.
        wrap: whether the left and the right border are neighbours, as :attr:`Camera.wraps` says.
        depth: (H, W) metres along the ray, +inf for none, 0 outside the field of view.

    Returns:
        Plain values: ``instance_id``, ``name``, ``class`` (None without), ``area`` (px), ``bbox``; with
        ``wrap`` ``bbox_wrap``, the smallest that may go over the right border, ``x + width > W``, and
        ``crosses_seam``; with ``depth`` ``distance``, metres to the nearest of its pixels, None if endless.
    """
    named = {each: name for name, each in ids(names).items()}
    areas = np.bincount(labels.ravel())
    nearest = None if depth is None else _nearest(labels, depth, len(areas))
    records = []
    for instance, place in enumerate(ndimage.find_objects(labels), start=1):
        if place is None or instance not in named:
            continue
        name = named[instance]
        found = None if classes is None else classes.of(name)
        record: dict[str, Any] = {"instance_id": instance, "name": name, "class": found and found.name}
        record |= {"area": int(areas[instance]), "bbox": _box(*place)}
        if wrap:
            across = wrapped(labels[place] == instance, place[0], place[1], labels.shape[1])
            record |= {"bbox_wrap": across, "crosses_seam": _crosses(across, labels.shape[1])}
        if nearest is not None:
            distance = float(nearest[instance])
            record["distance"] = distance if np.isfinite(distance) else None
        records.append(record)
    return records


def ids(names: Names) -> dict[str, int]:
    """Return object name to id."""
    return dict(names) if isinstance(names, Mapping) else {name: i for i, name in enumerate(names, start=1)}


def wrapped(mask: NDArray[np.bool_], rows: slice, columns: slice, width: int) -> Box:
    """Return the smallest box around a mask in an image whose left and right border are neighbours.

    Args:
        mask: (h, w) within its box without wrapping.
        rows, columns: that box.
        width: of the image, px.
    """
    occupied = columns.start + np.flatnonzero(mask.any(axis=0))
    gaps = np.diff(occupied, append=occupied[0] + width)
    last = int(gaps.argmax())  # the column before the widest gap
    across = width - int(gaps[last]) + 1
    start = int(occupied[(last + 1) % len(occupied)]) if across < width else 0
    return [start, rows.start, across, rows.stop - rows.start]


def _crosses(box: Box, width: int) -> bool:
    """Whether a box goes over the seam, or all the way round."""
    return box[0] + box[2] > width or box[2] == width


def _box(rows: slice, columns: slice) -> Box:
    return [columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start]


def _nearest(labels: Labels, depth: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """(count,) the least depth above 0 of every id, +inf for none."""
    nearest = np.full(count, np.inf, np.float32)
    seen = depth > 0
    np.minimum.at(nearest, labels[seen], depth[seen])
    return nearest
