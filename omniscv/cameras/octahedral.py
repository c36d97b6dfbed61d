"""The octahedral map: the sphere on a square."""

import numpy as np

from omniscv.cameras.base import Array, CentralCamera
from omniscv.cameras.registry import register

_EDGE = 1 - 2e-15  # what keeps a ray off the square's edge, where two pixels see it


@register
class Octahedral(CentralCamera):
    """The whole sphere on a square: an octahedron unfolded, forward in the middle, backward at the corners.

    With (a, b) = ``(2u/W - 1, 2v/H - 1)``: where ``|a| + |b| <= 1`` the ray is ``(a, b, 1 - |a| - |b|)``,
    normalised; beyond, the back half folds out: ``(sgn a (1 - |b|), sgn b (1 - |a|), 1 - |a| - |b|)``.
    Domain: every pixel, every direction; each edge of the image shows its own half of the great circle
    there twice, about its middle: ``project`` answers the side that the sign of x or y says, + for 0.
    Source: Cigolle et al. 2014, A survey of efficient representations for independent unit vectors.
    """

    name = "octahedral"

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        ab = np.clip(2 * pixels / [self.width, self.height] - 1, -_EDGE, _EDGE)
        size = np.abs(ab)
        z = 1 - size[..., :1] - size[..., 1:]
        rays = np.concatenate([np.where(z >= 0, ab, _folded(ab)), z], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True), True

    def _project(self, points: Array) -> tuple[Array, bool]:
        n = points / np.abs(points).sum(axis=-1, keepdims=True)
        ab = np.where(n[..., 2:] >= 0, n[..., :2], _folded(n[..., :2]))
        return (ab + 1) / 2 * [self.width, self.height], True


def _folded(ab: Array) -> Array:
    """(..., 2) mirrored at the square's inner diamond, which swaps its halves; the sign of 0 is +."""
    return np.where(ab >= 0, 1.0, -1.0) * (1 - np.abs(ab[..., ::-1]))
