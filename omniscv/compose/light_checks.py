"""What light makes doubtful: the layer ``light``, a byte of bits for each pixel, and domes that are the sky.

Bits are set by comparing captures of one world: with what is known of its shapes (``mismatch``), from a
place beside the camera (``view_dependent``, and domes that follow the camera), and without an object
(``translucent``). What cannot be compared is named in the image's provenance, and has no bit.
"""

import re
from collections.abc import Callable, Collection, Container, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv import light
from omniscv.cameras import Camera, create
from omniscv.compose.image import OmniImage
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Array, Pose
from omniscv.geometry.arrays import Ints, Mask
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.sources.base import Source

BITS = {
    "dome": 1,  # an object that stands for the sky
    "translucent": 2,  # seen through: depth and label are of what is behind
    "mismatch": 4,  # depth, label and colour are not of one object
    "view_dependent": 8,  # colour changes with the place it is seen from
    "clipped": 16,  # a code of 0 or 255 in a sample that was used
    "relit": 32,  # colour changed to close a seam
}
"""Bits of the layer ``light``; 0 is a pixel against which nothing is known."""

Render = Callable[[Source, Camera, Pose, tuple[str, ...]], OmniImage]
"""Makes another image, of a source, camera, pose and modes, with the options of the first."""

_SKY_NAMES = re.compile(r"sky|dome|backdrop|hdri", re.IGNORECASE)
# misfit of a sphere; its radius, by the median distance
_DOME_PX = 200
_SPHERE = 0.01
_RADIUS = 2.0
_LEAST_PX = 60
# points may be so far outside their object's box: metres, of the distance
_OUTSIDE_M = 0.02
_OUTSIDE = 0.01
_BESIDE = np.array((0.6, -0.7, 0.39))  # a direction that is no axis of any face
# how far beside: metres, and of the nearest surface's distance
_BESIDE_M = 0.5
_NEAREST = 0.4
_LARGEST_PX = 4096  # of the panorama that is seen there
# by which colours may differ, of which share and of how many
_LEVELS = 4.0
_SHARE = 0.015
_DIFFER_PX = 5
# levels of a pixel without the object; how much of what is behind shows
_CHANGED = 2.0
_TRANSMITS = 0.1
# of the rays that enter the box of an object, how many end in it, how deep
_CROSSED = 0.3
_DEEP_M = 0.03
_FAR_M = 1e6  # of the sky


@dataclass(frozen=True, eq=False)
class Examined:
    """An image, and what is known of its objects.

    Attributes:
        image: with labels, depth and colours as far as it has them.
        names: by label.
        boxes: by name.
    """

    image: OmniImage
    names: Mapping[int, str]
    boxes: Mapping[str, ObjectBox]

    @cached_property
    def rays_w(self) -> Array:
        """(H, W, 3) directions, world frame."""
        return self.image.camera.unproject().directions @ self.image.pose.R_w_c.T

    @cached_property
    def centers_w(self) -> Array:
        """(H, W, 3) where depth is measured from."""
        return np.broadcast_to(self.image.centers_w, self.rays_w.shape)

    @cached_property
    def points_w(self) -> Array:
        """(H, W, 3) what pixels show; the sky far away."""
        depth = np.where(np.isfinite(self.image["depth"]), self.image["depth"], _FAR_M)
        return self.centers_w + depth[..., None] * self.rays_w

    @cached_property
    def sure(self) -> Mask:
        """(H, W) where depth is finite and bounded, and the label no neighbour's."""
        error = self.image["depth_error"]
        edge = self.image["label_edge"]
        finite = np.isfinite(self.image["depth"]) & np.isfinite(error)
        return np.asarray(self.image.valid & finite & ~edge & ~self.image["unsure"])

    def of_label(self, sure: bool = True) -> Iterator[tuple[str, Mask]]:
        """Yield objects and their pixels (H, W)."""
        labels = self.image["labels"]
        for label in np.unique(labels[self.image.valid]):
            if label:
                yield self.names[int(label)], (labels == label) & (self.sure if sure else self.image.valid)


@dataclass
class Findings:
    """The bits of an image, and their reasons.

    Attributes:
        bits: (H, W) uint8.
        objects: by the name of a bit, the objects that have it; of domes, what says so.
        untested: by the name of a bit, why it was not tested.
    """

    bits: NDArray[np.uint8]
    objects: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    untested: dict[str, str] = field(default_factory=dict)

    def mark(self, bit: str, at: Mask, name: str = "", *why: str) -> None:
        """Set a bit where ``at`` (H, W) is, of the object of a ``name``; ``why`` are its reasons."""
        self.bits[at] |= BITS[bit]
        if name:
            self.objects.setdefault(bit, {})[name] = list(why)


def examine(image: OmniImage, sky: Mask | None, source: Source, render: Render) -> OmniImage:
    """Return an image with the layer ``light`` if its options ask for it, and with domes as sky.

    Args:
        image: of the source.
        sky: (H, W) where objects stand for the sky; None if none are known to.
        source: captured once more from beside the camera, and without objects that are seen through.
        render: makes these images.
    """
    findings = Findings(np.zeros(image.valid.shape, np.uint8))
    efforts = [image.effort]

    def counted(*of_image: Any) -> OmniImage:
        other = render(*of_image)
        efforts.append(other.effort)
        return other

    table = image.objects.names() if image.objects else []
    examined = Examined(image, dict(enumerate(table, start=1)), {})
    domes = _objects_of_sky(examined, sky)
    if image.options.checks == "light":
        findings.bits[:] = image.layers.get("light", 0)
        if "relit" in image.layers:
            findings.mark("relit", image["relit"])
        _mark_light(examined, domes, source, counted, findings)
    if image.labels is not None:
        for name, at in examined.of_label(sure=False):
            if name in domes:
                findings.mark("dome", at, name, *domes[name])
    layers = _with_sky(image, (findings.bits & BITS["dome"]) > 0)
    if image.options.checks == "light":
        layers["light"] = np.where(image.valid, findings.bits, np.uint8(0))
    report = {"objects": findings.objects, "untested": findings.untested}
    captures = sum(effort.captures for effort in efforts)
    megapixels = sum(effort.megapixels for effort in efforts)
    effort = replace(image.effort, captures=captures, megapixels=megapixels)
    provenance = {**image.provenance, "light": report}
    return replace(image, layers=layers, provenance=provenance, effort=effort)


def _objects_of_sky(examined: Examined, sky: Mask | None) -> dict[str, list[str]]:
    """Return the objects that the options call sky, as far as the image shows them, with that reason."""
    image = examined.image
    objects: dict[str, list[str]] = {}
    if sky is None or image.labels is None:
        return objects
    for label in np.unique(image.labels[sky & image.valid]).tolist():
        if label:
            objects[examined.names[label]] = ["sky"]
    return objects


def _mark_light(
    examined: Examined, domes: dict[str, list[str]], source: Source, render: Render, findings: Findings
) -> None:
    """Set the bits of ``checks: light``, and add the domes that are found to ``domes``."""
    layers = examined.image.layers
    missing = [name for name in ("lit", "labels", "depth") if name not in layers]
    if missing:
        why = f"expected an image with {', '.join(missing)}"
        findings.untested = dict.fromkeys(("dome", "translucent", "mismatch", "view_dependent"), why)
        return
    if source.capabilities.moves:
        why = "expected a world that stands still"
        findings.untested |= dict.fromkeys(("translucent", "mismatch"), why)
    else:
        examined = replace(examined, boxes=source.geometry().boxes)
    beside = _beside(examined, source, render, findings)
    for name, signs in _domes(examined, beside).items():
        domes[name] = [*domes.get(name, []), *signs]
    _mark_mismatch(examined, domes, findings)
    _mark_translucent(examined, source, render, findings)


def _mark_mismatch(examined: Examined, domes: Collection[str], findings: Findings) -> None:
    """Mark points that are outside the box of the object that the mask shows there, and no dome."""
    image = examined.image
    sure = examined.sure
    slack = _OUTSIDE_M + _OUTSIDE * image["depth"] + image["depth_error"]
    for name, at in examined.of_label():
        box = None if name in domes else examined.boxes.get(name)
        if box is not None and box.source != "points":
            beyond = np.abs((examined.points_w[at] - box.center_w) @ box.R_w_b) - box.size / 2
            outside = np.zeros_like(sure)
            outside[at] = beyond.max(axis=1) > slack[at]
            if outside.any():
                findings.mark("mismatch", outside, name, "depth is outside its box")


def _beside(examined: Examined, source: Source, render: Render, findings: Findings) -> Examined | None:
    """Return what is seen from beside the camera, and mark colours that differ there."""
    image = examined.image
    if not examined.sure.any():
        findings.untested["view_dependent"] = "expected depth, got none that is sure"
        return None
    near = _NEAREST * float(image["depth"][examined.sure].min())
    # In powers of two, so that other cameras at this place find the same captures in a recording.
    reach = min(_BESIDE_M, 2.0 ** np.floor(np.log2(max(near, 1e-3))))
    center_w = image.pose.position + reach * _BESIDE / np.linalg.norm(_BESIDE)
    turns = np.arccos(np.clip((examined.rays_w[:, 1:] * examined.rays_w[:, :-1]).sum(axis=-1), -1, 1))
    width = min(2 * round(np.pi / max(float(np.nanmedian(turns)), 1e-9)), _LARGEST_PX)
    camera = create("equirectangular", width, width // 2)
    try:
        other = render(source, camera, Pose.from_angles(center_w), ("lit", "object_mask", "depth"))
    except MissingCaptureError as cause:
        findings.untested["view_dependent"] = str(cause)
        return None
    beside = Examined(other, examined.names, examined.boxes)
    if image["lit"].dtype == np.uint8:
        _mark_view_dependent(examined, beside, findings)
    else:
        findings.untested["view_dependent"] = "expected colours of 8 bits"
    return beside


def _mark_view_dependent(examined: Examined, beside: Examined, findings: Findings) -> None:
    """Mark objects of whose pixels many have colours that the same points do not have from beside."""
    image = examined.image
    other = beside.image
    around = np.ones((5, 5), np.uint8)
    to_points = examined.points_w - other.pose.position
    pixels, seen = other.camera.project(to_points @ other.pose.R_w_c)
    column, row = np.moveaxis(np.where(seen[..., None], pixels, 0).astype(int), -1, 0)
    there = row, column
    off = np.abs(other["depth"][there] - np.linalg.norm(to_points, axis=-1))
    error = image["depth_error"] + other["depth_error"][there] + 2e-3 * image["depth"]
    agree = seen & examined.sure & beside.sure[there] & (off <= error)
    agree &= image["labels"] == other["labels"][there]
    codes = image["labels"].astype(np.float32)
    agree &= cv2.erode(codes, around) == cv2.dilate(codes, around)  # thin things are mixed into colours
    if agree.sum() < _LEAST_PX:
        findings.untested["view_dependent"] = "expected surfaces that are seen from beside, got none"
        return
    low = np.float32(cv2.erode(other["lit"], around)[there])
    high = np.float32(cv2.dilate(other["lit"], around)[there])
    lit = _as_bright(image["lit"], other["lit"][there], agree, image.transfer)
    beyond = np.maximum(np.maximum(low - lit, lit - high).max(axis=-1), 0)
    for name, at in examined.of_label():
        compared = at & agree
        count = compared.sum()
        differ = (beyond[compared] > _LEVELS).sum()
        if count >= _LEAST_PX and differ >= max(_DIFFER_PX, _SHARE * count):
            label = image["labels"] == image["labels"][at][0]
            share = f"{differ / count:.0%} of its pixels; strategy exact takes them from their own centres"
            findings.mark("view_dependent", label & image.valid, name, share)


def _as_bright(lit: NDArray[Any], other: NDArray[Any], agree: Mask, transfer: str) -> NDArray[np.float32]:
    """(H, W, 3) codes of colours with the exposure of others, by the median ratio of their light."""
    curve = "srgb" if transfer == "unknown" else transfer
    first = light.decode(lit, curve)
    second = light.decode(other, curve)
    bright = agree & (np.minimum(lit, other).min(axis=-1) > 10) & (np.maximum(lit, other).max(axis=-1) < 245)
    gain = np.median(second[bright] / first[bright]) if bright.any() else 1.0
    return light.encode(np.asarray(first * gain, np.float32), curve).astype(np.float32)


def _domes(examined: Examined, beside: Examined | None) -> dict[str, list[str]]:
    """Return objects that stand for the sky, by two signs or more: what they are."""
    domes = {}
    for name, at in examined.of_label():
        if at.sum() < _DOME_PX:
            continue
        signs = []
        if _SKY_NAMES.search(name):
            signs.append("its name")
        if _is_sphere(examined, at):
            signs.append("a sphere around the camera")
        if _holds_all(examined, name):
            signs.append("its box holds all others")
        if beside is not None and _follows(examined, beside, at):
            signs.append("it follows the camera")
        if len(signs) >= 2:
            domes[name] = signs
    return domes


def _holds_all(examined: Examined, name: str) -> bool:
    """Return whether the box of an object holds the camera and all other boxes; one other at least."""
    box = examined.boxes.get(name)
    if box is None or len(examined.boxes) < 2:
        return False
    points = [examined.image.pose.position[None]]
    for other_name, other in examined.boxes.items():
        if other_name != name:
            points.append(other.corners_w())
    from_center = (np.concatenate(points) - box.center_w) @ box.R_w_b
    return bool((np.abs(from_center) <= box.size / 2).all())


def _is_sphere(examined: Examined, at: Mask) -> bool:
    """Return whether points lie on a sphere that the camera is well inside of: by least squares."""
    points = examined.points_w[at] - examined.image.pose.position
    scale = float(np.median(np.linalg.norm(points, axis=1)))
    p = points / scale
    solved, *_ = np.linalg.lstsq(np.c_[2 * p, np.ones(len(p))], (p**2).sum(axis=1), rcond=None)
    radius = np.sqrt(max(solved[3] + (solved[:3] ** 2).sum(), 0))
    off = np.abs(np.linalg.norm(p - solved[:3], axis=1) - radius)
    inside = np.linalg.norm(solved[:3]) < radius / 2
    return bool(inside and radius < _RADIUS and np.quantile(off, 0.95) < _SPHERE * radius)


def _follows(examined: Examined, beside: Examined, at: Mask) -> bool:
    """Return whether distances do not change when the camera moves, as far as their errors show it."""
    pixels, seen = beside.image.camera.project(examined.rays_w[at] @ beside.image.pose.R_w_c)
    column, row = np.where(seen[:, None], pixels, 0).astype(int).T
    there = (row, column)
    moved = beside.image.pose.position - examined.image.pose.position
    same = seen & beside.sure[there] & (beside.image["labels"][there] == examined.image["labels"][at][0])
    error = examined.image["depth_error"][at] + beside.image["depth_error"][there]
    due = np.abs(examined.rays_w[at] @ moved)  # of a dome that stands still
    same &= error < due / 4
    off = np.abs(examined.image["depth"][at] - beside.image["depth"][there])
    return bool(same.sum() >= _LEAST_PX and np.median(off[same] / due[same]) < 0.25)


def _mark_translucent(examined: Examined, source: Source, render: Render, findings: Findings) -> None:
    """Mark objects that only colours show: seen through, or not annotated."""
    image = examined.image
    shown = {name for name, _ in examined.of_label(sure=False)}
    points = examined.points_w[image.valid]
    centers = examined.centers_w[image.valid]
    for name, box in sorted(examined.boxes.items()):
        if name in shown or name in source.instant.hidden or not entered(centers, points, box):
            continue
        try:
            with source.at(replace(source.instant, hidden=source.instant.hidden | {name})) as without:
                behind = render(without, image.camera, image.pose, ("lit",))["lit"]
        except (ArgumentError, MissingCaptureError) as cause:
            findings.untested["translucent"] = f"{name}: {cause}"
            continue
        lit = np.asarray(image["lit"], np.float64)
        behind = np.asarray(behind, np.float64)
        changed = image.valid & (np.abs(lit - behind).max(axis=-1) > _CHANGED)
        if changed.sum() >= _LEAST_PX:
            inner = changed[:, 1:] & changed[:, :-1]  # outlines of what is behind show through, or do not
            x = np.diff(behind, axis=1)[inner]
            y = np.diff(lit, axis=1)[inner]
            through = (x * y).sum() > _TRANSMITS * (x * x).sum() > 0
            findings.mark("translucent" if through else "mismatch", changed, name, "only colours show it")


def entered(centers_w: Array, points_w: Array, box: ObjectBox, least: int = _LEAST_PX) -> bool:
    """Return whether many rays end in a box or behind it.

    Args:
        centers_w: (3,) or (N, 3), where the rays start, metres.
        points_w: (N, 3), what they meet, metres.
        box: of an object.
        least: rays that count as many.
    """
    start = (centers_w - box.center_w) @ box.R_w_b
    end = (points_w - box.center_w) @ box.R_w_b
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = (np.array((-1.0, 1.0))[:, None, None] * box.size / 2 - start) / (end - start)
    enter = bounds.min(axis=0).max(axis=1)
    leave = bounds.max(axis=0).min(axis=1)
    toward = (enter > 0) & (enter < leave)
    deep = toward & ((1 - enter) * np.linalg.norm(end - start, axis=1) > _DEEP_M)
    return bool(deep.sum() >= max(least, _CROSSED * toward.sum()))


def _with_sky(image: OmniImage, sky: Mask) -> dict[str, NDArray[Any]]:
    """Return the layers, with pixels that show no surface where the sky is, as where nothing was captured."""
    layers = dict(image.layers)
    if not sky.any():
        return layers
    doubt = layers["label_edge"] | layers["unsure"]
    error = np.where(doubt, np.inf, 0)[sky]
    values = {"depth": np.inf, "depth_error": error, "labels": 0, "object_mask": 0, "normals": 0}
    for name in values.keys() & layers.keys():
        layers[name] = layers[name].copy()
        layers[name][sky] = values[name]
    return layers


_WINDOW_PX = (7, 7)
_DENSE = 0.2
"""px of the image, and the share of them that only the finer capture marks, from which on all are marked: an
object's edge is a line, of which the finer capture marks a part."""

Layers = dict[str, NDArray[Any]]


def compare(modes: Container[str], layers: Layers, finer: Layers, at: Ints, shape: tuple[int, ...]) -> None:
    """Compare captures of two sizes for ``checks: beat``.

    A structure that meets all pixels of a picture at nearly the same phase looks smooth there; not in the
    other. Widen ``depth_error`` and ``label_edge`` of an image (H, W) to those of finer captures, and where
    the two differ in some modes.

    Args:
        modes: that are compared.
        layers: of the image, flat, by name; these are changed.
        finer: of the finer captures, flat, by name.
        at: (N,) flat indices of the pixels that were captured.
        shape: (H, W) of the image.
    """
    lost = np.zeros(len(at), np.bool_)
    if "depth" in modes:
        error = layers["depth_error"][at]
        other = finer["depth_error"][at]
        with np.errstate(invalid="ignore"):  # of two rays that meet nothing
            apart = np.abs(layers["depth"][at] - finer["depth"][at]) > error + other
        layers["depth_error"][at] = np.where(apart, np.inf, np.maximum(error, other))
        lost = apart | (np.isinf(other) & np.isfinite(error))
    if "object_mask" in modes:
        edge = layers["label_edge"]
        found = np.zeros((2, *shape), np.float32)
        differ = (layers["object_mask"][at] != finer["object_mask"][at]).reshape(len(at), -1).any(axis=1)
        lost |= finer["label_edge"][at] | differ
        found.reshape(2, -1)[:, at] = lost & ~edge[at], np.ones(len(at))
        lost_share = cv2.blur(found[0], _WINDOW_PX).reshape(-1)[at]
        compared_share = cv2.blur(found[1], _WINDOW_PX).reshape(-1)[at]
        edge[at] |= lost | (lost_share > _DENSE * compared_share)
