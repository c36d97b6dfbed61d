"""Compiled kernels on rows of arrays, on all cores; short names for the arrays' types."""

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
"""Pictures of one size, as they came or as one array."""


def stacked(faces: Faces) -> Pixels:
    """Return pictures as one array, (V, h, w, ...)."""
    return faces if isinstance(faces, np.ndarray) else np.stack(faces)


def run(kernel: Callable[..., Any], rows: Sequence[NDArray[Any]], *others: Any) -> list[Any]:
    """Call a kernel with slices of arrays of N rows, and with other arguments whole; return its results."""
    return blocks(lambda part: kernel(*(array[part] for array in rows), *others), len(rows[0]))
