"""Types of a kernel's arguments, and how Python's values become the words that machine code reads.

A signature is text: ``"float64[:, ::1], out float32[:], bool, (2 * int64) -> int64"``. It lists numbers;
arrays, in C order where ``::1`` stands for the last dimension, and marked ``out`` if the kernel writes to
them; tuples; and the names, in the kernel's module, of a NamedTuple (:func:`fields`) or of a dtype of
records. ``2 *`` repeats a type.

An array is passed as numba passes one: two words for its owner, which are 0, its number of elements, bytes an
element, address, shape and strides.
"""

import ctypes
import re
import sys
from dataclasses import dataclass
from struct import Struct
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

Class = TypeVar("Class", bound=type)

_SCALARS = MappingProxyType({
    "bool": "?", "int32": "i", "int64": "q", "uint32": "I", "uint64": "Q", "float32": "f", "float64": "d",
})  # fmt: skip
"""The scalars that kernels take, and their codes for :mod:`struct`."""
_ELEMENTS = MappingProxyType({name: np.dtype(name) for name in (*_SCALARS, "uint8", "int16", "uint16")})
"""The elements of arrays, beside records."""
_TOKEN = re.compile(r"\s*(->|::1|\w+|[][(),:*])")
_FIELDS: dict[type, str] = {}


_interface = ctypes.pythonapi.PyCapsule_GetPointer
_interface.argtypes = (ctypes.py_object, ctypes.c_void_p)
_interface.restype = ctypes.c_void_p
_LAST = Struct("<q")
_DATA_AT = 40
"""Where the address of the data stands in the structure of NumPy's array interface protocol, bytes."""


def _address(array: np.ndarray[Any, Any]) -> int | None:
    """Return the address of an array's first element. ``array.ctypes.data`` takes three times as long."""
    return ctypes.c_void_p.from_address(_interface(array.__array_struct__, None) + _DATA_AT).value


def fields(types: str) -> Any:
    """Return a decorator that declares the types of the fields of a NamedTuple, which kernels take."""

    def declare(cls: Class) -> Class:
        _FIELDS[cls] = types
        return cls

    return declare


def fields_of(cls: type) -> str | None:
    """Return the types of a NamedTuple's fields, as declared; None where they are not."""
    return _FIELDS.get(cls)


@dataclass(frozen=True)
class Scalar:
    """A number. Whole numbers fit into float64, not the other way round."""

    name: str

    def pack(self, value: Any, words: list[Any], copies: list[Any]) -> bool:
        """Append a ``value`` to ``words``; return whether it has this type. Numbers need no ``copies``."""
        if self.name == "float64":
            fits = isinstance(value, (float, int, np.floating, np.integer))
        elif self.name == "int64":
            fits = isinstance(value, (int, np.integer))
        elif self.name == "bool":
            fits = isinstance(value, (bool, np.bool_))
        else:
            fits = isinstance(value, getattr(np, self.name))
        words.append(value)
        return fits

    @property
    def code(self) -> str:
        """The words' code for :mod:`struct`: 8 bytes."""
        code = _SCALARS[self.name]
        return code + "x" * (8 - Struct(code).size)


@dataclass(frozen=True)
class ArrayType:
    """An array of a number of dimensions: contiguous, or of any strides; written to, or only read."""

    dtype: np.dtype[Any]
    ndim: int
    contiguous: bool
    out: bool

    def pack(self, value: Any, words: list[Any], copies: list[Any]) -> bool:
        """Append the words of an array; return whether it has this type.

        Args:
            value: the array, or any other value.
            words: the list to append to.
            copies: an array that is only read is copied if its layout differs, and its copy appended here.

        Raises:
            ValueError: an array that is written to is read-only, or has another layout.
        """
        if not isinstance(value, np.ndarray) or value.ndim != self.ndim or value.dtype != self.dtype:
            return False
        flags = value.flags
        if self.out and not flags.writeable:
            raise ValueError("kernel: expected an array that can be written to, got a read-only one")
        if self.contiguous and not flags.c_contiguous:
            if self.out:
                raise ValueError(
                    f"kernel: expected an array in C order to write to, got strides {value.strides}"
                )
            value = np.ascontiguousarray(value)
            copies.append(value)
        words += (0, 0, value.size, value.itemsize, _address(value), *value.shape, *value.strides)
        return True

    @property
    def code(self) -> str:
        """The words' code for :mod:`struct`."""
        return "q" * (5 + 2 * self.ndim)


@dataclass(frozen=True)
class TupleType:
    """A tuple, or a NamedTuple of the class ``cls``."""

    items: "tuple[Type, ...]"
    cls: type[tuple[Any, ...]] | None = None

    def pack(self, value: Any, words: list[Any], copies: list[Any]) -> bool:
        """Append the words of all items of ``value``; return whether they have these types.

        Copies of arrays are appended to ``copies``; see :meth:`ArrayType.pack`.
        """
        if not isinstance(value, self.cls or tuple) or len(value) != len(self.items):
            return False
        return all(type_.pack(item, words, copies) for item, type_ in zip(value, self.items, strict=True))

    @property
    def code(self) -> str:
        """The words' code for :mod:`struct`."""
        return "".join(item.code for item in self.items)


Type = Scalar | ArrayType | TupleType


class Signature:
    """The types of a kernel's arguments and of its result: None, a number, or a tuple of numbers.

    Attributes:
        arguments: a tuple of all.
        returns: None where nothing is returned.
        words: the size of a buffer's part for arguments, bytes.
        size: the size of a buffer: an error's address, the arguments, the result; bytes.
    """

    def __init__(self, arguments: TupleType, returns: Scalar | TupleType | None) -> None:
        self.arguments = arguments
        self.returns = returns
        self._packed = Struct("<q" + arguments.code)
        self._returned = Struct("@" + _returned_code(returns))
        self.result_at = self._packed.size
        self.size = self.result_at + max(8, self._returned.size)
        self._buffer = ctypes.c_char * self.size

    def pack(self, args: tuple[Any, ...], words: list[Any], copies: list[Any]) -> bool:
        """Append the words of the arguments ``args``; return whether they have the declared types.

        Arrays that are appended to ``copies`` must live until the call ends.
        """
        return self.arguments.pack(args, words, copies)

    def buffer(self, words: list[Any]) -> Any:
        """Return a buffer with packed arguments."""
        buffer = self._buffer()
        self._packed.pack_into(buffer, 0, 0, *words)
        return buffer

    def replace_last(self, buffer: Any, value: int) -> None:
        """Write ``value``, a whole number, in place of the last argument of a buffer."""
        _LAST.pack_into(buffer, self.result_at - _LAST.size, value)

    def result(self, buffer: Any) -> Any:
        """Return what code wrote into a buffer."""
        if self.returns is None:
            return None
        values = self._returned.unpack_from(buffer, self.result_at)
        return values if isinstance(self.returns, TupleType) else values[0]


def _returned_code(returns: Scalar | TupleType | None) -> str:
    """Return the code of a result for :mod:`struct`, aligned as in C."""
    if returns is None:
        return ""
    items = returns.items if isinstance(returns, TupleType) else (returns,)
    return "".join(_SCALARS[item.name] for item in items if isinstance(item, Scalar))


def parse(text: str, names: dict[str, Any]) -> Signature:
    """Return the signature of a text.

    Args:
        text: as the module's docstring describes it.
        names: what names of NamedTuples and dtypes mean: the globals of the kernel's module.

    Raises:
        ValueError: the text is no signature.
    """
    reader = _Reader(text, names)
    arguments = reader.items("")
    returns = reader.item() if reader.take("->") else None
    if reader.tokens or isinstance(returns, ArrayType):
        raise ValueError(f"signature {text!r}: expected the end after a number or a tuple of numbers")
    return Signature(TupleType(arguments), returns)


class _Reader:
    """Reads a signature from the left."""

    def __init__(self, text: str, names: dict[str, Any]) -> None:
        self.text = text
        self.names = names
        self.tokens = _TOKEN.findall(text)[::-1]

    def take(self, token: str) -> bool:
        """Return whether a token is the next, and pass it."""
        is_next = bool(self.tokens) and self.tokens[-1] == token
        if is_next:
            self.tokens.pop()
        return is_next

    def items(self, end: str) -> tuple[Type, ...]:
        """Return types separated by commas, up to the token ``end``."""
        items = self.repeated()
        while self.take(","):
            items += self.repeated()
        if end and not self.take(end):
            raise ValueError(f"signature {self.text!r}: expected {end!r}")
        return tuple(items)

    def repeated(self) -> list[Type]:
        """Return the next type, as often as a number before it says."""
        count = 1
        if self.tokens and self.tokens[-1].isdigit():
            count = int(self.tokens.pop())
            self.take("*")
        return [self.item()] * count

    def item(self) -> Type:
        """Return the next type."""
        out = self.take("out")
        if self.take("("):
            return TupleType(self.items(")"))
        name = self.tokens.pop() if self.tokens else ""
        if self.take("["):
            return self._array(name, out)
        if name in _SCALARS:
            return Scalar(name)
        cls = self.names.get(name)
        if cls not in _FIELDS:
            raise ValueError(f"signature {self.text!r}: expected a type, got {name!r}")
        nested = _Reader(_FIELDS[cls], vars(sys.modules[cls.__module__]))
        return TupleType(nested.items(""), cls)

    def _array(self, name: str, out: bool) -> ArrayType:
        """Return the array whose dimensions follow."""
        dtype = _ELEMENTS.get(name, self.names.get(name))
        dimensions: list[str] = []
        while self.tokens and self.tokens[-1] in (":", "::1", ","):
            dimensions.append(self.tokens.pop())
        if not isinstance(dtype, np.dtype) or not dimensions or not self.take("]"):
            raise ValueError(
                f"signature {self.text!r}: expected an array such as 'float64[:, ::1]' at {name!r}"
            )
        return ArrayType(dtype, dimensions.count(",") + 1, dimensions[-1] == "::1", out)
