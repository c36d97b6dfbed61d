"""numba's decorator, for kernels whose compiled code is kept for later processes.

Two processes that compile one kernel for different types in the same millisecond may give both files one
name. Later processes then raise TypeError at the call, until the files are removed (docs/performance.md).
"""

import logging
import warnings
from collections.abc import Callable
from functools import cache as cached
from pathlib import Path
from typing import Any

import numba

LOGGER = logging.getLogger("omniscv.compiled")

if numba.config.DISABLE_JIT:
    # Interpreted, kernels take hundreds of times as long, and divide by zero where compiled ones get inf.
    numba.config.DISABLE_JIT = 0
    warnings.warn("NUMBA_DISABLE_JIT is ignored: kernels of omniscv have to be compiled", stacklevel=1)


def njit(**options: Any) -> Callable[[Any], Any]:
    """Return a decorator as :func:`numba.njit`; with ``cache``, a warning in place of an error if no folder
    can be written to.
    """

    def compiled(function: Any) -> Any:
        try:
            kernel = numba.njit(**options)(function)
        except RuntimeError:  # no folder is writable
            _warn()
            return numba.njit(**{**options, "cache": False})(function)
        if folder := kernel.stats.cache_path:
            _announce(folder)
        return kernel

    return compiled


@cached
def _announce(folder: str) -> None:
    """Log why the process will be silent for a while, if a folder holds no compiled code yet."""
    if not any(Path(folder).glob("*.nbi")):
        _say()


@cached
def _say() -> None:
    LOGGER.info("compiling kernels (once, about 15 s for a first image)")


@cached
def _warn() -> None:
    advice = "set NUMBA_CACHE_DIR to a folder that can be written to"
    warnings.warn(f"compiled code cannot be kept, so each process compiles anew: {advice}", stacklevel=2)
