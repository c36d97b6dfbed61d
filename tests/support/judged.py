"""An image against the exact truth of its scene: what is wrong, and whether its marks say so."""

from __future__ import annotations

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


class Errors:
    """What an image of a scene, with depth and object masks, has wrong, pixel by pixel.

    ``depth_m`` is the error of depth, 0 where both are +inf, +inf where one is; ``label`` is true for another
    label, ``uncovered`` for what is wrong and not marked, ``thin`` for such wires and slits as are narrower
    than a pixel of a cube's faces with ``focal_px``: they may fall between pixels. Without it none are.
    """

    def __init__(self, image: OmniImage, scene: Tracer, focal_px: float | None = None) -> None:
        hits = traced(scene, image.camera, image.pose)
        depth = image.depth
        bound = image.depth_error
        labels = image.labels
        self.image = image
        self.hits = hits
        both = np.isposinf(depth) & np.isposinf(hits.distance)
        with np.errstate(invalid="ignore"):
            self.depth_m = np.where(both, 0.0, np.abs(depth - hits.distance))
            self.label = labels != hits.label
            off = self.depth_m > bound
        unmarked = image.valid & ~image.unsure & (off | (self.label & ~image.label_edge))
        hidden = np.zeros(unmarked.shape, np.bool_)
        if focal_px is not None:
            hidden[unmarked] = _too_thin(scene, image, unmarked, self.depth_m, focal_px)
        self.uncovered = unmarked & ~hidden
        self.thin = unmarked & hidden

    def unsure_wrong(self) -> float:
        """Return the share of the pixels that are marked as unsure whose depth, by 1 %, or label is wrong."""
        with np.errstate(invalid="ignore"):
            wrong = (self.depth_m > 0.01 * self.hits.distance) | self.label
        return float(wrong[self.image.unsure & self.image.valid].mean())

    def normals_off(self) -> float:
        """Return the share of the valid pixels whose normals are more than 20 degrees off those of every
        surface within a pixel."""
        image = self.image
        own_w = image.normals @ image.pose.R_w_c.T
        near = np.zeros(image.valid.shape, np.bool_)
        for step in product((-1, 0, 1), repeat=2):
            other = np.roll(self.hits.normal, step, axis=(0, 1))
            near |= np.nan_to_num(np.sum(own_w * other, axis=-1)) >= _CREASE
        return float((~near & np.isfinite(image.depth))[image.valid].mean())


def _too_thin(scene: Tracer, image: OmniImage, pixels: Mask, wrong_m: NDArray[Any], focal_px: float) -> Mask:
    """Return which of the pixels have two edges within a captured pixel of their rays: a wire, a slit.

    At an edge labels change, surfaces turn by 20 degrees, or distance jumps by half of what is wrong, beyond
    the plane of what is met before. Rays are traced along four lines through each pixel's own, a quarter of
    a captured pixel apart.
    """
    rays = image.camera.unproject()
    pose = image.pose
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
    normal = hits.normal[..., :-1, :]
    away = hits.distance
    with np.errstate(invalid="ignore", divide="ignore"):
        here = np.sum(normal * directions[..., :-1, :], axis=-1)
        there = np.sum(normal * directions[..., 1:, :], axis=-1)
        jump_m = np.abs(away[..., 1:] - away[..., :-1] * here / there)
        edges = ~(jump_m <= wrong_m[pixels][:, None, None] / 2) & np.isfinite(away).any(axis=-1)[..., None]
    edges |= hits.label[..., 1:] != hits.label[..., :-1]
    edges |= np.sum(normal * hits.normal[..., 1:, :], axis=-1) < _CREASE
    windows = np.lib.stride_tricks.sliding_window_view(edges, _A_PIXEL, axis=-1)
    return np.asarray((windows.sum(axis=-1) >= 2).any(axis=(1, 2)))
