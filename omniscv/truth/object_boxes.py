"""Boxes of objects: the truths ``boxes``, in the image, and ``boxes3d``, in space.

Boxes in the image come from labels and are exact to the pixel, also across the seam of a panorama.
"""

from collections.abc import Container, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.frame import Frame
from omniscv.frame.classes import ClassTable
from omniscv.geometry import Array, Pose
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.records import NoOptions
from omniscv.truth.registry import Truth, register

Labels = NDArray[np.uint16]
Names = Mapping[str, int] | Sequence[str]
"""Object name to the id that labels hold; or the names of the ids 1, 2, 3, ..."""

Box = list[int]
"""``[x, y, width, height]``, px: the edges of pixels, ``[0, 0, 1, 1]`` is the first one."""

_SAMPLES = 6  # points along each edge of a box's sides, for the share of the surface in the image


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
        names: of ids; ids without a name are left out.
        classes: of names.
        wrap: whether the left and the right border are neighbours, as :attr:`Camera.wraps` says.
        depth: (H, W) metres along the ray, +inf for no surface, 0 outside the field of view.

    Returns:
        Plain values, see :mod:`omniscv.frame.forms`; with ``wrap``, the smallest box that may cross the right
        border (``x + width > W``), too; with ``depth``, ``distance``.
    """
    name_of = {instance: name for name, instance in ids(names).items()}
    areas = np.bincount(labels.ravel())
    nearest = np.full(len(areas), np.inf, np.float32)
    if depth is not None:
        np.minimum.at(nearest, labels[depth > 0], depth[depth > 0])
    width = labels.shape[1]
    records = []
    for instance, box in _found(labels, name_of):
        rows, columns = box
        record = _named(instance, name_of[instance], classes)
        record["area"] = int(areas[instance])
        record["bbox"] = [columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start]
        if wrap:
            wrapped = _wrapped(labels[box] == instance, rows, columns, width)
            crosses = wrapped[0] + wrapped[2] > width or wrapped[2] == width
            record |= {"bbox_wrap": wrapped, "crosses_seam": crosses}
        if depth is not None:
            distance = float(nearest[instance])
            record["distance"] = distance if np.isfinite(distance) else None
        records.append(record)
    return records


def ids(names: Names) -> dict[str, int]:
    """Return object name to id."""
    if isinstance(names, Mapping):
        return dict(names)
    return {name: number for number, name in enumerate(names, start=1)}


def visible_ids(labels: Labels) -> set[int]:
    """Return the ids that (H, W) labels hold, with 0 where a pixel has no label."""
    return set(np.flatnonzero(np.bincount(labels.ravel())).tolist())


def _found(labels: Labels, wanted: Container[int]) -> Iterator[tuple[int, tuple[slice, ...]]]:
    """Yield those of some ids that (H, W) labels hold, with the rows and columns around their pixels."""
    from scipy import ndimage  # slow to load

    for instance, box in enumerate(ndimage.find_objects(labels), start=1):
        if box is not None and instance in wanted:
            yield instance, box


def _named(instance: int, name: str, classes: ClassTable | None) -> dict[str, Any]:
    """The start of an object's record."""
    semantic = None if classes is None else classes.of(name)
    return {"instance_id": instance, "name": name, "class": semantic and semantic.name}


def _wrapped(mask: NDArray[np.bool_], rows: slice, columns: slice, width: int) -> Box:
    """Return the smallest box around a mask, within its box without wrapping, in an image whose left and
    right border are neighbours."""
    occupied = columns.start + np.flatnonzero(mask.any(axis=0))
    gaps = np.diff(occupied, append=occupied[0] + width)
    last = int(gaps.argmax())  # the column before the widest gap
    across = width - int(gaps[last]) + 1
    start = int(occupied[(last + 1) % len(occupied)]) if across < width else 0
    return [start, rows.start, across, rows.stop - rows.start]


# -- boxes in space -------------------------------------------------------------------------------------


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
        camera: of the image.
        pose: of the camera, world frame.
        names: of ids.
        classes: of names.

    Returns:
        Plain values, see :mod:`omniscv.frame.forms`; also ``center_world``, ``R_world_box``, and ``distance``
        of the centre from the camera's position. A box around points that were seen has ``partial``: true.
    """
    known = []
    for name, instance in ids(names).items():
        if name in boxes:
            known.append((instance, name))
    known.sort()
    shares = truncated([boxes[name] for _, name in known], camera, pose)
    records = []
    for (instance, name), share in zip(known, shares, strict=True):
        box = boxes[name]
        center_c = pose.to_camera(box.center_w)
        record = _named(instance, name, classes)
        record |= {"center_world": box.center_w.tolist(), "size": box.size.tolist()}
        record |= {"R_world_box": box.R_w_b.tolist(), "center_camera": center_c.tolist()}
        record |= {"R_camera_box": (pose.R_w_c.T @ box.R_w_b).tolist()}
        record |= {"distance": float(np.linalg.norm(center_c)), "truncated": share, "source": box.source}
        if box.source == "points":
            record["partial"] = True
        records.append(record)
    return records


def truncated(boxes: Sequence[ObjectBox], camera: Camera, pose: Pose) -> list[float]:
    """Return which share of the surface of each of ``boxes`` lies outside the image, occluded or not, 0 to 1.

    ``camera`` is that of the image, ``pose`` its pose in the world frame of the boxes.
    """
    if not boxes:
        return []
    points_w = np.stack(list(map(surface_w, boxes)))
    _, valid = camera.project(pose.to_camera(points_w))
    outside: list[float] = (1 - valid.mean(axis=1)).tolist()
    return outside


def surface_w(box: ObjectBox) -> Array:
    """Return points (216, 3) that are spread evenly over each side of a box, world frame."""
    return box.center_w + (_SURFACE * box.size) @ box.R_w_b.T


def boxes_around_points(
    points_w: Array, labels: Labels, usable: NDArray[np.bool_], names: Names
) -> dict[str, ObjectBox]:
    """Return boxes along the world's axes around the visible points of named objects.

    Args:
        points_w: (H, W, 3) metres, world frame, of the pixels.
        labels: (H, W) ids.
        usable: (H, W) where a pixel's point surely is the object's.
        names: of ids.
    """
    name_of = {instance: name for name, instance in ids(names).items()}
    around = {}
    for instance, box in _found(labels, name_of):
        points = points_w[box][(labels[box] == instance) & usable[box]]
        if len(points):
            low = points.min(axis=0)
            high = points.max(axis=0)
            around[name_of[instance]] = ObjectBox((low + high) / 2, np.eye(3), high - low, "points")
    return around


def _surface_of_unit_box() -> Array:
    """Return (216, 3) the middles of equal tiles of the sides of a box of size 1."""
    along = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    side = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    sides = []
    for axis in range(3):
        for end in (-0.5, 0.5):
            sides.append(np.insert(side, axis, end, axis=1))
    return np.concatenate(sides)


_SURFACE = _surface_of_unit_box()


# -- the truths -----------------------------------------------------------------------------------------


def _derive_boxes(frame: Frame, options: NoOptions) -> list[dict[str, Any]]:
    """Return the records of :func:`boxes`, with ``truncated`` where a box in space is known."""
    image = frame.rendered()
    known = frame.geometry.boxes
    labels = frame.layer("labels")
    wrap = image.camera.wraps
    records = boxes(labels, frame.instances, frame.classes, wrap=wrap, depth=image.depth)
    with_box = [record for record in records if record["name"] in known]
    shares = truncated([known[record["name"]] for record in with_box], image.camera, image.pose)
    for record, share in zip(with_box, shares, strict=True):
        record["truncated"] = share
    return records


def _derive_boxes3d(frame: Frame, options: NoOptions) -> list[dict[str, Any]]:
    """Return the records of :func:`boxes3d` of the objects that are seen: of boxes that the source knows,
    else of those around visible points, where the image has depth."""
    image = frame.rendered()
    known = frame.geometry.boxes
    visible = visible_ids(frame.layer("labels"))
    names = {}
    unknown = {}
    for name, instance in frame.instances.items():
        if instance in visible:
            names[name] = instance
            if name not in known:
                unknown[name] = instance
    around = _boxes_from_depth(frame, unknown) if unknown and image.depth is not None else {}
    return boxes3d({**known, **around}, image.camera, image.pose, names, frame.classes)


def _boxes_from_depth(frame: Frame, names: Mapping[str, int]) -> dict[str, ObjectBox]:
    image = frame.rendered()
    depth = np.asarray(image.depth, dtype=np.float64)
    usable = np.isfinite(depth) & (depth > 0)
    for name in ("label_edge", "unsure"):
        if name in image.layers:
            usable &= ~image.layers[name]
    directions_w = image.camera.unproject().directions @ image.pose.R_w_c.T
    points_w = image.centers_w + np.where(usable, depth, 0.0)[..., None] * directions_w
    return boxes_around_points(points_w, frame.layer("labels"), usable, names)


register(Truth("boxes", _derive_boxes, needs=("object_mask",), options=NoOptions))
register(Truth("boxes3d", _derive_boxes3d, needs=("object_mask",), options=NoOptions))
