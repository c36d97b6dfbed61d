"""The ray lookup: for each ray, the view that sees it and the pixel there."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from omniscv.compiled import njit
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints, Mask, Rows, run
from omniscv.sources.base import View

_BLOCK = 64  # rays that are looked up together
_ALIGNED = 1e-9  # rounding of cosines between axes


@dataclass(frozen=True, eq=False)
class RayLookup:
    """For each ray: the view that sees it most centrally, and the continuous pixel there.

    Attributes:
        view: (N,) int16, -1 where no view sees the ray.
        x, y: (N,) float32 px in that view; pixel centres lie at .5.
        margin: the least distance of a pixel from its view's edges, px; infinite if there are none.
        used: (V,) bool, the views that see rays.
    """

    view: Ints
    x: Floats
    y: Floats
    margin: float
    used: Mask
    _nearest: dict[tuple[int, ...], Ints] = field(default_factory=dict, repr=False)

    def nearest(self, shape: tuple[int, ...]) -> Ints:
        """Return (N,) the nearest pixel of each ray in pictures (V, h, w), as a flat index; -1 for none.

        It is kept: masks, their edges and other values are taken at the same pixels.
        """
        if (known := self._nearest.get(shape)) is not None:
            return known
        kind = np.int32 if math.prod(shape) < 1 << 31 else np.int64
        pixels: Ints = np.empty(len(self.view), kind)
        run(_nearest, (self.view, self.x, self.y, pixels), *shape[1:])
        self._nearest[shape] = pixels
        return pixels

    def by_view(self) -> Iterator[tuple[int, Ints]]:
        """Yield each view that sees rays, and the indices of these."""
        for k in np.flatnonzero(self.used):
            yield int(k), np.flatnonzero(self.view == k)

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        kept = list(self._nearest.values())
        return sum(array.nbytes for array in (self.view, self.x, self.y, *kept))


def look_up(directions: Array, views: Sequence[View], R_w_d: Array | None = None) -> RayLookup:
    """Return the view and the pixel that serve each ray from the views' common centre.

    Args:
        directions: (N, 3), any length; NaN rays get view -1.
        views: at least one; they share their centre and size.
        R_w_d: (3, 3) from the frame of the directions to the world; they are world vectors if not given.
    """
    count = len(directions)
    view = np.empty(count, np.int16)
    x = np.empty(count, np.float32)
    y = np.empty(count, np.float32)
    R_c_d = np.ascontiguousarray([v.pose.R_w_c.T @ (np.eye(3) if R_w_d is None else R_w_d) for v in views])
    projections = np.array([v.projection for v in views])
    half = (views[0].width / 2, views[0].height / 2)
    used = np.zeros(len(views), np.bool_)
    seen_by = R_c_d, projections, half, _sure_px(views, R_c_d), used
    margins = run(_look_up, (directions, view, x, y), seen_by)
    return RayLookup(view, x, y, float(min(margins)), used)


def _sure_px(views: Sequence[View], R_c_d: Array) -> Array:
    """Return (V,) px off a view's centre, across and down, within which no other view sees a ray better.

    A ray within ``m`` focal lengths of a square view's centre, across and down, lies at most
    ``atan(sqrt(2) m)`` off its axis. ``t`` off another view's axis, it lies at least ``tan(t) / sqrt(2)``
    focal lengths off that one's centre. So other views, ``phi`` away, see it less centrally if
    ``sqrt(2) m < tan(phi / 2)``; those along the axes of one cube, if ``m < 1``.
    """
    first = views[0]
    if first.width != first.height or any(view.lens or view.fov_deg != first.fov_deg for view in views):
        return np.zeros(len(views))  # unknown
    phi = np.arccos(np.clip(R_c_d[:, 2] @ R_c_d[:, 2].T, -1, 1))
    np.fill_diagonal(phi, np.pi)
    nearest = phi.min(axis=1)
    turned = np.abs(R_c_d @ R_c_d[0].T)
    cube = nearest.min() > 1 and np.minimum(turned, np.abs(1 - turned)).max() < _ALIGNED
    m = np.ones(len(views)) if cube else np.tan(nearest / 2) / np.sqrt(2)
    return np.asarray(np.minimum(first.focal_px * m, first.width / 2) * (1 - 10 * _ALIGNED))


@njit(
    "int16[::1], float32[::1], float32[::1], out int32[::1], int64, int64",
    "int16[::1], float32[::1], float32[::1], out int64[::1], int64, int64",
    nogil=True,
)
def _nearest(view: Ints, x: Floats, y: Floats, pixels: Ints, height: int, width: int) -> None:
    for i in range(view.shape[0]):
        c, r = min(max(int(x[i]), 0), width - 1), min(max(int(y[i]), 0), height - 1)
        pixels[i] = (view[i] * height + r) * width + c if view[i] >= 0 else -1


@njit(
    "float64[:, ::1], out int16[::1], out float32[::1], out float32[::1], (float64[:, :, ::1], "
    "float64[:, ::1], (float64, float64), float64[::1], out bool[::1]) -> float64",
    nogil=True,
    error_model="numpy",
)
def _look_up(directions: Array, view: Ints, x: Floats, y: Floats, views: Rows) -> float:  # noqa: PLR0915 - a kernel
    """Look up rays block by block; most blocks lie in the view of the last ray: that loop is vectorized."""
    R_c_d, projections, (half_width, half_height), sure, used = views
    last, most_u, most_v, block = 0, 0.0, 0.0, np.empty((3, _BLOCK))
    for first in range(0, directions.shape[0], _BLOCK):
        size = min(_BLOCK, directions.shape[0] - first)
        for i in range(size):  # a line for each coordinate: vectorized loops read threes slowly
            for j in range(3):
                block[j, i] = directions[first + i, j]
        of = slice(first, first + size)
        scale = projections[last, 0], half_width, half_height
        seen, u, v = _in_view(block, R_c_d[last], scale, sure[last], x[of], y[of])
        if seen == size:
            view[of], used[last] = last, True
            most_u, most_v = max(most_u, u), max(most_v, v)
            continue
        for i in range(first, first + size):
            a, b, c = directions[i, 0], directions[i, 1], directions[i, 2]
            best, which, best_u, best_v = 1.0 + 1e-9, -1, 0.0, 0.0
            for n in range(-1, R_c_d.shape[0]):
                k = last if n < 0 else n
                R = R_c_d[k]
                z = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c
                if not z > 0.0:
                    continue
                p = projections[k, 0] * (R[0, 0] * a + R[0, 1] * b + R[0, 2] * c)
                q = projections[k, 1] * (R[1, 0] * a + R[1, 1] * b + R[1, 2] * c)
                p += (projections[k, 2] - half_width) * z  # from the picture's middle
                q += (projections[k, 3] - half_height) * z
                # Divisions take longest: none where the ray lies clearly farther off than in the best view.
                farthest = best * z * (1.0 + 1e-9)
                if abs(p) > farthest * half_width or abs(q) > farthest * half_height:
                    continue
                u, v = p / z, q / z
                off = max(abs(u) / half_width, abs(v) / half_height)
                is_sure = max(abs(u), abs(v)) < sure[k]
                if off < best and (is_sure or n >= 0):  # of two views alike, the first serves
                    best, which, best_u, best_v = off, k, u, v
                if is_sure:
                    break
            view[i], x[i], y[i] = which, best_u + half_width, best_v + half_height
            if which >= 0:
                used[which] = True
                last, most_u, most_v = which, max(most_u, abs(best_u)), max(most_v, abs(best_v))
    return float(min(half_width - most_u, half_height - most_v))


@njit(nogil=True, error_model="numpy")
def _in_view(
    rays: Array, R: Array, scale: tuple[float, float, float], sure: float, x: Floats, y: Floats
) -> tuple[int, float, float]:
    """Write the pixels of (3, N) rays in one view; return how many are sure, and how far off its centre."""
    focal, half_width, half_height = scale
    r00, r01, r02, r10, r11, r12 = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    r20, r21, r22 = R[2, 0], R[2, 1], R[2, 2]
    seen, most_u, most_v = 0, np.int64(0), np.int64(0)  # bits of floats >= 0, in their order: no branch
    for i in range(x.shape[0]):
        a, b, c = rays[0, i], rays[1, i], rays[2, i]
        z = r20 * a + r21 * b + r22 * c
        u, v = focal * (r00 * a + r01 * b + r02 * c) / z, focal * (r10 * a + r11 * b + r12 * c) / z
        seen += (z > 0.0) & (abs(u) < sure) & (abs(v) < sure)
        x[i], y[i] = u + half_width, v + half_height
        most_u = max(most_u, np.float64(abs(u)).view(np.int64))
        most_v = max(most_v, np.float64(abs(v)).view(np.int64))
    end_u, end_v = np.int64(most_u), np.int64(most_v)
    return seen, end_u.view(np.float64), end_v.view(np.float64)
