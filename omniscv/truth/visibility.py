"""How much of an object is seen: its pixels, against those it would have with nothing in front of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.truth import rle
from omniscv.truth.object_boxes import Labels, boxes

LabelsOf = Callable[[tuple[str, ...]], Labels]
"""Gives (H, W) ids, of an image in which only these objects are shown."""


def amodal(
    labels: Labels,
    names: Mapping[str, int],
    groups: Iterable[tuple[str, ...]],
    labels_of: LabelsOf,
    *,
    wrap: bool = False,
    masks: bool = False,
) -> list[dict[str, Any]]:
    """Return a record for each object that is in the image, or would be if nothing were in front of it.

    Args:
        labels: (H, W) ids, of the whole scene.
        names: object name to id.
        groups: of objects to show together, none of which can hide another: see :func:`apart`.
        labels_of: shows a group.
        wrap: whether the left and the right border are neighbours.
        masks: whether to keep the masks.

    Returns:
        Plain values, in the order of ids: ``instance_id``, ``name``, ``px_all``, ``px_visib``,
        ``visib_fract`` (their ratio), ``bbox`` and, with ``wrap``, ``bbox_wrap`` of all; with ``masks`` all
        of it as ``segmentation``, run-length encoded as in COCO.
    """
    visible = np.bincount(labels.ravel(), minlength=1 << 16)
    records = []
    for group in groups:
        shown = {name: names[name] for name in group}
        alone = labels_of(group)
        seen = np.isin(labels, list(shown.values()))
        alone = np.where(seen, labels, alone)  # what is seen is there, whatever a border pixel shows alone
        for found in boxes(alone, shown, wrap=wrap):
            instance, px_all = found["instance_id"], found["area"]
            px_visib = int(visible[instance])
            record: dict[str, Any] = {"instance_id": instance, "name": found["name"]}
            record |= {"px_all": px_all, "px_visib": px_visib, "visib_fract": px_visib / px_all}
            record |= {key: found[key] for key in ("bbox", "bbox_wrap") if key in found}
            if masks:
                record["segmentation"] = rle.encode(alone == instance)
            records.append(record)
    return sorted(records, key=lambda record: int(record["instance_id"]))


def add_shares(records: Iterable[dict[str, Any]], shares: Iterable[Mapping[str, Any]]) -> None:
    """Add ``visib_fract`` to records of objects, of those that are among the records of :func:`amodal`."""
    known = {share["instance_id"]: share["visib_fract"] for share in shares}
    for record in records:
        if record["instance_id"] in known:
            record["visib_fract"] = known[record["instance_id"]]


def apart(
    names: Iterable[str], boxes: Mapping[str, ObjectBox], center_w: Array, radius: float
) -> list[tuple[str, ...]]:
    """Return objects in groups in which none can hide another: few groups, the same on every run.

    Each is held to be a ball around its box, seen from anywhere in a ball around the camera; objects without
    a box are alone.

    Args:
        names: of objects.
        boxes: by name, world frame.
        center_w: (3,) of all the image's optical centres, metres.
        radius: within which they all are.
    """
    cones = {name: _cone(boxes[name], center_w, radius) for name in names if name in boxes}
    wide_first = sorted(cones, key=lambda name: (-cones[name][1], name))
    groups: list[list[str]] = []
    for name in wide_first:
        fits = (group for group in groups if not any(_meet(cones[name], cones[other]) for other in group))
        group = next(fits, None)
        if group is None:
            groups.append([name])
        else:
            group.append(name)
    alone = [(name,) for name in sorted(set(names) - set(cones))]
    return [*(tuple(group) for group in groups), *alone]


def _cone(box: ObjectBox, center_w: Array, radius: float) -> tuple[Array, float]:
    """An axis (3,) and the angle around it, radians, in which a box is seen."""
    toward = box.center_w - center_w
    distance = float(np.linalg.norm(toward))
    reach = float(np.linalg.norm(box.size)) / 2 + radius
    if reach >= distance:
        return np.array([0.0, 0.0, 1.0]), np.pi
    return toward / distance, float(np.arcsin(reach / distance))


def _meet(one: tuple[Array, float], other: tuple[Array, float]) -> bool:
    between = np.arccos(np.clip(one[0] @ other[0], -1, 1))
    return bool(between <= one[1] + other[1])


def centers_ball(centers_w: NDArray[np.float64]) -> tuple[Array, float]:
    """Return the centre (3,) and the radius of a ball around optical centres (..., 3); NaN are left out."""
    flat = centers_w.reshape(-1, 3)
    flat = flat[~np.isnan(flat[:, 0])]
    middle = (flat.min(axis=0) + flat.max(axis=0)) / 2
    return middle, float(np.linalg.norm(flat - middle, axis=1).max())
