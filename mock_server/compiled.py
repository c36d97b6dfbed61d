"""numba's decorator, for kernels whose compiled code is kept for later processes.

numba writes the index of a kernel's files first, and without a lock. So code of another type may come under
a kernel's name, from two processes that compile at once, or older code from a disk that was full. Both would
run in silence: :class:`_Files` compiles anew instead.
"""

import logging
import warnings
from collections.abc import Callable
from functools import cache as cached
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache

LOGGER = logging.getLogger("omniscv.compiled")

if numba.config.DISABLE_JIT:
    # Interpreted, kernels take hundreds of times as long, and divide by zero where compiled ones get inf.
    numba.config.DISABLE_JIT = 0
    warnings.warn("NUMBA_DISABLE_JIT is ignored: kernels of omniscv have to be compiled", stacklevel=1)


class _Files(FunctionCache):  # type: ignore[misc]
    """The files of a kernel."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a kernel's types, or None; the files are forgotten if it is another's."""
        code = super().load_overload(sig, target_context)
        if code is None or code.signature.args == sig:
            return code
        self._forget()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a kernel's types; not where the disk is full."""
        try:
            super().save_overload(sig, data)
        except OSError:
            self._forget()

    def _forget(self) -> None:
        for index in Path(self.cache_path).glob("*.nbi"):
            index.unlink(missing_ok=True)


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
            kernel._cache = _Files(function)
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
