"""Comparison of captures with each other, and with the server's boxes of its objects.

Depth predicts where a pixel of one capture lies in another, from the same centre or from one beside it. The
other must show the same surface there, or a nearer one that hides it, and never one behind it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.compose.light_checks import entered
from omniscv.diagnostics import Finding
from omniscv.diagnostics.self_calibration import GREY, Picture, inside, light_findings, sample
from omniscv.diagnostics.server import FACES, RawCamera
from omniscv.geometry import Array, Pose, pinhole
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.sources.base import Color, View
from omniscv.sources.codecs import UNREAL_SKY

Mask = NDArray[np.bool_]

_TURNED = ((20, 35), (80, -40), (140, 10), (200, 50), (260, -25), (320, -55))
"""Yaw and pitch, degrees, of views that are compared with the faces."""
_BESIDE = np.array((0.6, -0.7, 0.39))  # a direction that is no axis of any face
# How far along it the second centre is, at most:
_BESIDE_M = 0.5
_BESIDE_SHARE = 0.4  # of the nearest distance
_FAR_M = 1e6  # of the sky
_SMOOTH = 2e-3  # second differences of inverse depth, relative, below which it is interpolated
# By how much captures may differ:
_DEPTH = 2e-3  # relative
_LEVELS = 4.0  # grey levels of colours
_SHARE = 0.01  # of the pixels
_AGAIN_LEVELS = 0.5  # of a view that is captured again, at the mean
# The scale of depth:
_SCALE = 4e-3  # by which it may be off
_NEARLY = 0.02  # relative difference of depth up to which a point counts
_LEAST_M = 0.05  # by which a centre is nearer, for its points to count
_AROUND = np.ones((5, 5), np.uint8)
# Things that come and go:
_GONE = 0.05  # relative depth by which another capture sees farther
_GONE_SHARE = 5e-4  # of the pixels, which may
# Objects:
_LEAST_PX = 60  # of an object that is judged
_OF_OBJECT = 0.25  # share of its points that may be outside its box
_OF_COLORS = 0.015  # share of its colours that may differ
_OUTSIDE_M = 0.03  # how far outside counts, plus:
_OUTSIDE = 0.01  # of the distance
_CROSSED_PX = 150  # rays that enter the box of an object that is not shown
# Spheres around the camera:
_SPHERE = 2e-3  # relative difference of their distances
_SPHERE_PX = 2000  # least pixels
_MOST_PX = 4  # by which colours are looked for beside the masks' edges
_EFFECTS = (
    "see exposure and vignette; no compression; vrun r.BloomQuality 0, r.LensFlareQuality 0, "
    "r.SSR.Quality 0, r.PostProcessAAQuality 0"
)
"""Effects that make pictures of one surface differ (protocol reference, section 7.1)."""

_THIN = "things thinner than a pixel (face_size), or nearer than the near clipping plane"
_POSES = "check field of view, poses and the meaning of depth; pause the game"


@dataclass(frozen=True)
class ViewCapture:
    """Captures of one view in three modes.

    Attributes:
        view: pose and field of view.
        lit: (H, W, 3) float32.
        depth: (H, W) planar metres; ``_FAR_M`` for the sky.
        mask: (H, W) int64, codes of the mask colours; 0 unless ``has_mask``.
        has_mask: whether masks are pictures of the same camera.
    """

    view: View
    lit: NDArray[np.float32]
    depth: Array
    mask: NDArray[np.int64]
    has_mask: bool

    @cached_property
    def inverse(self) -> Array:
        """(H, W) one over depth, which is linear on planes."""
        return np.asarray(1 / np.maximum(self.depth, 1e-3))

    @cached_property
    def smooth(self) -> Mask:
        """(H, W) where inverse depth may be interpolated, and the mask has one colour."""
        bend = np.abs(cv2.Laplacian(self.inverse, cv2.CV_64F)) < _SMOOTH * self.inverse
        codes = self.mask.astype(np.float32)
        bend &= cv2.dilate(codes, np.ones((3, 3))) == cv2.erode(codes, np.ones((3, 3)))
        return np.asarray(cv2.erode(bend.astype(np.uint8), np.ones((3, 3), np.uint8)), np.bool_)

    @cached_property
    def points_w(self) -> Array:
        """(H, W, 3) what the pixels show, world frame."""
        v, u = np.mgrid[: self.view.height, : self.view.width] + 0.5
        rays = pinhole.rays(np.stack([u, v], axis=-1), self.view.projection)
        return self.view.pose.to_world(rays * self.depth[..., None])


class Overlap(NamedTuple):
    """Two captures compared at the same points, (N,) each.

    Attributes:
        behind: how much farther the first sees than the point, relative, on smooth surfaces.
        scale: the error of depth's scale, from how much nearer the point is to the second's centre.
        gone: of all surfaces, whether the first sees farther in all of the 5 x 5 pixels around the point.
        masks: whether colours of masks differ, where depth agrees.
        lit: by how many levels colours differ, where depth agrees.
        objects: codes of the mask's colours where depth agrees.
    """

    behind: Array
    scale: Array
    gone: Mask
    masks: Mask
    lit: Array
    objects: NDArray[np.int64]

    @classmethod
    def of(cls, first: ViewCapture, second: ViewCapture) -> Overlap:
        """Compare the surfaces of the ``second`` with the ``first``."""
        uvz = first.view.project(second.points_w)
        common = inside(uvz, first.view) & (second.depth < _FAR_M)
        at = np.where(common[..., None], uvz[..., :2], 0).astype(np.int64)
        there = (at[..., 1], at[..., 0])
        gone = (cv2.erode(first.depth, _AROUND)[there] > (1 + _GONE) * uvz[..., 2])[common]
        common &= second.smooth & first.smooth[there]
        expected = uvz[..., 2][common]
        behind = 1 / np.maximum(sample(first.inverse, uvz)[common], 1 / _FAR_M) / expected - 1
        same = np.abs(behind) < _DEPTH
        nearer = (second.view.pose.position - first.view.pose.position) @ first.view.pose.R_w_c[:, 2]
        known = (np.abs(behind) < _NEARLY) & (abs(nearer) > _LEAST_M)
        scale = (behind * expected)[known] / (nearer or 1.0)
        shared = (there[0][common][same], there[1][common][same])
        least = cv2.erode(first.lit, _AROUND)[shared]
        most = cv2.dilate(first.lit, _AROUND)[shared]
        lit = second.lit[common][same]
        levels = np.maximum(least - lit, lit - most).max(axis=-1, initial=0.0)
        objects = second.mask[common][same]
        return cls(behind, scale, gone, first.mask[shared] != objects, levels, objects)

    @classmethod
    def of_pairs(cls, captures: Iterable[ViewCapture], others: Sequence[ViewCapture]) -> Overlap:
        """Compare each of some ``captures`` with each of the ``others``, both ways."""
        overlaps = []
        for capture, other in product(captures, others):
            overlaps.append(cls.of(capture, other))
            overlaps.append(cls.of(other, capture))
        return cls(*map(np.concatenate, zip(*overlaps, strict=True)))


def capture_views(
    camera: RawCamera, angles: Iterable[tuple[float, float]], beside_m: Array
) -> list[ViewCapture]:
    """Capture views in three modes at a centre beside the camera's position.

    Args:
        camera: it is left where it was.
        angles: yaw and pitch of each view, degrees.
        beside_m: (3,) from the camera's position to the centre, world frame, metres.
    """
    start = camera.position
    captures = []
    camera.position = start + beside_m
    for yaw_deg, pitch_deg in angles:
        captures.append(_captured(camera, camera.go(yaw_deg, pitch_deg)))
    camera.position = start
    return captures


def _captured(camera: RawCamera, pose: Pose) -> ViewCapture:
    """Capture a view in three modes, of a camera that is at a pose."""
    lit = camera.pixels("lit")
    depth = camera.pixels("depth")
    mask = camera.pixels("object_mask")
    view = View(pose, camera.fov_deg, lit.shape[1], lit.shape[0])
    kind, unit = camera.driver.table.depth
    metres = depth.astype(np.float64) * (0.01 if unit == "cm" else 1.0)
    planar = metres / (view.ray_lengths() if kind == "ray" else 1)
    has_mask = camera.driver.mask_fov_deg is None and mask.shape == lit.shape
    codes = np.zeros(lit.shape[:2], np.int64)
    if has_mask:
        codes = mask.astype(np.int64) @ (1 << 16, 1 << 8, 1)
    return ViewCapture(
        view, lit.astype(np.float32), np.where(depth < UNREAL_SKY, planar, _FAR_M), codes, has_mask
    )


def findings(
    camera: RawCamera, colors: Mapping[str, Color], boxes: Mapping[str, ObjectBox]
) -> Iterator[Finding]:
    """Yield findings from captures around one centre.

    Args:
        camera: captures 19 views in three modes.
        colors: of the objects in masks.
        boxes: of objects, world frame.
    """
    here = np.zeros(3)
    faces = capture_views(camera, FACES.values(), here)
    turned = capture_views(camera, _TURNED, here)
    nearest = min(float(capture.depth.min()) for capture in faces)
    beside = capture_views(camera, FACES.values(), min(_BESIDE_M, _BESIDE_SHARE * nearest) * _BESIDE)
    (again,) = capture_views(camera, [FACES["front"]], here)
    names = {}
    for name, (red, green, blue) in colors.items():
        names[red << 16 | green << 8 | blue] = name
    yield _again(faces[0], again)
    yield from light_findings(product(map(_grey, faces), map(_grey, turned)), camera.fov_deg)
    by_turning = Overlap.of_pairs(faces, turned)
    by_moving = Overlap.of_pairs(faces, beside)
    yield from _agree("turned", by_turning, np.abs(by_turning.behind))
    yield from _agree("moved", by_moving, by_moving.behind)
    scale = float(np.median(by_moving.scale)) if len(by_moving.scale) >= _LEAST_PX else 0.0
    value = f"{scale:+.2%} against the camera's moves"  # depth grows by more than the camera moved
    yield Finding.unless(abs(scale) <= _SCALE, "depth scale", value, "bad", "check the scale of the world")
    share = float(np.concatenate([by_turning.gone, by_moving.gone]).mean())
    value = f"{share:.2%} of what one capture shows, another looks through"
    yield Finding.unless(share <= _GONE_SHARE, "things that come and go", value, "warning", _THIN)
    yield _view_dependent(by_moving, names)
    yield _aligned([*faces, *turned])
    yield _spheres([*faces, *turned], names)
    if boxes and faces[0].has_mask:
        yield _boxes([*faces, *turned], names, boxes)


def _grey(capture: ViewCapture) -> Picture:
    """Return the brightness (H, W) of a capture."""
    return Picture(capture.lit @ GREY, capture.view.pose)


def _again(first: ViewCapture, again: ViewCapture) -> Finding:
    lit = float(np.abs(first.lit - again.lit).mean())
    depth = float((np.abs(again.depth / np.maximum(first.depth, 1e-3) - 1) > _DEPTH / 4).mean())
    masks = float((first.mask != again.mask).mean())
    same = lit <= _AGAIN_LEVELS and max(depth, masks) <= _SHARE
    value = f"colours {lit:.1f} levels off at the mean, {depth:.1%} of depth, {masks:.1%} of masks"
    return Finding.unless(same, "same again", value, "bad", f"pause the game; {_EFFECTS}")


def _agree(how: str, overlap: Overlap, off: Array) -> Iterator[Finding]:
    """Yield whether depth, off by ``off``, masks and colours agree."""
    if len(off) < _LEAST_PX:
        remedy = "give --position where more is visible"
        yield Finding(f"depth, {how}", "nothing to compare", "warning", remedy)
        return
    wrong = float((off > _DEPTH).mean())
    yield Finding.unless(wrong <= _SHARE, f"depth, {how}", f"{wrong:.2%} disagrees", "bad", _POSES)
    if len(overlap.lit) >= _LEAST_PX:  # surfaces are where the other capture shows them
        for name, differ in (("masks", overlap.masks), ("colours", overlap.lit > _LEVELS)):
            share = float(differ.mean())
            yield Finding.unless(share <= _SHARE, f"{name}, {how}", f"{share:.2%} disagree", "bad", _EFFECTS)


def _view_dependent(overlap: Overlap, names: Mapping[int, str]) -> Finding:
    """Find objects whose colours change with the centre: they mirror, or something is seen through them."""
    objects = overlap.objects
    lit = overlap.lit
    changing = []
    for code in np.unique(objects):
        levels = lit[objects == code]
        if len(levels) >= _LEAST_PX and (levels > _LEVELS).mean() > _OF_COLORS:
            changing.append(names.get(code, "?"))
    remedy = "use strategy exact, which takes every colour from its own centre"
    value = ", ".join(changing) or "nothing"
    return Finding.unless(not changing, "colours that depend on the view", value, "bad", remedy)


def _aligned(captures: Sequence[ViewCapture]) -> Finding:
    """Measure how far the edges of colours lie beside those of masks, px."""
    name = "colours over masks"
    if not all(capture.has_mask for capture in captures):
        return Finding(name, "masks are pictures of another camera")
    offsets: list[str] = []
    inner = (slice(_MOST_PX, -_MOST_PX),) * 2
    for axis, direction in ((1, "right"), (0, "down")):
        scores = np.zeros(2 * _MOST_PX + 1)
        for capture in captures:
            edges = np.diff(capture.mask, axis=axis)[inner] != 0
            steps = np.abs(np.diff(capture.lit, axis=axis)).sum(axis=-1)
            for index in range(len(scores)):
                scores[index] += np.roll(steps, _MOST_PX - index, axis)[inner][edges].sum()
        px = int(scores.argmax()) - _MOST_PX
        if px != 0:
            offsets.append(f"{px} px {direction}")
    value = ", ".join(offsets) or "aligned"
    return Finding.unless(not offsets, name, value, "bad", "capture all modes at one size, with one camera")


def _spheres(captures: Sequence[ViewCapture], names: Mapping[int, str]) -> Finding:
    """Find objects that are spheres around the camera: domes that stand for the sky."""
    domes = []
    distance = np.stack([capture.depth * capture.view.ray_lengths() for capture in captures])
    mask = np.stack([capture.mask for capture in captures])
    codes = np.unique(mask[distance < _FAR_M]).tolist() if captures[0].has_mask else []
    for code in codes:
        distances = distance[mask == code]
        if len(distances) >= _SPHERE_PX and np.ptp(distances) < _SPHERE * distances.mean():
            domes.append(f"{names.get(code, '?')} at {distances.mean():.4g} m")
    remedy = "hide it (--set hide=NAME), or depth there is no distance"
    return Finding.unless(not domes, "domes", ", ".join(domes) or "none", "bad", remedy)


def _boxes(
    captures: Sequence[ViewCapture], names: Mapping[int, str], boxes: Mapping[str, ObjectBox]
) -> Finding:
    """Find objects that masks and depth show outside their boxes, or not at all though nothing hides them."""
    points = np.concatenate([capture.points_w.reshape(-1, 3) for capture in captures])
    mask = np.concatenate([capture.mask.reshape(-1) for capture in captures])
    center = captures[0].view.pose.position
    reach = np.linalg.norm(points - center, axis=1)
    wrong = []
    for code, name in names.items():
        if name not in boxes:
            continue
        box = boxes[name]
        is_object = mask == code
        if is_object.sum() >= _LEAST_PX:
            beyond = np.abs((points[is_object] - box.center_w) @ box.R_w_b) - box.size / 2
            slack = _OUTSIDE_M + _OUTSIDE * reach[is_object]
            if (reach[is_object] >= _FAR_M).all():
                wrong.append(f"{name} has no depth")
            elif (beyond.max(axis=1) > slack).mean() > _OF_OBJECT:
                wrong.append(f"{name} is elsewhere")
        elif not is_object.any() and entered(center, points, box, _CROSSED_PX):
            wrong.append(f"{name} is not shown")
    value = ", ".join(wrong) or f"{len(boxes)} in their boxes"
    remedy = "give it a mask colour and an opaque material; check units, poses and the field of view"
    return Finding.unless(not wrong, "objects where they should be", value, "bad", remedy)
