"""Depth along rays from captures of planar depth, and how far it may be off.

The bound is the rounding of stored depth, how far a surface may bend between pixels
(:mod:`omniscv.depth.surfaces`), and what captures say that it is off; where relief may be more, that. Rays
from elsewhere than the shared centre meet a plane elsewhere, and near an object's edge another surface: the
plane's slope, and the depths within the parallax, add to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import fields, njit
from omniscv.depth.hits import DOUBTFUL, KnownDepth
from omniscv.depth.ray_lookup import RayLookup
from omniscv.depth.surfaces import (
    Shape,
    discontinuities,
    interpolated,
    nearest_pixel,
    plane_of,
    surface_point,
    turns,
)
from omniscv.geometry import Array
from omniscv.geometry.arrays import Faces, Floats, Ints, Mask, Rows, run, stacked
from omniscv.geometry.precision import LEAST_M, Precision, inverse_depth32, rounding, stored_length
from omniscv.parallel import side_by_side
from omniscv.sources.base import View

_AHEAD_PX = 1.5  # parallax is measured from the nearest pixel, an edge lies within one of that which shows it
_SLOPE_ERRORS = 2.0  # the slope between two pixels is off by both their errors
_CURVED = 1.1  # a surface that bends away from its plane shifts by more
_MARGIN = 1.3  # a neighbouring surface goes on between the pixels that show it
_BLOCK = 256  # rays whose depths are gathered at a time; their buffers fit into the fastest cache
_FEW = 24  # pixels of all pictures for each ray, beyond which finding their bends takes longer than it saves
_BENT = np.uint32(0x7F807F80)  # twice the upper half of +inf


@fields(
    "float32[::1], (int64, int64), float64[:, ::1], Precision, float32[::1], float32[::1], bool[::1], "
    "uint32[::1]"
)
class DepthPictures(NamedTuple):
    """Pictures of planar depth.

    Attributes:
        depth: (V h w,) float32 metres, picture by picture, row by row.
        shape: h and w.
        projections: (V, 4) fx, fy, cx, cy, px.
        precision: of the depth.
        off: (V h w,) float32 metres that it may be off beside that; or empty.
        relief: (V h w,) float32 metres that depth along the ray may be off by relief; or empty.
        rough: (V,) bool, pictures that have relief; or empty.
        bends: (V h w,) uint32, how much 1/z bends between a pixel, its neighbours to the right and below, and
            the one between these: across, and down, 1/m, rounded up to the upper half of a float32 each.
            :data:`_BENT` where that does not say how far depth may be off. Empty if rays read few pixels.
    """

    depth: Floats
    shape: Shape
    projections: Array
    precision: Precision
    off: Floats
    relief: Floats
    rough: Mask
    bends: Ints

    @classmethod
    def of(
        cls,
        faces: Faces,
        views: Sequence[View],
        precision: Precision,
        rays: int,
        off: Sequence[Floats] = (),
        relief: Sequence[Floats] | Floats = (),
    ) -> DepthPictures:
        """Return pictures of depth.

        Args:
            faces: (V, h, w) float32 planar metres.
            views: one per face.
            precision: of the depth.
            rays: how many rays read them: bends are not found for few.
            off: (h, w) metres that each may be off beside its precision; or empty.
            relief: (h, w) metres that depth along the ray may be off by relief, of each; or empty.
        """
        stack = stacked(faces)
        projections = np.array([view.projection for view in views])
        reads_many = rays * _FEW >= stack.size
        return cls(
            depth=stack.reshape(-1),
            shape=stack.shape[1:],
            projections=projections,
            precision=precision,
            off=_flat(off),
            relief=_flat(relief),
            rough=np.array([face.any() for face in relief], np.bool_),
            bends=_bends(stack if reads_many else stack[:0], projections[:, 0], precision),
        )

    @property
    def faces(self) -> Floats:
        """(V, h, w) float32 metres."""
        return self.depth.reshape(-1, *self.shape)

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        return self.depth.nbytes + self.off.nbytes + self.relief.nbytes + self.bends.nbytes


def _flat(faces: Sequence[Floats] | Floats) -> Floats:
    """Return the pixels of all faces, one after the other; empty without faces."""
    if not len(faces):
        return np.empty(0, np.float32)
    return np.concatenate([face.reshape(-1) for face in faces])


def _bends(stack: Floats, focal_px: Array, precision: Precision) -> Ints:
    """Return the bends of faces (V, h, w), flat, as :class:`DepthPictures` has them; read-only."""
    bends = np.full(stack.shape, _BENT, np.uint32)

    def find(k: int) -> None:
        _find_bends(stack[k], bends[k], float(focal_px[k]), precision)

    side_by_side(find, list(range(len(stack))))
    flat = bends.reshape(-1)
    flat.flags.writeable = False
    return flat


def sample_depth(
    pictures: DepthPictures,
    lookup: RayLookup,
    views: Sequence[View],
    nearest: bool,
    offsets_w: Array | None = None,
) -> KnownDepth:
    """Return depth along N rays.

    Args:
        pictures: of each view.
        lookup: of N rays.
        views: those of the pictures.
        nearest: take the nearest pixel's depth everywhere.
        offsets_w: (N, 3) from the views' centre to the rays' own origins, metres; None: they are the same.
    """
    distance = np.empty_like(lookup.x)
    error = np.empty_like(lookup.x)
    faces = pictures.faces
    central = offsets_w is None or not len(offsets_w)
    relief = np.zeros(len(lookup.x), np.bool_)
    rays: list[NDArray[Any]] = [lookup.view, lookup.x, lookup.y, distance, error]
    at = lookup.nearest(faces.shape) if pictures.relief.size else np.empty(0, np.int32)
    run(_sample, [*rays, relief, at], pictures, nearest, central, as_one=True)
    known = KnownDepth(distance, error, relief=relief)
    if offsets_w is None or central:
        return known
    parallax = np.empty_like(lookup.x)
    least = max(float(faces.min()), LEAST_M)
    farthest_m = np.linalg.norm(offsets_w, axis=-1).max()
    reach_px = int(np.ceil(farthest_m * pictures.projections[:, :2].max() / least * _MARGIN)) + 2
    around = [_surroundings(face, reach_px) for face in faces]
    R_c_w = np.array([view.pose.R_w_c.T for view in views])
    surroundings = tuple(map(np.stack, zip(*around, strict=True)))
    run(_displace, [*rays, parallax, offsets_w], pictures, surroundings, R_c_w, as_one=True)
    return known._replace(direction_error=parallax)


def _surroundings(face: Floats, reach_px: int) -> tuple[Floats, Floats, Floats]:
    """Return what surrounds each pixel of a face: px to the next edge of a surface, and the least and the
    greatest depth within reach."""
    size = 2 * min(reach_px, max(face.shape)) + 1
    window = np.ones((1, size), np.uint8)
    least = face
    most = face
    for kernel in (window, window.T):
        least = cv2.erode(least, kernel)
        most = cv2.dilate(most, kernel)
    edges = discontinuities(face)
    far = np.full(face.shape, np.inf, np.float32)
    return (far if edges.all() else cv2.distanceTransform(edges, cv2.DIST_C, 3)), least, most


@njit("float32[:, ::1], out uint32[:, ::1], float64, Precision", nogil=True, error_model="numpy")
def _find_bends(depth: Floats, bends: Ints, focal: float, precision: Precision) -> None:
    """Write the bends of one picture, as :class:`DepthPictures` has them; those at its border stay."""
    height, width = depth.shape
    inverses, noises = np.zeros((4, width), np.float32), np.zeros((4, width), np.float32)
    for r in range(height):
        inverse, noise = inverses[r % 4], noises[r % 4]
        for c in range(width):
            inverse[c] = inverse_depth32(depth[r, c])
            length = stored_length(r, c, (height, width), focal, precision)
            noise[c] = rounding(np.float64(depth[r, c]), length, precision)
        for c in range(width):
            noise[c] = (noise[c] + noise[c]) * inverse[c] * inverse[c]
        if r < 3:
            continue
        zn, z0, z1, zs = depth[r - 3], depth[r - 2], depth[r - 1], depth[r]
        n, i, j, s = inverses[(r - 3) % 4], inverses[(r - 2) % 4], inverses[(r - 1) % 4], inverse
        noise0, noise1, out = noises[(r - 2) % 4], noises[(r - 1) % 4], bends[r - 2]
        for c in range(1, width - 2):
            most = max(max(noise0[c], noise0[c + 1]), max(noise1[c], noise1[c + 1]))
            line, of_line = (z0[c - 1], z0[c], z0[c + 1], z0[c + 2]), (i[c - 1], i[c], i[c + 1], i[c + 2])
            upper = turns(line, of_line, most)[0]
            line, of_line = (z1[c - 1], z1[c], z1[c + 1], z1[c + 2]), (j[c - 1], j[c], j[c + 1], j[c + 2])
            across = max(upper, turns(line, of_line, most)[0])
            left = turns((zn[c], z0[c], z1[c], zs[c]), (n[c], i[c], j[c], s[c]), most)[0]
            line, of_line = (
                (zn[c + 1], z0[c + 1], z1[c + 1], zs[c + 1]),
                (n[c + 1], i[c + 1], j[c + 1], s[c + 1]),
            )
            down = max(left, turns(line, of_line, most)[0])
            bent = _upper_half(across) | _upper_half(down) >> np.uint32(16)
            out[c] = bent if max(across, down) < np.inf else _BENT


@njit(nogil=True, forceinline=True)
def _upper_half(value: np.float32) -> np.uint32:
    """Return the bits of a float32 >= 0, rounded up to the upper 16 of them."""
    return np.uint32((np.float32(value).view(np.uint32) + np.uint32(0xFFFF)) & np.uint32(0xFFFF0000))


@njit(
    "(int16[::1], float32[::1], float32[::1], out float32[::1], out float32[::1], out bool[::1], "
    "int32[::1]), DepthPictures, bool, bool",
    "(int16[::1], float32[::1], float32[::1], out float32[::1], out float32[::1], out bool[::1], "
    "int64[::1]), DepthPictures, bool, bool",
    nogil=True,
    error_model="numpy",
)
def _sample(rays: Rows, pictures: DepthPictures, nearest: bool, central: bool) -> None:
    """Sample rays that follow each other in one view together, in vector instructions."""
    view, x, y, distance, error, relief, pixels = rays
    block = (
        np.empty((4, _BLOCK), np.float32),
        np.empty((3, _BLOCK)),
        np.empty(_BLOCK, np.int32),
        np.empty(_BLOCK, np.uint32),
    )
    first = 0
    while first < view.shape[0]:
        k, last, most = view[first], first + 1, min(first + _BLOCK, view.shape[0])
        while last < most and view[last] == k:
            last += 1
        of = slice(first, last)
        if k >= 0 and pictures.bends.size:
            _gather(k, x[of], y[of], pictures, block)
            _interpolate(k, x[of], y[of], pictures, block, distance[of], error[of])
        for i in range(first, last):
            if k < 0:
                distance[i] = error[i] = 0.0
                continue
            # As float64: functions that others call with float64 are compiled once.
            px, py = np.float64(x[i]), np.float64(y[i])
            if not pictures.bends.size or not distance[i] > 0.0:
                distance[i], error[i] = _one_ray(pictures, k, px, py)
            if nearest:
                stored = _nearest(pictures.depth, pictures, k, px, py) * _ray_length(pictures, k, px, py)
                error[i] += abs(stored - distance[i]) if distance[i] < np.inf else 0.0
                distance[i] = stored
            if pictures.off.size:
                error[i] += _nearest(pictures.off, pictures, k, px, py) * _ray_length(pictures, k, px, py)
        for i in range(first, last if k >= 0 and pictures.rough.size and pictures.rough[k] else first):
            off = pictures.relief[pixels[i]]
            relief[i] = not off <= np.float32(DOUBTFUL) * distance[i] or off == np.inf
            # A ray from elsewhere meets another part of the relief.
            error[i] = max(error[i], off) if central else error[i] + off
        first = last


@njit(nogil=True, error_model="numpy")
def _gather(k: int, x: Floats, y: Floats, pictures: DepthPictures, block: Rows) -> None:
    """Write what a view shows around points: depths of 2 x 2 pixels; px from the first of them, across and
    down, and the length of its stored ray; its index in the picture, and the bends there."""
    around, at, start, bends = block
    depth, (height, width), focal = pictures.depth, pictures.shape, pictures.projections[k, 0]
    for j in range(x.shape[0]):
        px, py = np.float64(x[j]), np.float64(y[j])
        c, r = min(max(np.floor(px - 0.5), 0.0), width - 2.0), min(max(np.floor(py - 0.5), 0.0), height - 2.0)
        at[0, j], at[1, j], at[2, j] = px - 0.5 - c, py - 0.5 - r, 1.0
        start[j] = np.int32(r) * np.int32(width) + np.int32(c)
    if pictures.precision.along_ray:
        for j in range(x.shape[0]):
            at[2, j] = stored_length(
                start[j] // width, start[j] % width, pictures.shape, focal, pictures.precision
            )
    # Indices without a sign are not checked for one.
    picture, one, row = np.uint64(k * height * width), np.uint64(1), np.uint64(width)
    for j in range(x.shape[0]):
        o = picture + np.uint64(start[j])
        around[0, j], around[1, j], bends[j] = depth[o], depth[o + one], pictures.bends[o]
        around[2, j], around[3, j] = depth[o + row], depth[o + row + one]


@njit(nogil=True, error_model="numpy")
def _interpolate(
    k: int, x: Floats, y: Floats, pictures: DepthPictures, block: Rows, distance: Floats, error: Floats
) -> None:
    """Write depth along rays in a view; 0 where bends do not say how far it is off."""
    fx, fy = pictures.projections[k, 0], pictures.projections[k, 1]
    cx, cy = pictures.projections[k, 2], pictures.projections[k, 3]
    lens = (fx, fy, cx, cy)
    size = max(pictures.shape[0], pictures.shape[1])
    precision = pictures.precision
    if precision.unit_m == 1.0 and not precision.along_ray:
        # Planar metres, as most captures are: divisions by 1.0 are left out, and the loop takes a tenth less.
        metres = Precision(
            1.0,
            precision.digits,
            False,
            precision.largest_m,
            precision.middle_px,
            precision.off_m,
            precision.share,
        )
        for j in range(x.shape[0]):
            distance[j], error[j] = _between_pixels(j, x[j], y[j], lens, 1.0, size, block, metres)
    else:
        for j in range(x.shape[0]):
            distance[j], error[j] = _between_pixels(
                j, x[j], y[j], lens, block[1][2, j], size, block, precision
            )


@njit(nogil=True, error_model="numpy", forceinline=True)
def _between_pixels(
    j: int,
    x: float,
    y: float,
    lens: tuple[float, float, float, float],
    stored_m: float,
    size: int,
    block: Rows,
    precision: Precision,
) -> tuple[float, float]:
    """Return depth along the ray j of a block, and the bound on its error; ``stored_m`` of 1 m is stored."""
    around, at, _, bends = block
    fx, fy, cx, cy = lens
    corners = (around[0, j], around[1, j], around[2, j], around[3, j])
    a = at[0, j]
    b = at[1, j]
    inverse, _, _, off, _ = interpolated(corners, a, b, stored_m, size, precision)
    across = np.float64(np.uint32(bends[j] & np.uint32(0xFFFF0000)).view(np.float32))
    down = np.float64(np.uint32(bends[j] << np.uint32(16)).view(np.float32))
    off += a * (1.0 - a) * across + b * (1.0 - b) * down
    z = 1.0 / inverse
    u = (x - cx) / fx
    v = (y - cy) / fy
    length = np.sqrt(1.0 + u * u + v * v)
    return z * length if across < np.inf else 0.0, z * z * off * length


@njit(nogil=True)
def _one_ray(pictures: DepthPictures, k: int, x: float, y: float) -> tuple[float, float]:
    """Return depth along a ray, and the bound on its error."""
    precision, shape, focal = pictures.precision, pictures.shape, pictures.projections[k, 0]
    point = surface_point(pictures.depth, k * shape[0] * shape[1], shape, x, y, focal, precision)
    if point.inverse == 0.0:
        return np.inf, np.inf if point.jump > 0.0 or precision.largest_m < np.inf else 0.0
    z, length = 1.0 / point.inverse, _ray_length(pictures, k, x, y)
    return z * length, (z * z * point.error + _MARGIN * point.jump) * length


@njit(nogil=True)
def _nearest(values: Floats, pictures: DepthPictures, k: int, x: float, y: float) -> float:
    """Return the value of the nearest pixel of a picture."""
    height, width = pictures.shape
    r, c = nearest_pixel(pictures.shape, x, y)
    return float(values[(k * height + r) * width + c])


@njit(nogil=True)
def _ray_length(pictures: DepthPictures, k: int, x: float, y: float) -> float:
    """Return the length of the ray through a point of a picture to a planar depth of 1 m, metres."""
    of = pictures.projections[k]
    u, v = (x - of[2]) / of[0], (y - of[3]) / of[1]
    return float(np.sqrt(1.0 + u * u + v * v))


@njit(
    "(int16[::1], float32[::1], float32[::1], float32[::1], out float32[::1], out float32[::1], "
    "float64[:, ::1]), DepthPictures, (float32[:, :, ::1], float32[:, :, ::1], float32[:, :, ::1]), "
    "float64[:, :, ::1]",
    nogil=True,
)
def _displace(rays: Rows, pictures: DepthPictures, around: Rows, R_c_w: Array) -> None:  # noqa: PLR0915 - a kernel
    """Add the error of rays that start ``offsets_w`` from the views' centre; write their parallax."""
    (view, x, y, distance, error, parallax, offsets_w), (edge_px, least, most) = rays, around
    shape, depth, offset = pictures.shape, pictures.depth, np.empty(3)
    for i in range(view.shape[0]):
        k, parallax[i] = view[i], 0.0
        if k < 0:
            continue
        fx, fy = pictures.projections[k, 0], pictures.projections[k, 1]
        focal = max(fx, fy)
        for j in range(3):  # by hand: a product of matrices takes a second to compile
            R, at = R_c_w[k, j], offsets_w[i]
            offset[j] = R[0] * at[0] + R[1] * at[1] + R[2] * at[2]
        px, py = np.float64(x[i]), np.float64(y[i])
        dx, dy = px - pictures.projections[k, 2], py - pictures.projections[k, 3]
        u, v = dx / fx, dy / fy
        length = np.sqrt(1.0 + u * u + v * v)
        along = (offset[0] * u + offset[1] * v + offset[2]) / length
        size = np.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
        aside = np.sqrt(max(0.0, size * size - along * along))
        r, c = nearest_pixel(shape, px, py)
        near = max(least[k, r, c], LEAST_M)
        parallax[i] = _MARGIN * aside / (near * length)
        first = k * shape[0] * shape[1]
        point = surface_point(depth, first, shape, px, py, fx, pictures.precision)
        if point.inverse > 0.0:
            a, b, e = plane_of(point.inverse, point.across, point.down, dx, dy, fx, fy)
            shift = abs(a * offset[0] + b * offset[1] + e * offset[2])
            right = fx * (offset[0] - u * offset[2]) * point.inverse  # px to where the pixel's own ray passes
            below = fy * (offset[1] - v * offset[2]) * point.inverse
            there = surface_point(depth, first, shape, px + right, py + below, fx, pictures.precision)
            if there.inverse > 0.0:  # a curved surface has another slope there
                a, b, e = plane_of(there.inverse, there.across, there.down, dx + right, dy + below, fx, fy)
                shift = max(shift, abs(a * offset[0] + b * offset[1] + e * offset[2]))
            off = point.error
            if pictures.off.size:
                off += _nearest(pictures.off, pictures, k, px, py) * point.inverse * point.inverse
            error[i] += distance[i] * (_CURVED * shift + _SLOPE_ERRORS * off * focal * aside)
        if edge_px[k, r, c] <= parallax[i] * focal * length * length + _AHEAD_PX:
            error[i] += _MARGIN * (most[k, r, c] - least[k, r, c]) * length + size
