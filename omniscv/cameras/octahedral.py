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
    there twice, about its middle: ``project`` answers the side that the sign of x or y says.
    Source: Cigolle et al. 2014, A survey of efficient representations for independent unit vectors.
    """

    name = "octahedral"

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)
        self._size = np.array([self.width, self.height])

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        x, y = (np.clip(2 * pixels[..., i] / size - 1, -_EDGE, _EDGE) for i, size in enumerate(self._size))
        z = 1 - np.abs(x) - np.abs(y)
        x, y = _folded(x, y, z)
        scale = 1 / np.sqrt(x * x + y * y + z * z)
        return np.stack([x * scale, y * scale, z * scale], axis=-1), True

    def _project(self, points: Array) -> tuple[Array, bool]:
        n = points / np.abs(points).sum(axis=-1, keepdims=True)
        ab = np.stack(_folded(n[..., 0], n[..., 1], n[..., 2]), axis=-1)
        return (ab + 1) / 2 * self._size, True


def _folded(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Where z < 0: mirrored at the edges of the square's inner diamond, which swaps its halves."""
    back = z < 0
    folded = np.copysign(1 - np.abs(y), x), np.copysign(1 - np.abs(x), y)
    return np.where(back, folded[0], x), np.where(back, folded[1], y)
