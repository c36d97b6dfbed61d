"""Values of the pixels that rays lie in: what is never blended, and whether a neighbour has another one."""

import numpy as np

from omniscv.compiled import njit
from omniscv.compose import kernels
from omniscv.compose.kernels import Faces, Floats, Ints, Mask, Pixels
from omniscv.compose.ray_lookup import RayLookup


def sample_nearest(faces: Faces, lookup: RayLookup) -> Pixels:
    """Return (N, ...) the values of (h, w, ...) faces along N rays; 0 where no view sees the ray."""
    stack = _bytes(faces)
    out = np.empty((len(lookup.view), stack.shape[3]), np.uint8)
    kernels.run(_sample, (lookup.view, lookup.x, lookup.y, out), stack)
    return out.view(faces[0].dtype).reshape(-1, *faces[0].shape[2:])


def beside_another(faces: Faces, lookup: RayLookup) -> Mask:
    """Return (N,) whether a neighbour of the pixel that a ray lies in has another value."""
    out = np.empty(len(lookup.view), np.bool_)
    kernels.run(_beside, (lookup.view, lookup.x, lookup.y, out), _bytes(faces))
    return out


def _bytes(faces: Faces) -> Pixels:
    """(V, h, w, B) the bytes of the pixels, so that one compiled kernel serves every type."""
    stack = kernels.stacked(faces)
    return stack.reshape(*stack.shape[:3], -1).view(np.uint8)


@njit(cache=True, nogil=True)
def _sample(view: Ints, x: Floats, y: Floats, out: Pixels, stack: Pixels) -> None:
    (height, width, count), flat = stack.shape[1:], stack.reshape(-1)
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            out[i] = 0
            continue
        c, r = min(max(int(x[i]), 0), width - 1), min(max(int(y[i]), 0), height - 1)
        first = np.uint64(((k * height + r) * width + c) * count)  # unsigned: negative ones cost a test each
        for j in range(count):
            out[i, j] = flat[first + np.uint64(j)]


@njit(cache=True, nogil=True)
def _beside(view: Ints, x: Floats, y: Floats, out: Mask, stack: Pixels) -> None:
    (height, width, count), flat = stack.shape[1:], stack.reshape(-1)
    row = width * count
    for i in range(view.shape[0]):
        k, out[i] = view[i], False
        if k < 0:
            continue
        c, r = min(max(int(x[i]), 0), width - 1), min(max(int(y[i]), 0), height - 1)
        own = np.uint64(((k * height + r) * width + c) * count)
        left, right = own - np.uint64(count * (c > 0)), own + np.uint64(count * (c < width - 1))
        above, below = own - np.uint64(row * (r > 0)), own + np.uint64(row * (r < height - 1))
        differs = False
        for j in range(np.uint64(count)):
            value = flat[own + j]
            differs |= (flat[left + j] != value) | (flat[right + j] != value)
            differs |= (flat[above + j] != value) | (flat[below + j] != value)
        out[i] = differs
