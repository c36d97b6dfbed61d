"""How densely a camera samples the sphere of directions, and how densely views must.

Views sample as densely as the camera does, along the coarser of its axes (by measurement, the finer one adds
no detail in colours). Masks and depth are not blended: a pixel is wrong if an edge runs between its ray and
the nearest ray of the view. The wrong part of an image is the length of the edges per solid angle times the
angle between the view's pixels, whatever the camera's sampling. So small images of much of a room need finer
views.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from omniscv.cameras import Camera, Rays
from omniscv.compiled import njit
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints, Mask, run
from omniscv.parallel import row_blocks
from omniscv.render_options import LARGEST_FACE_PX

SMALLEST = 384
"""px of a 90 degree face. With it, 0.8 % of the labels are wrong at most in rooms, and points lie
within 16 mm of a surface (test_single_view.py); a capture takes about as long as one of a single pixel."""
_QUANTILE = 0.98  # of the pixels, by how finely they sample
_MULTIPLE = 8
_OVERSAMPLING = 1.2
"""By measurement: with less, faces of twice the size gain a tenth and more (test_direction.py)."""
_PARALLEL_M = 2.0
"""Distance at which a step between parallel rays counts as an angle, metres: about as far are surfaces in
rooms."""
_GRID = 17  # rows and columns of the pixels whose distances are measured
_LEAST_TURN = 1e-7  # radians over half a pixel: rays that turn by less are parallel
_SUBRAYS = 8  # rays per axis of a pixel at the rim, to find its part inside the field of view


def steps(directions: Array, origins: Array | None = None) -> Array:
    """Return (H, W) the angle in radians from each pixel's ray to the next one's, along the coarser axis.

    NaN where a pixel has no valid neighbour. Near the poles of a panorama columns crowd, but rows, and so
    detail, do not: hence the coarser. The step between parallel rays is that between their origins, seen
    from 2 m.

    Args:
        directions: (H, W, 3) unit, NaN where not valid.
        origins: (H, W, 3) metres; None: one for all.
    """
    by_axis = []
    for axis in (0, 1):
        lines = np.moveaxis(directions, axis, 0)
        angle = np.full(lines.shape[:-1], np.nan)
        if len(lines) > 1:
            # np.linalg.norm takes eight times as long.
            chords = lines[1:] - lines[:-1]
            x, y, z = np.moveaxis(chords, -1, 0)
            angle[:-1] = 2 * np.arcsin(np.clip(np.sqrt(x * x + y * y + z * z) / 2, 0, 1))
            if origins is not None and (angle == 0).any():
                apart = np.linalg.norm(np.diff(origins, axis=axis), axis=-1) / _PARALLEL_M
                angle[:-1] = np.where(angle[:-1] == 0, np.moveaxis(apart, axis, 0), angle[:-1])
            angle[-1] = angle[-2]
        by_axis.append(np.moveaxis(angle, 0, axis))
    return np.asarray(np.fmax(*by_axis))


def pixels_per_radian(camera: Camera) -> float:
    """Return how many px of an image a radian takes, where half of it has fewer, along the finer axis.

    0 for parallel rays, and where no pixel is valid.
    """
    u = np.linspace(0.5, camera.width - 0.5, _GRID)
    v = np.linspace(0.5, camera.height - 0.5, _GRID)
    middle = np.stack(np.meshgrid(u, v), axis=-1)
    by_axis = []
    for step in ((0.25, 0.0), (0.0, 0.25)):
        before = camera.unproject(middle - np.array(step))
        after = camera.unproject(middle + np.array(step))
        both = before.valid & after.valid
        chords = np.linalg.norm(before.directions - after.directions, axis=-1)
        turn = np.median(chords[both]) if both.any() else 0
        if turn < _LEAST_TURN:
            return 0.0
        by_axis.append(float(0.5 / turn))
    return max(by_axis)


def focal_px(steps: Array) -> float:
    """Return the least focal length, px per radian, of views that lose no detail and few edges.

    A view samples most coarsely at its centre, with its focal length; interpolating between pixels that
    lie just as densely as the image's takes a little more.

    Args:
        steps: of a camera's pixels, or of those that a view shows.
    """
    known = steps[np.isfinite(steps) & (steps > 0)]
    if not known.size:
        return SMALLEST / 2
    dense = 1 / np.quantile(known, 1 - _QUANTILE, overwrite_input=True)  # px per radian where it is fine
    return max(SMALLEST / 2, _OVERSAMPLING * float(dense))


def face_size(steps: Array) -> int:
    """Return the px of the smallest 90 degree face with that focal length, at most ``LARGEST_FACE_PX``."""
    return min(int(_MULTIPLE * np.ceil(2 * focal_px(steps) / _MULTIPLE)), LARGEST_FACE_PX)


@dataclass(frozen=True, eq=False)
class Rim:
    """The pixels that the end of the field of view cuts.

    Attributes:
        pixels: (M,) int64 flat indices, ascending.
        centers: (M, 3) rays through the middle of each pixel's part inside, camera frame.
        turns: (M, 2, 2) float32, from a pixel's edges to those of a box with the second moments of that part.
    """

    pixels: Ints
    centers: Array
    turns: Floats


@dataclass(frozen=True, eq=False)
class Footprints:
    """What N pixels span on the sphere of directions.

    Attributes:
        edges: (N, 2, 3) float32, the change of the unit ray across the pixel, along u and along v.
        rim: (M,) indices of pixels that the end of the field of view cuts; their edges span the part inside.
        centers: (M, 3) rays through the middle of that part.
    """

    edges: Floats
    rim: Ints
    centers: Array


def footprints_of(pixels: Ints, rays: Array, first: int, rim: Rim) -> Footprints:
    """Return what pixels span.

    Args:
        pixels: (N,) flat indices.
        rays: (h, W, 3) of these pixels and of their neighbours, NaN where not valid.
        first: flat index of the first of these rays.
        rim: of the image.
    """
    edges = np.empty((len(pixels), 2, 3), np.float32)
    run(_measure, (pixels - first, edges), rays)
    at = np.searchsorted(rim.pixels, pixels)
    known = rim.pixels[np.minimum(at, len(rim.pixels) - 1)] == pixels if len(rim.pixels) else at < 0
    cut = np.flatnonzero(known)
    edges[cut] = rim.turns[at[cut]] @ edges[cut]
    return Footprints(edges, cut, rim.centers[at[cut]])


def squares(directions: Array, steps: Floats) -> Footprints:
    """Return square footprints around rays: ``directions`` (N, 3), of any length; ``steps`` (N,) are the
    lengths of their edges, radians."""
    least = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    edges = np.empty((len(directions), 2, 3))
    edges[:, 0] = np.cross(directions, least)
    edges[:, 1] = np.cross(directions, edges[:, 0])
    edges *= (steps[:, None] / np.linalg.norm(edges, axis=-1))[..., None]
    return Footprints(edges.astype(np.float32), np.empty(0, np.int64), np.empty((0, 3)))


def rim_of(camera: Camera, valid: Mask) -> Rim:
    """Return the rim of a camera's image, (H, W) ``valid``, from 8 x 8 rays in each pixel beside an invalid
    one."""
    inner = cv2.erode(valid.astype(np.uint8), np.ones((3, 3)), borderValue=1)
    pixels = np.flatnonzero(valid.ravel() & (inner.ravel() == 0))
    at = (np.arange(_SUBRAYS) + 0.5) / _SUBRAYS - 0.5
    offsets = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    middles = np.stack(np.divmod(pixels, valid.shape[1])[::-1], axis=-1) + 0.5
    rays = unproject(camera, middles[:, None] + offsets)
    on_rim = rays.valid.any(axis=1)
    pixels = pixels[on_rim]
    inside = rays.valid[on_rim, :, None]
    share = inside / inside.sum(axis=1, keepdims=True)
    centers = (share * np.where(inside, rays.directions[on_rim], 0)).sum(axis=1)
    apart = offsets - (share * offsets).sum(axis=1, keepdims=True)
    moments = np.einsum("nki,nkj->nij", share * apart, apart) / np.mean(at**2)
    spread, axes = np.linalg.eigh(moments)
    turns = np.sqrt(np.maximum(spread, 0))[:, :, None] * np.swapaxes(axes, 1, 2)
    return Rim(pixels, centers, turns.astype(np.float32))


def unproject(camera: Camera, pixels: Array) -> Rays:
    """Return the rays of (H, W, 2) pixels, computed on all cores in blocks that stay in the cache.

    Arrays are row-major, because rays are looked up by flat indices. A central camera's origins are 0 where
    not valid, too.
    """
    shape = pixels.shape[:-1]
    whole = Rays(np.zeros((*shape, 3)), np.empty((*shape, 3)), np.empty(shape, np.bool_))

    def fill(rows: slice) -> None:
        part = camera.unproject(pixels[rows])
        whole.directions[rows] = part.directions
        whole.valid[rows] = part.valid
        if not camera.central:  # zeros that are never written take no time
            whole.origins[rows] = part.origins

    row_blocks(fill, shape[0], shape[1], pixels=1 << 16)
    return whole


@njit("int64[::1], out float32[:, :, ::1], float64[:, :, ::1]", nogil=True)
def _measure(pixels: Ints, edges: Floats, directions: Array) -> None:
    """Write the edges of pixels: the mean change to both neighbours along an axis; to the nearer one where
    rays jump, at the border to the only one."""
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
