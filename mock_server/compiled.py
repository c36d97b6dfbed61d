"""numba's decorator, for kernels that are loaded quickly.

numba prepares itself to compile before it looks into its cache: 0.5 s of processor time in each process,
for SciPy's linear algebra among others. A kernel that is cached needs none of that.
"""

import os
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property
from typing import Any

import numba
from llvmlite import binding  # type: ignore[import-untyped]
from numba.core.caching import FunctionCache, NullCache
from numba.core.runtime import _nrt_python


class _Files(FunctionCache):  # type: ignore[misc]
    """The files of a kernel, read without what compiles."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel of a signature from its file, or None."""
        _name_allocators()
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel for later processes; where the disk is full, it serves this one alone."""
        try:
            super().save_overload(sig, data)
        except OSError:  # the index, written first, would name a file that is not there, or an older one
            with suppress(OSError):
                os.unlink(self._cache_file._index_path)


class _Cache(NullCache):  # type: ignore[misc]
    """A cache that looks for its folder when its kernel is called: most are called by other kernels only."""

    def __init__(self, function: Any) -> None:
        self._function = function

    @cached_property
    def _files(self) -> Any:
        try:
            return _Files(self._function)
        except RuntimeError:  # no folder can be written to
            _warn()
            return NullCache()

    @property
    def cache_path(self) -> Any:
        """The folder; None where there is none."""
        return self._files.cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel of a signature from its file, or None."""
        return self._files.load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the kernel of a signature to its file."""
        self._files.save_overload(sig, data)

    def flush(self) -> None:
        """Forget the kernels of all signatures."""
        self._files.flush()


def njit(*, cache: bool, **options: Any) -> Callable[[Any], Any]:
    """Return a decorator that compiles as :func:`numba.njit` does, and caches with ``cache``."""

    def compiled(function: Any) -> Any:
        kernel = numba.njit(**options)(function)
        if cache and not numba.config.DISABLE_JIT:
            kernel._cache = _Cache(function)
        return kernel

    return compiled


@cache
def _name_allocators() -> None:
    """Tell LLVM the addresses of what allocates arrays, which the files of kernels refer to by name."""
    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@cache
def _warn() -> None:
    advice = "set NUMBA_CACHE_DIR to a folder that can be written to"
    warnings.warn(f"compiled code cannot be kept, so each process compiles anew: {advice}", stacklevel=2)
