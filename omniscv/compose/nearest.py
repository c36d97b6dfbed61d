"""Values of the pixels that rays lie in: what is never blended, and whether a neighbour has another one."""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from omniscv.compiled import njit
from omniscv.compose import kernels
from omniscv.compose.kernels import Faces, Ints, Mask, Pixels
from omniscv.compose.ray_lookup import RayLookup
from omniscv.parallel import side_by_side


def sample_nearest(faces: Faces, lookup: RayLookup) -> Pixels:
    """Return (N, ...) the values of (h, w, ...) faces along N rays; 0 where no view sees the ray."""
    stack = kernels.stacked(faces)
    height, width = stack.shape[1:3]
    values = stack.reshape(stack.shape[0] * height * width, -1).view(np.uint8)  # one kernel for every type
    out = np.empty((len(lookup.view), values.shape[1]), np.uint8)
    pixel = np.empty(len(lookup.view), np.int64)
    kernels.run(_locate, (lookup.view, lookup.x, lookup.y, pixel), height, width)
    kernels.run(_take, (pixel, out), values)
    return out.view(stack.dtype).reshape(-1, *stack.shape[3:])


def beside_another(faces: Faces, lookup: RayLookup) -> Mask:
    """Return (N,) whether a neighbour of the pixel that a ray lies in has another value."""
    return sample_nearest(boundaries(faces), lookup)


def boundaries(faces: Faces) -> Sequence[Mask]:
    """Return (h, w) of each (h, w, ...) face: whether one of a pixel's four neighbours has another value."""
    return side_by_side(_boundaries, list(faces))


def _boundaries(face: Pixels) -> Mask:
    beside = np.zeros((*face.shape[:2], face[0, 0].size), np.bool_)
    values = face.reshape(beside.shape)
    across, down = values[:, 1:] != values[:, :-1], values[1:] != values[:-1]
    beside[:, 1:] |= across
    beside[:, :-1] |= across
    beside[1:] |= down
    beside[:-1] |= down
    # Channel by channel: any() along an axis so short takes ten times as long.
    return reduce(np.logical_or, (beside[..., channel] for channel in range(beside.shape[2])))


@njit(cache=True, nogil=True)
def _locate(view: Ints, x: Pixels, y: Pixels, pixel: Ints, height: int, width: int) -> None:
    """Write the number of the pixel that each ray lies in, of all views' pixels; -1 where none sees it."""
    for i in range(view.shape[0]):
        c, r = min(max(int(x[i]), 0), width - 1), min(max(int(y[i]), 0), height - 1)
        pixel[i] = (view[i] * height + r) * width + c if view[i] >= 0 else -1


@njit(cache=True, nogil=True)
def _take(pixel: Ints, out: Pixels, values: Pixels) -> None:
    count, flat = np.uint64(values.shape[1]), values.reshape(-1)
    for i in range(pixel.shape[0]):
        if pixel[i] < 0:
            out[i] = 0
            continue
        first = np.uint64(pixel[i]) * count  # unsigned: negative ones cost a test each
        for j in range(count):
            out[i, j] = flat[first + j]
