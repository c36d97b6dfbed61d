"""Short names for types of arrays, and kernels on blocks of rows, on all cores."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.parallel import blocks

Floats = NDArray[np.float32]
Ints = NDArray[np.integer[Any]]
Mask = NDArray[np.bool_]
Pixels = NDArray[Any]
Faces = Sequence[Pixels] | Pixels
"""Pictures of one size, as a sequence or as one array (V, h, w, ...)."""
Rows = tuple[Any, ...]
"""What a kernel unpacks: arrays of N rows, and numbers."""

ROUNDING = 1e-12
"""Relative rounding error of a radius, and of a pixel at the border."""
_FEW = 8  # pixels of all pictures for each that is read; by measurement


def reads_few(faces: Faces, rays: int) -> bool:
    """Return whether ``rays`` rays, each a pixel, read so few of ``faces`` that a copy of all takes longer
    than the reading."""
    return bool(rays * _FEW < len(faces) * faces[0].shape[0] * faces[0].shape[1])


def stacked(faces: Faces) -> Pixels:
    """Return pictures as one read-only array (V, h, w, ...); one picture is not copied.

    Pictures that a server sent are read-only: kernels are compiled for these alone, not for both.
    """
    if isinstance(faces, np.ndarray):
        stack = faces.view()
    elif len(faces) == 1:
        stack = faces[0][None]
    else:
        stack = np.empty((len(faces), *faces[0].shape), faces[0].dtype)
        blocks(lambda block: np.stack(faces[block], out=stack[block]), len(faces), stack.size)
    stack.flags.writeable = False
    return stack


def run(
    kernel: Callable[..., Any], rows: Sequence[NDArray[Any]], *others: Any, as_one: bool = False
) -> list[Any]:
    """Call a kernel on blocks of rows, in parallel; return its results.

    Args:
        kernel: releases the GIL.
        rows: arrays of N rows, of which the kernel gets a block.
        others: arguments of each call, after the blocks.
        as_one: whether the kernel takes the blocks as one tuple.
    """

    def call(block: slice) -> Any:
        parts = tuple(array[block] for array in rows)
        return kernel(parts, *others) if as_one else kernel(*parts, *others)

    return blocks(call, len(rows[0]))
