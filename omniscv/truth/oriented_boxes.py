"""Boxes of objects in space: where they are for the world and for the camera, how much is in the image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from omniscv.cameras import Camera
from omniscv.geometry import Array, Pose
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.truth.classes import ClassTable
from omniscv.truth.object_boxes import Labels, Names, ids

_ACROSS = 6
"""Points along each edge of a box's sides, for the share of it that is in the image."""


def boxes3d(
    boxes: Mapping[str, ObjectBox],
    camera: Camera,
    pose: Pose,
    names: Names,
    classes: ClassTable | None = None,
) -> list[dict[str, Any]]:
    """Return a record for each object whose box is known, in the order of ids.

    Args:
        boxes: by object name, world frame.
        camera, pose: of the image.
        names: of ids.
        classes: of names.

    Returns:
        Plain values, metres: ``instance_id``, ``name``, ``class`` (None without), ``center_world``, ``size``
        along the box's axes, ``R_world_box``, ``center_camera``, ``R_camera_box``, ``distance`` of its centre
        from the camera's position, ``truncated``, and ``source``: see :class:`ObjectBox`. A box around points
        that were seen has ``partial``: true.
    """
    known = sorted((instance, name) for name, instance in ids(names).items() if name in boxes)
    shares = truncated([boxes[name] for _, name in known], camera, pose)
    records = []
    for (instance, name), share in zip(known, shares, strict=True):
        box, found = boxes[name], None if classes is None else classes.of(name)
        center_c = pose.to_camera(box.center_w)
        record: dict[str, Any] = {"instance_id": instance, "name": name, "class": found and found.name}
        record |= {"center_world": box.center_w.tolist(), "size": box.size.tolist()}
        record |= {"R_world_box": box.R_w_b.tolist(), "center_camera": center_c.tolist()}
        record |= {"R_camera_box": (pose.R_w_c.T @ box.R_w_b).tolist()}
        record |= {"distance": float(np.linalg.norm(center_c)), "truncated": share, "source": box.source}
        if box.source == "points":
            record["partial"] = True
        records.append(record)
    return records


def truncated(boxes: list[ObjectBox], camera: Camera, pose: Pose) -> list[float]:
    """Return the share of each box's surface that no pixel's ray leads to, 0 to 1, whatever hides it."""
    if not boxes:
        return []
    points_w = np.stack([box.center_w + (_SURFACE * box.size) @ box.R_w_b.T for box in boxes])
    _, valid = camera.project(pose.to_camera(points_w))
    return [float(share) for share in 1 - valid.mean(axis=1)]


def from_points(
    points_w: Array, labels: Labels, kept: NDArray[np.bool_], names: Names
) -> dict[str, ObjectBox]:
    """Return boxes along the world's axes around what was seen of objects.

    Args:
        points_w: (H, W, 3) metres.
        labels: (H, W) ids.
        kept: (H, W) where there is a point that is the object's.
        names: of ids; only these have boxes.
    """
    wanted = {instance: name for name, instance in ids(names).items()}
    found = {}
    for instance, place in enumerate(ndimage.find_objects(labels), start=1):
        if place is None or instance not in wanted:
            continue
        seen = points_w[place][(labels[place] == instance) & kept[place]]
        if len(seen):
            low, high = seen.min(axis=0), seen.max(axis=0)
            found[wanted[instance]] = ObjectBox((low + high) / 2, np.eye(3), high - low, "points")
    return found


def _surface() -> Array:
    """(N, 3) the middles of equal parts of the sides of a box of size 1."""
    along = (np.arange(_ACROSS) + 0.5) / _ACROSS - 0.5
    a, b = (each.ravel() for each in np.meshgrid(along, along))
    sides = [
        np.insert(np.column_stack([a, b]), axis, end, axis=1) for axis in range(3) for end in (-0.5, 0.5)
    ]
    return np.concatenate(sides)


_SURFACE = _surface()
