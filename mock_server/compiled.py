"""numba's decorator, for kernels that are loaded quickly.

numba prepares itself to compile before it looks into its cache: 0.5 s of processor time in each process,
for SciPy's linear algebra among others. A kernel that is cached needs none of that.
"""

import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys


class _Cache(FunctionCache):  # type: ignore[misc]
    """A cache of kernels that prepares what runs them; what compiles them prepares the rest."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel of a signature from its file, or None."""
        rtsys.initialize(target_context)  # what allocates arrays
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel for later processes; where the disk is full, it serves this one alone."""
        try:
            super().save_overload(sig, data)
        except OSError:  # the index, written first, would name a file that is not there, or an older one
            with suppress(OSError):
                os.unlink(self._cache_file._index_path)


def njit(*, cache: bool, **options: Any) -> Callable[[Any], Any]:
    """Return a decorator that compiles as :func:`numba.njit` does, and caches with ``cache``."""

    def compiled(function: Any) -> Any:
        kernel = numba.njit(**options)(function)
        if cache and not numba.config.DISABLE_JIT:
            kernel._cache = _Cache(function)
        return kernel

    return compiled
