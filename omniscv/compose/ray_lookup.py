"""The ray lookup: for each ray, the view that sees it and the pixel there."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from omniscv.compiled import njit
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints, run
from omniscv.sources.base import View


@dataclass(frozen=True, eq=False)
class RayLookup:
    """For each ray: the view that sees it most centrally, and the continuous pixel there.

    Attributes:
        view: (N,) int16, -1 where no view sees the ray.
        x, y: (N,) float32 px in that view; pixel centres lie at .5.
        margin: the least distance of a pixel from its view's edges, px; infinite if there are none.
    """

    view: Ints
    x: Floats
    y: Floats
    margin: float

    def by_view(self) -> Iterator[tuple[int, Ints]]:
        """Yield each view that sees rays, and the indices of these."""
        for k in range(int(self.view.max(initial=-1)) + 1):
            if len(rays := np.flatnonzero(self.view == k)):
                yield k, rays

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        return self.view.nbytes + self.x.nbytes + self.y.nbytes


def look_up(directions: Array, views: Sequence[View], R_w_d: Array | None = None) -> RayLookup:
    """Return the view and the pixel that serve each ray from the views' common centre.

    Args:
        directions: (N, 3), any length; NaN rays get view -1.
        views: at least one; they share their centre and size.
        R_w_d: (3, 3) from the frame of the directions to the world; they are world vectors if not given.
    """
    count = len(directions)
    view, x, y = np.empty(count, np.int16), np.empty(count, np.float32), np.empty(count, np.float32)
    R_c_d = np.ascontiguousarray([v.pose.R_w_c.T @ (np.eye(3) if R_w_d is None else R_w_d) for v in views])
    projections = np.array([v.projection for v in views])
    half_width, half_height = views[0].width / 2, views[0].height / 2
    sure = _sure_px(views, R_c_d[:, 2]) ** 2
    margins = run(_look_up, (directions, view, x, y), R_c_d, projections, half_width, half_height, sure)
    return RayLookup(view, x, y, float(min(margins)))


def _sure_px(views: Sequence[View], axes: Array) -> Array:
    """Return (V,) px from a view's centre within which no other view sees a ray more centrally; 0 if unknown.

    A ray at an angle t from the axis of a square view lies between ``tan(t) / sqrt(2)`` and ``tan(t)`` half
    views off its centre. Of views with one field of view it is most central in that one if
    ``tan(t) < tan(phi - t) / sqrt(2)`` for all others, phi away: where ``t <= 0.4 phi``. With it a lookup in
    six faces takes 0.7 of the time.
    """
    first = views[0]
    if first.width != first.height or any(view.lens or view.fov_deg != first.fov_deg for view in views):
        return np.zeros(len(views))
    phi = np.arccos(np.clip(axes @ axes.T, -1, 1))
    np.fill_diagonal(phi, np.pi)
    nearest = np.minimum(0.4 * phi.min(axis=1), 0.99 * np.radians(first.fov_deg) / 2)
    return np.asarray(first.focal_px * np.tan(nearest))


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(
    directions: Array, view: Ints, x: Floats, y: Floats,
    R_c_d: Array, projections: Array, half_width: float, half_height: float, sure: Array,
) -> float:  # fmt: skip
    margin, last = np.inf, 0
    for i in range(directions.shape[0]):
        a, b, c = directions[i, 0], directions[i, 1], directions[i, 2]
        z = R_c_d[last, 2, 0] * a + R_c_d[last, 2, 1] * b + R_c_d[last, 2, 2] * c
        p = projections[last, 0] * (R_c_d[last, 0, 0] * a + R_c_d[last, 0, 1] * b + R_c_d[last, 0, 2] * c)
        q = projections[last, 1] * (R_c_d[last, 1, 0] * a + R_c_d[last, 1, 1] * b + R_c_d[last, 1, 2] * c)
        if z > 0.0 and p * p + q * q < sure[last] * z * z:  # as most rays of a row
            u, v = p / z, q / z
            view[i], x[i], y[i] = last, u + half_width, v + half_height
            margin = min(margin, half_width - abs(u), half_height - abs(v))
            continue
        best, which, best_u, best_v = 1.0 + 1e-9, -1, 0.0, 0.0
        for k in range(R_c_d.shape[0]):
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
            if off < best:
                best, which, best_u, best_v = off, k, u, v
        view[i], x[i], y[i] = which, best_u + half_width, best_v + half_height
        if which >= 0:
            last = which
            margin = min(margin, half_width - abs(best_u), half_height - abs(best_v))
    return margin
