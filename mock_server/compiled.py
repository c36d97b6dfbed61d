"""Kernels: loops over pixels, written in Python, that run as machine code.

A kernel declares the types of its arguments, as :mod:`mock_server.signatures` describes them::

    @njit("float64[:, ::1], out float32[::1], bool -> int64", nogil=True)
    def count(points, distances, closed): ...

``scripts/kernels`` compiles each signature by numba into a library beside the package, so that neither numba
nor a compiler is needed to run. The library's table has a digest of each kernel's source. A kernel that was
changed since, one of a plugin, and one that is called with types that it does not declare are compiled by
numba when they are called.
"""

import ctypes
import hashlib
import json
import linecache
import logging
import platform
import re
import sys
import warnings
from collections.abc import Callable
from functools import cache, cached_property, partial
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from mock_server.signatures import Signature, fields, fields_of, parse

__all__ = ["Kernel", "Library", "fields", "library_name", "load_library", "njit", "symbol"]

LOGGER = logging.getLogger("omniscv.compiled")
_V3 = {"avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
_V4 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
"""What a processor of x86-64-v3 has beside that of v2, and one of v4 beside that of v3, as Linux names it."""
_NAME = re.compile(r"[A-Za-z_]\w*")


def njit(*signatures: str, **options: Any) -> Callable[[Any], Any]:
    """Return a decorator that makes a function a kernel.

    Args:
        signatures: types of the arguments and the result, for each of which machine code is built. A function
            that only other kernels call has none.
        options: of :func:`numba.njit`. With ``cache=False``, numba keeps nothing of what it compiles.
    """

    def decorate(function: Any) -> Kernel:
        return Kernel(function, signatures, options)

    return decorate


class Kernel:
    """A function that runs as machine code: from the library of its package, else compiled by numba.

    Attributes:
        py_func: the function as it is written.
        declared: its signatures, as text.
    """

    def __init__(self, function: Any, declared: tuple[str, ...], options: dict[str, Any]) -> None:
        self.py_func = function
        self.declared = declared
        self._options = options
        self.__name__ = function.__name__
        self.__qualname__ = function.__qualname__
        self.__module__ = function.__module__
        self.__doc__ = function.__doc__

    def __call__(self, *args: Any) -> Any:
        for code in self.built:
            words: list[Any] = []
            copies: list[Any] = []
            if code.signature.pack(args, words, copies):
                return code.run(words)
        _say_why(self)
        return self.dispatcher(*args)

    def prepare(self, *args: Any) -> Callable[[int], Any]:
        """Return the kernel as a function of its last argument, a whole number.

        For calls by thousands, which are quick: packing arrays takes 2 microseconds each.

        Args:
            args: all arguments but the last. Their arrays may change between calls, but not move.
        """
        for code in self.built:
            words: list[Any] = []
            copies: list[Any] = []
            if code.signature.pack((*args, 0), words, copies) and not copies:
                return code.prepare(words, args)
        return partial(self, *args)

    @property
    def full_name(self) -> str:
        """The kernel's name in the table of a library."""
        return f"{self.__module__}.{self.__qualname__}"

    @cached_property
    def signatures(self) -> tuple[Signature, ...]:
        """The declared signatures."""
        return tuple(parse(text, self.py_func.__globals__) for text in self.declared)

    @cached_property
    def digest(self) -> str:
        """A digest of the source, of the constants that it names, and of the kernels that it calls."""
        code = self.py_func.__code__
        parts = [_source(self.py_func)]
        for name in sorted({*code.co_names, *_NAME.findall(" ".join(self.declared))}):
            value = self.py_func.__globals__.get(name)
            parts.append(f"{name} = {_meaning(value)}")
            if isinstance(value, ModuleType):
                for attribute in sorted(code.co_names):
                    parts.append(f"{name}.{attribute} = {_meaning(getattr(value, attribute, None))}")
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]

    @cached_property
    def dispatcher(self) -> Any:
        """The function as numba compiles it; it calls other kernels as numba compiles those."""
        names = dict(self.py_func.__globals__)
        for name in self.py_func.__code__.co_names:
            called = names.get(name)
            if isinstance(called, Kernel):
                names[name] = called.dispatcher
        function = FunctionType(
            self.py_func.__code__, names, self.__name__, self.py_func.__defaults__, self.py_func.__closure__
        )
        # numba keeps code by this name, and would not see that a constant or another kernel has changed.
        function.__qualname__ = f"{self.__qualname__}_{self.digest[:12]}"
        return _compile(function, self._options)

    @cached_property
    def built(self) -> "tuple[Code, ...]":
        """The code of each signature in the library; none where it is not of this source."""
        library = load_library(_package(self))
        if library is None or library.digests.get(self.full_name) != self.digest:
            return ()
        codes = []
        for index, signature in enumerate(self.signatures):
            function = library.code[symbol(self.full_name, index)]
            codes.append(Code(self.full_name, function, signature))
        return tuple(codes)


class Code(NamedTuple):
    """Machine code of a kernel for one signature."""

    name: str
    function: Any
    signature: Signature

    def run(self, words: list[Any]) -> Any:
        """Return the result for packed arguments.

        Raises:
            ArithmeticError: the code divided by zero, or got no memory.
        """
        return self._run(self.signature.buffer(words))

    def prepare(self, words: list[Any], args: tuple[Any, ...]) -> Callable[[int], Any]:
        """Return a function of the last of packed arguments.

        The function keeps ``args`` alive, because ``words`` has the addresses of their arrays.
        """
        buffer = self.signature.buffer(words)

        def run(last: int, _: Any = args) -> Any:
            """Run the code with ``last`` as its last argument; the other, ``_``, only keeps ``args``."""
            self.signature.replace_last(buffer, last)
            return self._run(buffer)

        return run

    def _run(self, buffer: Any) -> Any:
        status = self.function(buffer)
        if status:
            raise ArithmeticError(f"{self.name}: expected a result, got status {status}: 1/0, or no memory")
        return self.signature.result(buffer)


class Library(NamedTuple):
    """The kernels of a package, as they were built.

    Attributes:
        path: the file.
        code: its functions, by :func:`symbol`.
        digests: of each kernel when it was built, by its full name.
    """

    path: Path
    code: Any
    digests: dict[str, str]


@cache
def load_library(package: str) -> Library | None:
    """Return the library of a package; None where the package has none, or none that runs here."""
    file = getattr(sys.modules.get(package), "__file__", None)
    table = Path(file or "").parent / "kernels" / "table.json"
    if not file or not table.exists():
        return None
    path = table.with_name(library_name())
    try:
        code = ctypes.CDLL(str(path))
    except OSError:
        LOGGER.info(
            "no kernels are built for this machine (%s): numba compiles them, once, for 15 s", path.name
        )
        return None
    digests = {}
    for name, kernel in json.loads(table.read_text(encoding="utf-8"))["kernels"].items():
        digests[name] = kernel["digest"]
    return Library(path, code, digests)


def library_name() -> str:
    """Return the name of the library for this machine: where vectors are wider, another one."""
    name = f"{sys.platform}-{platform.machine().lower()}"
    if name == "linux-x86_64":
        flags = _flags()
        if flags >= _V3 | _V4:
            name += "-v4"
        elif flags >= _V3:
            name += "-v3"
    return f"{name}.so"


def _flags() -> set[str]:
    """Return what the processor has, as Linux names it."""
    with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
        for line in file:
            if line.startswith("flags"):
                return set(line.split())
    return set()


def symbol(full_name: str, index: int) -> str:
    """Return the name, in a library, of the code of the kernel ``full_name`` for its signature ``index``."""
    return f"{full_name.replace('.', '_')}_{index}"


def _package(kernel: Kernel) -> str:
    return kernel.__module__.partition(".")[0]


def _source(function: Any) -> str:
    """Return the lines of a function with its decorators: up to the next line that is not indented more."""
    code = function.__code__
    lines = linecache.getlines(code.co_filename)[code.co_firstlineno - 1 :]
    taken: list[str] = []
    begun = False
    for line in lines:
        text = line.strip()
        indent = len(line) - len(line.lstrip())
        if not taken:
            first_indent = indent
        elif begun and text and indent <= first_indent and not text.startswith(")"):
            break
        begun = begun or text.startswith("def ")
        taken.append(line.rstrip())
    return "\n".join(taken).rstrip()


def _meaning(value: Any) -> str:
    """Return what code depends on of a value that a kernel names; nothing of a module or a function."""
    if isinstance(value, Kernel):
        return value.digest
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tolist()}"
    if isinstance(value, np.generic):  # versions of NumPy spell it in different ways
        return f"{value.dtype} {value.item()!r}"
    if isinstance(value, (bool, int, float, tuple, np.dtype)):
        return repr(value)
    if isinstance(value, type) and issubclass(value, tuple):
        return f"{getattr(value, '_fields', ())} {fields_of(value)}"
    return ""


@cache
def _say_why(kernel: Kernel) -> None:
    """Tell, once, why numba compiles a kernel, which takes seconds."""
    library = load_library(_package(kernel))
    if kernel.built:
        LOGGER.info(
            "%s: numba compiles it, for types of arguments that it does not declare", kernel.full_name
        )
    elif library is not None:
        LOGGER.info(
            "%s: numba compiles it, since %s has none of its source", kernel.full_name, library.path.name
        )


def _compile(function: Any, options: dict[str, Any]) -> Any:
    """Return a function as numba compiles it, and keeps it where it can.

    Raises:
        ImportError: numba is not installed.
    """
    try:
        import numba
    except ImportError as cause:
        wanted = f"{function.__module__}.{function.__name__}: expected numba, which compiles it here"
        raise ImportError(f"{wanted}; pip install 'omniscv[compile]'") from cause
    if numba.config.DISABLE_JIT:
        # Interpreted, kernels take hundreds of times as long, and divide by zero where compiled ones get inf.
        numba.config.DISABLE_JIT = 0
        warnings.warn("NUMBA_DISABLE_JIT is ignored: kernels of omniscv have to be compiled", stacklevel=2)
    options = {"cache": True, **options}
    try:
        return numba.njit(**options)(function)
    except RuntimeError:  # no folder can be written to
        advice = "set NUMBA_CACHE_DIR to a folder that can be written to"
        warnings.warn(f"compiled code cannot be kept, so each process compiles anew: {advice}", stacklevel=2)
        return numba.njit(**{**options, "cache": False})(function)
