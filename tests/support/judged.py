"""An image against the exact truth of its scene: what is wrong, and whether its marks say so."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.chart import Tracer, traced
from omniscv.compose.image import OmniImage

Mask = NDArray[np.bool_]

_CREASE = np.cos(np.radians(20))
_A_PIXEL = 4
"""Steps of rays that are traced beside another within a captured pixel."""


@dataclass(frozen=True)
class Judgement:
    """One image, all as parts of its valid pixels but for metres and ratios.

    Attributes:
        wrong_labels: labels that are not those of the pixels' own rays.
        depth_50_m, depth_99_m: quantiles of the error of finite depth.
        off_1_percent: depth that is off by more than 1 %, or finite where the truth is not.
        normals_20_deg: normals more than 20 degrees off those of every surface within a pixel.
        uncovered: depth off by more than its bound, or a label wrong and not at an edge, and not unsure.
        thin: pixels of what is thinner than a capture's pixel, wrong and not marked: no capture can show it.
        unsure: marked as verified by no capture; ``unsure_wrong``: the part of them that is wrong.
        label_edge: marked as at a label boundary.
        tightness: the median of the bound over the median of the error.
    """

    wrong_labels: float
    depth_50_m: float
    depth_99_m: float
    off_1_percent: float
    normals_20_deg: float
    uncovered: float
    thin: float
    unsure: float
    unsure_wrong: float
    label_edge: float
    tightness: float


class Errors:
    """What an image with depth and object masks has wrong, pixel by pixel.

    Attributes:
        depth_m: (H, W) the error of depth; 0 where both are +inf, +inf where one is.
        label: (H, W) whether the label is another one.
        uncovered: (H, W) wrong and not marked; ``thin``: the same, of what is narrower than a captured
            pixel, such as wires and slits: it may fall between pixels.

    Args:
        image: with depth and object masks.
        scene: what it shows.
        focal_px: of the faces of a cube that it was captured with; None: nothing is too narrow for them.
    """

    def __init__(self, image: OmniImage, scene: Tracer, focal_px: float | None = None) -> None:
        hits = traced(scene, image.camera, image.pose)
        depth, bound, labels = image.depth, image.depth_error, image.labels
        self.image, self.hits = image, hits
        both = np.isposinf(depth) & np.isposinf(hits.distance)
        with np.errstate(invalid="ignore"):
            self.depth_m = np.where(both, 0.0, np.abs(depth - hits.distance))
            self.label = labels != hits.label
            off = self.depth_m > bound
        unmarked = image.valid & ~image.unsure & (off | (self.label & ~image.label_edge))
        hidden = np.zeros(unmarked.shape, np.bool_)
        if focal_px is not None:
            hidden[unmarked] = _too_thin(scene, image, unmarked, self.depth_m, focal_px)
        self.uncovered, self.thin = unmarked & ~hidden, unmarked & hidden

    def judgement(self) -> Judgement:
        """Return the errors in numbers."""
        image, valid, hits = self.image, self.image.valid, self.hits
        error, bound = self.depth_m[valid], image.depth_error[valid]
        finite = np.isfinite(error) & np.isfinite(hits.distance[valid])
        with np.errstate(invalid="ignore"):
            off = self.depth_m > 0.01 * hits.distance
        unsure = image.unsure & valid
        if not finite.any():  # all of it is sky
            finite = np.ones_like(finite)
            error, bound = np.zeros_like(error), np.zeros_like(bound)
        least, most = np.median(error[finite]), np.median(bound[finite])
        return Judgement(
            wrong_labels=float(self.label[valid].mean()),
            depth_50_m=float(least),
            depth_99_m=float(np.quantile(error[finite], 0.99)),
            off_1_percent=float(off[valid].mean()),
            normals_20_deg=float(_normals_off(image, hits.normal)[valid].mean()),
            uncovered=float(self.uncovered[valid].mean()),
            thin=float(self.thin[valid].mean()),
            unsure=float(unsure[valid].mean()),
            unsure_wrong=float((off | self.label)[unsure].mean()) if unsure.any() else 1.0,
            label_edge=float(image.label_edge[valid].mean()),
            tightness=float(most / least) if least > 0 else float("inf"),
        )


def _too_thin(scene: Tracer, image: OmniImage, pixels: Mask, wrong_m: NDArray[Any], focal_px: float) -> Mask:
    """Return which of the pixels have two edges within a captured pixel of their rays: a wire, a slit.

    At an edge labels change, surfaces turn by 20 degrees, or distance jumps by half of what is wrong, beyond
    the plane of what is met before. Rays are traced along four lines through each pixel's own, a quarter of
    a captured pixel apart.
    """
    rays, pose = image.camera.unproject(), image.pose
    origins_w = np.broadcast_to(pose.to_world(rays.origins), rays.directions.shape)[pixels][:, None, None]
    toward = rays.directions[pixels] @ pose.R_w_c.T
    step = np.abs(toward).max(axis=-1) / focal_px / _A_PIXEL
    turn = np.arange(4) * np.pi / 4
    axes = np.linalg.svd(toward[:, None])[2]  # the ray, and two axes across
    lines = np.cos(turn)[:, None] * axes[:, 1, None] + np.sin(turn)[:, None] * axes[:, 2, None]
    offsets = step[:, None] * np.arange(-_A_PIXEL, _A_PIXEL + 1)
    directions = toward[:, None, None] + offsets[:, None, :, None] * lines[:, :, None]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    hits = scene.trace(np.broadcast_to(origins_w, directions.shape), directions)
    normal, away = hits.normal[..., :-1, :], hits.distance
    with np.errstate(invalid="ignore", divide="ignore"):
        here = np.sum(normal * directions[..., :-1, :], axis=-1)
        there = np.sum(normal * directions[..., 1:, :], axis=-1)
        jump_m = np.abs(away[..., 1:] - away[..., :-1] * here / there)
        edges = ~(jump_m <= wrong_m[pixels][:, None, None] / 2) & np.isfinite(away).any(axis=-1)[..., None]
    edges |= hits.label[..., 1:] != hits.label[..., :-1]
    edges |= np.sum(normal * hits.normal[..., 1:, :], axis=-1) < _CREASE
    windows = np.lib.stride_tricks.sliding_window_view(edges, _A_PIXEL, axis=-1)
    return np.asarray((windows.sum(axis=-1) >= 2).any(axis=(1, 2)))


def _normals_off(image: OmniImage, normals_w: NDArray[np.float64]) -> Mask:
    """Where normals are more than 20 degrees off all true ones within a pixel; nowhere without normals."""
    if image.normals is None:
        return np.zeros(image.valid.shape, np.bool_)
    own_w = image.normals @ image.pose.R_w_c.T
    near = np.zeros(image.valid.shape, np.bool_)
    for step in product((-1, 0, 1), repeat=2):
        other = np.roll(normals_w, step, axis=(0, 1))
        near |= np.nan_to_num(np.sum(own_w * other, axis=-1)) >= _CREASE
    return image.valid & ~near & np.isfinite(image.depth if image.depth is not None else 0.0)
