"""The filter ``area``: a pixel shows the mean of its footprint.

A pixel's footprint in a view is a parallelogram, sampled by bilinear interpolation on a regular grid in it,
at a mip level of which it spans a few pixels. Interpolation and mip level are filters, too. The grid is
narrower than the footprint, so that grid, interpolation and mip level together have the second moments of a
box of the footprint's size. From a pixel that spans sqrt(2) px on, sinusoids then have the contrast of the
mean.
"""

from collections.abc import Sequence

import numpy as np

from omniscv.compiled import njit
from omniscv.compose.atlas import Atlas
from omniscv.depth.ray_lookup import RayLookup, look_up
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Pixels, Rows, run
from omniscv.planning.densities import Footprints
from omniscv.sources.base import View

_NARROW = 2.0
_WIDE = 16.0
"""px of a mip level that a footprint spans at least along its narrower side, if the level is not 0, and at
most."""

_SPACING = 1.5
"""Level px between samples at most. With less, sinusoids of 1.2 px of the image gain less than half a grey
level of 255; with 1.75, they lose one to two."""

_SMALLEST_LEVEL = 8  # px, width or height of a view at its coarsest level


class AreaSampling:
    """How pixels are averaged.

    Args:
        footprints: of N rays, in a frame d.
        lookup: of the rays.
        views: all of one size.
        R_w_d: (3, 3) from that frame to the world.

    Attributes:
        levels: the mip levels that the rays need of an atlas; empty if views see none of them.
        support: px of the gutter that they need.
    """

    def __init__(
        self, footprints: Footprints, lookup: RayLookup, views: Sequence[View], R_w_d: Array
    ) -> None:
        self._lookup = lookup = _rim_moved(lookup, footprints, views, R_w_d)
        count = len(lookup.view)
        first = views[0]
        self._level = level = np.empty(count, np.uint8)
        self._counts = np.empty((count, 2), np.uint8)
        self._spacing = np.empty((count, 2, 2), np.float32)
        R_c_d = np.ascontiguousarray([view.pose.R_w_c.T @ R_w_d for view in views])
        projections = np.array([view.projection for view in views])
        coarsest = max(0, int(np.log2(min(first.width, first.height) / _SMALLEST_LEVEL)))
        rows = lookup.view, lookup.x, lookup.y, footprints.edges, level, self._counts, self._spacing
        support = run(_place, rows, R_c_d, projections, (first.width, first.height, coarsest), as_one=True)
        used = level[lookup.view >= 0]
        self.levels = range(int(used.min()), int(used.max()) + 1) if len(used) else range(0)
        self.support = max(support, default=0)

    def coordinates(self, atlas: Atlas) -> tuple[Floats, Floats]:
        """Return where the rays lie in the picture of an atlas."""
        return atlas.coordinates(self._lookup, self._level)

    def sample(self, picture: Pixels, x: Floats, y: Floats) -> Pixels:
        """Return (N, ...) means, rounded where they are integers; 0 where no view sees the ray.

        Args:
            picture: of an atlas.
            x, y: (N,) as :meth:`coordinates` returns them.
        """
        planes = picture if picture.ndim == 3 else picture[..., None]
        last = planes.shape[2] - 1
        out = np.empty((len(x), last + 1), picture.dtype)
        half = np.float32(0.5 if picture.dtype.kind == "u" else 0)
        rows = x, y, self._counts, self._spacing, out
        for k in range(0, last + 1, 3):
            run(_sample, rows, planes, k, min(k + 1, last), min(k + 2, last), half, as_one=True)
        return out.reshape(-1, *picture.shape[2:])

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        return self._counts.nbytes + self._spacing.nbytes + self._level.nbytes + self._lookup.nbytes


def _rim_moved(lookup: RayLookup, footprints: Footprints, views: Sequence[View], R_w_d: Array) -> RayLookup:
    """Return the lookup with pixels at the rim looked up in the middle of their part inside, if a view sees
    it."""
    if len(footprints.rim) == 0:
        return lookup
    inside = look_up(footprints.centers, views, R_w_d)
    seen = inside.view >= 0
    rim = footprints.rim[seen]
    view = lookup.view.copy()
    x = lookup.x.copy()
    y = lookup.y.copy()
    view[rim] = inside.view[seen]
    x[rim] = inside.x[seen]
    y[rim] = inside.y[seen]
    return RayLookup(view, x, y, min(lookup.margin, inside.margin), lookup.used | inside.used)


@njit(
    "(int16[::1], float32[::1], float32[::1], float32[:, :, ::1], out uint8[::1], out uint8[:, ::1], "
    "out float32[:, :, ::1]), float64[:, :, ::1], float64[:, ::1], (int64, int64, int64) -> int64",
    nogil=True,
)
def _place(rays: Rows, R_c_d: Array, projections: Array, sizes: tuple[int, int, int]) -> int:  # noqa: PLR0915 - a kernel
    """Write how rays are averaged: the mip level of each, the counts of its grid of samples and the steps
    between them, px of that level. Return how far samples reach beyond their view, px."""
    (view, x, y, edges, level, counts, spacing), (width, height, coarsest) = rays, sizes
    support = 0
    spans = np.empty((2, 2))
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            level[i] = counts[i, 0] = counts[i, 1] = 0
            continue
        R = R_c_d[k]
        fx, fy = projections[k, 0], projections[k, 1]
        u, v = (x[i] - projections[k, 2]) / fx, (y[i] - projections[k, 3]) / fy
        length = np.sqrt(1.0 + u * u + v * v)
        for a in range(2):
            e = edges[i, a]
            z = R[2, 0] * e[0] + R[2, 1] * e[1] + R[2, 2] * e[2]
            spans[a, 0] = fx * length * (R[0, 0] * e[0] + R[0, 1] * e[1] + R[0, 2] * e[2] - u * z)
            spans[a, 1] = fy * length * (R[1, 0] * e[0] + R[1, 1] * e[1] + R[1, 2] * e[2] - v * z)
        one, other = np.hypot(spans[0, 0], spans[0, 1]), np.hypot(spans[1, 0], spans[1, 1])
        coarse = max(1.0, min(one, other) / _NARROW, 2.0 * max(one, other) / _WIDE)
        level[i] = min(int(np.log2(coarse)), coarsest)
        px = 2.0 ** level[i]
        reach_x, reach_y = 0.0, 0.0
        for a in range(2):
            full = max(one if a == 0 else other, 1e-9)
            # variances, in twelfths of a level px squared: of the footprint, less those of bilinear
            # interpolation, 2, and of the mip level's own pixels
            rest = max(0.0, (min(full / px, _WIDE)) ** 2 - 3.0 + px**-2)
            n = max(1, int(np.ceil(np.sqrt(rest / _SPACING**2 + 1.0) - 0.05)))
            apart = np.sqrt(rest / (n * n - 1.0)) / full if n > 1 else 0.0
            counts[i, a] = n
            spacing[i, a, 0], spacing[i, a, 1] = apart * spans[a, 0], apart * spans[a, 1]
            reach_x += 0.5 * (n - 1) * abs(spacing[i, a, 0])
            reach_y += 0.5 * (n - 1) * abs(spacing[i, a, 1])
        at_x, at_y = x[i] / px - 0.5, y[i] / px - 0.5
        beyond_x = max(-np.floor(at_x - reach_x), np.floor(at_x + reach_x) + 2 - width // int(px))
        beyond_y = max(-np.floor(at_y - reach_y), np.floor(at_y + reach_y) + 2 - height // int(px))
        support = max(support, int(max(beyond_x, beyond_y)))
    return support


@njit(
    "(float32[::1], float32[::1], uint8[:, ::1], float32[:, :, ::1], out uint8[:, ::1]), uint8[:, :, ::1], "
    "int64, int64, int64, float32",
    "(float32[::1], float32[::1], uint8[:, ::1], float32[:, :, ::1], out float32[:, ::1]), "
    "float32[:, :, ::1], int64, int64, int64, float32",
    nogil=True,
)
def _sample(rows: Rows, picture: Pixels, k0: int, k1: int, k2: int, half: np.float32) -> None:
    """Write means of three channels."""
    x, y, counts, spacing, out = rows
    one = np.float32(1)
    for i in range(x.shape[0]):
        many, more = np.int32(counts[i, 0]), np.int32(counts[i, 1])
        if many == 0:
            out[i, k0] = out[i, k1] = out[i, k2] = 0
            continue
        right, down = spacing[i, 0, 0], spacing[i, 0, 1]
        further_right, further_down = spacing[i, 1, 0], spacing[i, 1, 1]
        a, b = np.float32(0.5) * np.float32(many - 1), np.float32(0.5) * np.float32(more - 1)
        row_x, row_y = x[i] - a * right - b * further_right, y[i] - a * down - b * further_down
        sum0 = sum1 = sum2 = np.float32(0)
        for _ in range(more):
            at_x, at_y = row_x, row_y
            for _ in range(many):
                c, r = int(at_x), int(at_y)
                p, q = at_x - np.float32(c), at_y - np.float32(r)
                w11 = p * q
                w01, w10 = p - w11, q - w11
                w00 = one - p - w10
                n, m = c + 1, r + 1
                sum0 += w00 * np.float32(picture[r, c, k0]) + w01 * np.float32(picture[r, n, k0])
                sum0 += w10 * np.float32(picture[m, c, k0]) + w11 * np.float32(picture[m, n, k0])
                sum1 += w00 * np.float32(picture[r, c, k1]) + w01 * np.float32(picture[r, n, k1])
                sum1 += w10 * np.float32(picture[m, c, k1]) + w11 * np.float32(picture[m, n, k1])
                sum2 += w00 * np.float32(picture[r, c, k2]) + w01 * np.float32(picture[r, n, k2])
                sum2 += w10 * np.float32(picture[m, c, k2]) + w11 * np.float32(picture[m, n, k2])
                at_x, at_y = at_x + right, at_y + down
            row_x, row_y = row_x + further_right, row_y + further_down
        share = one / np.float32(many * more)
        out[i, k0], out[i, k1], out[i, k2] = sum0 * share + half, sum1 * share + half, sum2 * share + half
