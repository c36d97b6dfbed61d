"""The truth ``amodal``: how much of every object is seen, and its box or mask without what occludes it.

The image's object masks are rendered again with all but some objects hidden. Objects that cannot occlude each
other are shown together, so a furnished room takes two to four such images. In a live engine each takes the
captures of an object mask, and two commands for every object.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.records import record, word
from omniscv.sources.base import Source
from omniscv.truth.object_boxes import Labels, boxes, visible_ids
from omniscv.truth.registry import Truth, register

Mask = NDArray[np.bool_]

_GROUPS = 7  # of five bits: enough for differences of counts below 2^31


def run_lengths(mask: Mask) -> dict[str, Any]:
    """Return ``{"size": [height, width], "counts": text}`` of a mask (H, W), in COCO's compressed form.

    Runs go down the columns; the first run is of pixels that are not set. Counts from the fourth on are
    stored as differences to the count before the last. A number is stored in groups of five bits, the lowest
    first; a sixth bit is set if more groups follow. A group is a printable character from ``0``.
    Source: the documentation of the format in cocodataset/cocoapi, common/maskApi.
    """
    height, width = mask.shape
    columns = np.flatnonzero(mask.any(axis=0))
    first, last = (columns[0], columns[-1] + 1) if len(columns) else (0, 0)
    runs = mask[:, first:last].ravel(order="F")
    starts = np.flatnonzero(np.diff(runs, prepend=False, append=False)) + first * height
    ends = [] if len(starts) and starts[-1] == mask.size else [mask.size]
    edges = np.concatenate([[0], starts, ends]).astype(np.int64)
    return {"size": [height, width], "counts": _text(edges[1:] - edges[:-1])}


def _text(counts: NDArray[np.int64]) -> str:
    left = counts.copy()
    left[3:] -= counts[1:-2]
    characters = np.zeros((len(left), _GROUPS), np.uint8)
    going = np.ones(len(left), bool)
    for group in range(_GROUPS):
        low = left & 31
        left >>= 5
        more = going & np.where(low & 16, left != -1, left != 0)
        characters[going, group] = (low + 32 * more + 48)[going]
        going = more
    return characters[characters > 0].tobytes().decode("ascii")


LabelsOf = Callable[[tuple[str, ...]], Labels]
"""Return (H, W) ids of an image in which only these objects are shown."""

Kind = Literal["boxes", "masks"]


def amodal(
    labels: Labels,
    names: Mapping[str, int],
    groups: Iterable[tuple[str, ...]],
    labels_of: LabelsOf,
    *,
    wrap: bool = False,
    masks: bool = False,
) -> list[dict[str, Any]]:
    """Return a record for each object that is in the image, or would be without occlusion.

    Args:
        labels: (H, W) ids of the whole scene.
        names: object name to id.
        groups: objects to show together, none of which can occlude another: see :func:`groups_apart`.
        labels_of: shows a group.
        wrap: whether the left and the right border are neighbours.
        masks: whether records have masks.

    Returns:
        Plain values in the order of ids, see :mod:`omniscv.frame.forms`; with ``wrap``, ``bbox_wrap``; with
        ``masks``, ``segmentation``, run-length encoded as in COCO.
    """
    visible = np.bincount(labels.ravel(), minlength=1 << 16)
    records = []
    for group in groups:
        shown = {name: names[name] for name in group}
        alone = labels_of(group)
        # Visible pixels are the object's even where a border pixel is not when it is rendered alone.
        alone = np.where(np.isin(labels, list(shown.values())), labels, alone)
        for box in boxes(alone, shown, wrap=wrap):
            instance = box["instance_id"]
            px_all = box["area"]
            px_visib = int(visible[instance])
            entry: dict[str, Any] = {"instance_id": instance, "name": box["name"]}
            entry |= {"px_all": px_all, "px_visib": px_visib, "visib_fract": px_visib / px_all}
            entry["bbox"] = box["bbox"]
            if wrap:
                entry["bbox_wrap"] = box["bbox_wrap"]
            if masks:
                entry["segmentation"] = run_lengths(alone == instance)
            records.append(entry)
    return sorted(records, key=lambda entry: int(entry["instance_id"]))


def groups_apart(
    names: Iterable[str], boxes: Mapping[str, ObjectBox], center_w: Array, radius: float
) -> list[tuple[str, ...]]:
    """Return objects in few groups in which none can occlude another; the same groups on every run.

    Each object is bounded by the ball around its box, seen from anywhere in a ball around the image's optical
    centres. An object without a box is a group of its own.

    Args:
        names: of the objects.
        boxes: by object name, world frame.
        center_w: (3,) metres, world frame, of the ball around the optical centres.
        radius: of that ball, metres.
    """
    cones: dict[str, _Cone] = {}
    without_box = []
    for name in sorted(set(names)):
        if name in boxes:
            cones[name] = _cone(boxes[name], center_w, radius)
        else:
            without_box.append((name,))
    groups: list[list[str]] = []
    for name in sorted(cones, key=lambda name: (-cones[name][1], name)):  # wide cones first
        for group in groups:
            if all(_are_apart(cones[name], cones[other]) for other in group):
                group.append(name)
                break
        else:
            groups.append([name])
    return [*map(tuple, groups), *without_box]


_Cone = tuple[Array, float]
"""Axis (3,) and half angle, radians."""


def _are_apart(first: _Cone, second: _Cone) -> bool:
    """Return whether two cones from one point have no direction in common."""
    between = np.arccos(np.clip(first[0] @ second[0], -1, 1))
    return bool(between > first[1] + second[1])


def _cone(box: ObjectBox, center_w: Array, radius: float) -> _Cone:
    """Return a cone in which a box is seen."""
    offset = box.center_w - center_w
    distance = float(np.linalg.norm(offset))
    reach = float(np.linalg.norm(box.size)) / 2 + radius
    if reach >= distance:
        return np.array([0.0, 0.0, 1.0]), np.pi
    return offset / distance, float(np.arcsin(reach / distance))


def centers_ball(centers_w: NDArray[np.float64]) -> tuple[Array, float]:
    """Return the centre (3,) and the radius of a ball around optical centres (..., 3); NaN are left out."""
    centers = centers_w.reshape(-1, 3)
    centers = centers[~np.isnan(centers[:, 0])]
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    return middle, float(np.linalg.norm(centers - middle, axis=1).max())


# -- the truth ------------------------------------------------------------------------------------------


@record
class AmodalOptions:
    """Options of the truth ``amodal``."""

    kind: Kind = word(Kind, default="boxes", help="boxes, or masks too")


def _derive(frame: Frame, options: AmodalOptions) -> list[dict[str, Any]]:
    """Return the records of :func:`amodal` of objects that are neither the room's surfaces nor stuff."""
    renderer = frame.renderer
    if renderer is None:
        raise ArgumentError("expected a source that can hide objects, got none; make the dataset with it")
    image = frame.rendered()
    center_w, radius = centers_ball(np.asarray(image.centers_w))
    groups = groups_apart(_things(frame), frame.geometry.boxes, center_w, radius)
    labels = frame.layer("labels")
    names = frame.instances
    labels_of = partial(_labels_alone, frame, renderer)
    return amodal(labels, names, groups, labels_of, wrap=image.camera.wraps, masks=options.kind == "masks")


def _things(frame: Frame) -> list[str]:
    """Return the objects that are visible, or may be in the image behind others: only an analytic scene lists
    boxes of its own objects alone; those of an engine may be far away."""
    visible = visible_ids(frame.layer("labels"))
    room = frame.geometry.room
    surfaces = () if room is None else room.surfaces
    things = []
    for name, instance in sorted(frame.instances.items()):
        box = frame.geometry.boxes.get(name)
        semantic = None if frame.classes is None else frame.classes.of(name)
        stuff = name in surfaces or (semantic is not None and semantic.stuff)
        if not stuff and (instance in visible or (box is not None and box.source == "scene")):
            things.append(name)
    return things


def _labels_alone(frame: Frame, renderer: Renderer, names: Iterable[str]) -> Labels:
    """(H, W) ids of the image with only these objects shown."""
    image = frame.rendered()
    instances = frame.instances
    others = set(renderer.source.objects().names()) - set(names)
    with renderer.source.without(sorted(others)) as source:
        alone = renderer.of(source).render(image.camera, image.pose, ("object_mask",), image.options)
    ids = [0]  # by the labels of the rendered image
    for name in () if alone.objects is None else alone.objects.names():
        ids.append(instances.get(name, 0) if name in names else 0)
    return np.asarray(np.array(ids, np.uint16)[alone["labels"]])


def _check(source: Source, *_: object) -> None:
    source.without([]).close()


register(Truth("amodal", _derive, needs=("object_mask",), captures=True, options=AmodalOptions, check=_check))
