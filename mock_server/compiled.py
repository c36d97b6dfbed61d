"""numba's decorator, for kernels that are loaded quickly.

numba prepares to compile before it looks into its cache, which takes 0.5 s of processor time in each process.
The cache below reads a kernel's file without that. It overrides private parts of numba; where one of them is
missing, kernels use numba's own cache: slower to load, the same results.
"""

import logging
import os
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache as cached
from functools import cached_property
from threading import Timer
from typing import Any

import numba

SILENT_S = 1.0
"""Seconds of compiling, of a process, before it says so."""

LOGGER = logging.getLogger("omniscv.compiled")

try:
    from llvmlite import binding  # type: ignore[import-untyped]
    from numba.core.caching import FunctionCache, NullCache
    from numba.core.runtime import _nrt_python

    _ALLOCATORS = dict(_nrt_python.c_helpers)
    _ = FunctionCache._load_overload, FunctionCache._guard_against_spurious_io_errors, binding.add_symbol
    FAST = True
except (ImportError, AttributeError):
    FunctionCache = NullCache = object
    FAST = False

if numba.config.DISABLE_JIT:
    # Interpreted, kernels take hundreds of times as long, and divide by zero where compiled ones get inf.
    numba.config.DISABLE_JIT = 0
    warnings.warn("NUMBA_DISABLE_JIT is ignored: kernels of omniscv have to be compiled", stacklevel=1)


class _Files(FunctionCache):  # type: ignore[misc]
    """The files of a kernel, read without preparing to compile."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel of a signature from its file, or None.

        Processes that compile at the same time may write kernels of two signatures under one name.
        """
        _name_allocators()
        with self._guard_against_spurious_io_errors():
            kernel = self._load_overload(sig, target_context)
            return kernel if kernel is None or kernel.signature.args == sig else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel for later processes; where the disk is full, it is not kept."""
        try:
            super().save_overload(sig, data)
        except OSError:  # the index, written first, names a file that is missing or older
            with suppress(OSError, AttributeError):
                os.unlink(self._cache_file._index_path)


class _Cache(NullCache):  # type: ignore[misc]
    """A cache that looks for its folder when its kernel is first called: most are called by kernels only."""

    spent_s = 0.0  # compiling, in this process

    def __init__(self, function: Any) -> None:
        self._function, self._timer, self._started = function, Timer(0, _say), 0.0

    @cached_property
    def _files(self) -> Any:
        try:
            return _Files(self._function)
        except RuntimeError:  # no folder is writable
            _warn()
            return NullCache()

    @property
    def cache_path(self) -> Any:
        """The folder; None where there is none."""
        return self._files.cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel of a signature from its file, or None."""
        kernel = self._files.load_overload(sig, target_context)
        if kernel is None:
            self._started = time.monotonic()
            self._timer = Timer(max(0.0, SILENT_S - _Cache.spent_s), _say)
            self._timer.daemon = True
            self._timer.start()
        return kernel

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the kernel of a signature to its file."""
        self._timer.cancel()
        _Cache.spent_s += time.monotonic() - self._started
        self._files.save_overload(sig, data)

    def flush(self) -> None:
        """Forget the kernels of all signatures."""
        self._files.flush()


def njit(*, cache: bool, **options: Any) -> Callable[[Any], Any]:
    """Return a decorator that compiles as :func:`numba.njit` does, and caches with ``cache``."""

    def compiled(function: Any) -> Any:
        kernel = numba.njit(**options)(function)
        if not cache:
            return kernel
        if FAST and hasattr(kernel, "_cache"):
            kernel._cache = _Cache(function)
            return kernel
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder is writable
            _warn()
            return kernel

    return compiled


def inner(**options: Any) -> Callable[[Any], Any]:
    """Return the decorator of functions that only kernels call, with the options of :func:`njit`.

    Without wrappers for Python, compiling takes a sixth less time; called from Python, one crashes.
    """
    return njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)


@cached
def _name_allocators() -> None:
    """Tell LLVM the addresses of the functions that allocate arrays: kernels' files refer to them by name."""
    for name, address in _ALLOCATORS.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@cached
def _say() -> None:
    """Tell, once, why the process is silent for a while."""
    LOGGER.info("compiling kernels (once, about 15 s for a first image)")


@cached
def _warn() -> None:
    advice = "set NUMBA_CACHE_DIR to a folder that can be written to"
    warnings.warn(f"compiled code cannot be kept, so each process compiles anew: {advice}", stacklevel=2)
