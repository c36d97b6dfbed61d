"""Arrays as files of Blosc2 (``.b2nd``), which take half of the bytes of EXR and PNG.

A file holds one array as one chunk: the first bytes of all numbers, then the second ones, and so on, as
differences of neighbours; of half floats the first bits, and so on; by Zstd at level 1. Any reader of Blosc2
opens it. The package is an extra, ``omniscv[fast]``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, OmniscvError


class Stored(NamedTuple):
    """An array that is not decompressed yet.

    ``pixels()`` takes memory for its shape, and raises ArgumentError where its bytes are damaged.
    """

    shape: tuple[int, ...]
    dtype: str
    pixels: Callable[[], NDArray[Any]]


def encode(pixels: NDArray[Any]) -> bytes:
    """Return an array as the bytes of a file.

    Raises:
        OmniscvError: the package is missing.
    """
    blosc2 = package()
    whole = np.ascontiguousarray(pixels)
    halves = whole.dtype == np.float16  # bits of bounds: the same size in 0.4 of the time
    settings = blosc2.CParams(
        codec=blosc2.Codec.ZSTD,
        clevel=1,
        filters=[blosc2.Filter.BITSHUFFLE] if halves else [blosc2.Filter.SHUFFLE, blosc2.Filter.BYTEDELTA],
        filters_meta=[0] if halves else [0, whole.itemsize],
        nthreads=1,  # layers are written side by side
    )
    encoded: bytes = blosc2.asarray(whole, chunks=whole.shape, cparams=settings).to_cframe()
    return encoded


def opened(data: bytes) -> Stored:
    """Return the array that a file holds; only its header is read.

    Raises:
        ArgumentError: no such file, or an array in several chunks.
        OmniscvError: the package is missing.
    """
    blosc2 = package()
    try:
        # Not blosc2.open, which makes other objects of files that ask for it.
        reader = blosc2.ndarray_from_cframe(data)
        shape, dtype = tuple(reader.shape), np.dtype(reader.dtype)
    except (RuntimeError, ValueError, TypeError, SyntaxError, MemoryError) as cause:
        raise ArgumentError(f"expected an array of Blosc2, got: {shown(str(cause))}") from cause
    # Decompressing takes memory for whole blocks of a chunk: less than twice the array on each side.
    if tuple(reader.chunks) != shape or any(b > s for b, s in zip(reader.blocks, shape, strict=True)):
        got = f"{reader.chunks} in blocks of {reader.blocks}"
        raise ArgumentError(f"expected an array of {shape} in one chunk, got chunks of {got}")

    def pixels() -> NDArray[Any]:
        try:
            return np.asarray(reader[:])
        except (RuntimeError, ValueError, MemoryError) as cause:
            raise ArgumentError(f"expected an array of Blosc2, got: {shown(str(cause))}") from cause

    return Stored(shape, dtype.name, pixels)


def package() -> Any:
    """Return the module of Blosc2; OmniscvError if it is not installed."""
    try:
        import blosc2
    except ImportError as cause:
        raise OmniscvError("store: expected the package blosc2; pip install 'omniscv[fast]'") from cause
    return blosc2
