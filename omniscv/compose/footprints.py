"""What pixels span on the sphere of directions."""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.compose import kernels
from omniscv.compose.kernels import Floats, Ints
from omniscv.geometry import Array
from omniscv.planning.viewpoints import CameraRays, unproject

_SUBRAYS = 8
"""Per axis of a pixel at the rim, to find its part inside the field of view."""


@dataclass(frozen=True, eq=False)
class Footprints:
    """What N pixels span.

    Attributes:
        edges: (N, 2, 3) float32, the change of the unit ray across the pixel, along u and along v.
        rim: (M,) indices of pixels that the end of the field of view cuts; their edges span the part inside.
        centers: (M, 3) rays through the middle of that part.
    """

    edges: Floats
    rim: Ints
    centers: Array


class ImageFootprints:
    """What an image's pixels span.

    Args:
        rays: of the camera.
    """

    def __init__(self, rays: CameraRays) -> None:
        self._rays = rays

    def of(self, pixels: Ints, first: int = 0, around: Array | None = None) -> Footprints:
        """Return what (N,) flat pixel indices span, in the camera frame.

        Args:
            pixels: the indices.
            first, around: the number of a row, and the (h, W, 3) rays of it and those that follow, as far as
                pixels and their neighbours lie there; all rows if not given.
        """
        edges = np.empty((len(pixels), 2, 3), np.float32)
        rays = self._rays.directions if around is None else around
        kernels.run(_measure, (pixels - first * rays.shape[1], edges), rays)
        known, centers, turns = self._rim
        at = np.searchsorted(known, pixels)
        rim = np.flatnonzero(known[np.minimum(at, len(known) - 1)] == pixels) if len(known) else at[:0]
        edges[rim] = turns[at[rim]] @ edges[rim]
        return Footprints(edges, rim, centers[at[rim]])

    @cached_property
    def _rim(self) -> tuple[Ints, Array, Floats]:
        """Pixels at the rim, the middle of their part inside the field of view, and (2, 2) that turn a
        pixel's edges into those of a box with the part's own second moments."""
        valid, width = self._rays.valid, self._rays.valid.shape[1]
        inner = cv2.erode(valid.astype(np.uint8), np.ones((3, 3)), borderValue=1)
        pixels = np.flatnonzero(valid.ravel() & (inner.ravel() == 0))
        at = (np.arange(_SUBRAYS) + 0.5) / _SUBRAYS - 0.5
        offsets = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
        middles = np.stack(np.divmod(pixels, width)[::-1], axis=-1) + 0.5
        rays = unproject(self._rays.camera, middles[:, None] + offsets)
        some = rays.valid.any(axis=1)
        pixels, inside = pixels[some], rays.valid[some, :, None]
        share = inside / inside.sum(axis=1, keepdims=True)
        centers = (share * np.where(inside, rays.directions[some], 0)).sum(axis=1)
        apart = offsets - (share * offsets).sum(axis=1, keepdims=True)
        moments = np.einsum("nki,nkj->nij", share * apart, apart) / np.mean(at**2)
        spread, axes = np.linalg.eigh(moments)
        turns = np.sqrt(np.maximum(spread, 0))[:, :, None] * np.swapaxes(axes, 1, 2)
        return pixels, centers, turns.astype(np.float32)


def squares(directions: Array, steps: Floats) -> Footprints:
    """Return square footprints, whose edges are (N,) radians long, around (N, 3) rays of any length."""
    least = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    edges = np.empty((len(directions), 2, 3))
    edges[:, 0] = np.cross(directions, least)
    edges[:, 1] = np.cross(directions, edges[:, 0])
    edges *= (steps[:, None] / np.linalg.norm(edges, axis=-1))[..., None]
    return Footprints(edges.astype(np.float32), np.empty(0, np.int64), np.empty((0, 3)))


@njit(cache=True, nogil=True)
def _measure(pixels: Ints, edges: Floats, directions: Array) -> None:
    """Write the edges of pixels: half of what lies between their neighbours, or all to the nearer one of two
    where rays jump, or to the only one."""
    height, width = directions.shape[:2]
    changes, lengths = np.empty((2, 3)), np.empty(2)
    for i in range(pixels.shape[0]):
        row, column = pixels[i] // width, pixels[i] % width
        for axis in range(2):
            down, across = axis, 1 - axis
            for side in range(2):
                sign = 2 * side - 1
                r, c = row + sign * down, column + sign * across
                lengths[side], squares = np.inf, 0.0
                if 0 <= r < height and 0 <= c < width and not math.isnan(directions[r, c, 0]):
                    for k in range(3):
                        changes[side, k] = sign * (directions[r, c, k] - directions[row, column, k])
                        squares += changes[side, k] ** 2
                    lengths[side] = math.sqrt(squares)
            least = min(lengths[0], lengths[1])
            for k in range(3):
                total, used = 0.0, 0
                for side in range(2):
                    if lengths[side] <= 2.0 * least and lengths[side] < np.inf:
                        total += changes[side, k]
                        used += 1
                edges[i, axis, k] = total / max(used, 1)
