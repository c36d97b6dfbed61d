"""Records: frozen dataclasses whose fields are checked and converted where they are declared.

::

    @record
    class Shutter:
        seconds: float = checked(number, least=0, default=0.0, help="time that it is open")
        blades: int = checked(whole_number, most=1000, default=1)

    Shutter(seconds=-1)  # ArgumentError: seconds: expected a finite number >= 0, got -1
    read(Shutter, {"second": 1}, "shutter")
    # ArgumentError: shutter: unknown key 'second'; did you mean seconds? known keys: seconds, blades

A reader must return what it returned before unchanged: :func:`dataclasses.replace` checks again.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import partial
from typing import Any, TypeVar, dataclass_transform, get_args, overload

from omniscv.arguments import Reader, did_you_mean, one_of, shown, text
from omniscv.errors import ArgumentError

T = TypeVar("T")
_READER = "omniscv.reader"
_KEY = "omniscv.key"
_HELP = "omniscv.help"


def checked(
    reader: Callable[..., Any],
    /,
    *,
    default: Any = MISSING,
    default_factory: Any = MISSING,
    key: str = "",
    help: str = "",
    **limits: Any,
) -> Any:
    """Return a field of a record that ``reader(name, value, **limits)`` checks and converts.

    Args:
        reader: such as the functions of :mod:`omniscv.arguments`, :func:`nested`, :func:`listed`.
        default: as of :func:`dataclasses.field`; it is not checked.
        default_factory: the same.
        key: in files, where it is not the field's name, as for a word of Python's.
        help: one line for the tables of options that are generated.
        limits: passed on to the reader.
    """
    metadata = {_READER: partial(reader, **limits) if limits else reader, _KEY: key, _HELP: help}
    if default_factory is not MISSING:
        return field(default_factory=default_factory, metadata=metadata)
    return field(default=default, metadata=metadata)


def word(words: Any, *, default: Any, help: str = "") -> Any:
    """Return a field of a record that is one of a few words.

    Args:
        words: a Literal, or a tuple of them.
        default: one of them; it is not checked.
        help: one line for the tables of options that are generated.
    """
    return checked(one_of, words=get_args(words) or words, default=default, help=help)


@overload
@dataclass_transform(frozen_default=True, field_specifiers=(checked, word, field))
def record(cls: type[T], /) -> type[T]: ...
@overload
@dataclass_transform(frozen_default=True, field_specifiers=(checked, word, field))
def record(*, eq: bool = ..., repr: bool = ..., in_files: bool = ...) -> Callable[[type[T]], type[T]]: ...
def record(
    cls: type[T] | None = None, /, *, eq: bool = True, repr: bool = True, in_files: bool = False
) -> Any:
    """Make a class a frozen dataclass whose ``checked`` fields are converted before its ``__post_init__``.

    Args:
        cls: the class.
        eq: whether records of equal fields are equal; False where fields are arrays.
        repr: as :func:`dataclasses.dataclass`.
        in_files: fields have other forms in files: only :func:`read_fields` converts them.
    """
    if cls is None:
        return partial(record, eq=eq, repr=repr, in_files=in_files)
    after = cls.__dict__.get("__post_init__")

    def check(self: Any) -> None:
        for option in fields(self):
            value = getattr(self, option.name)
            if _READER in option.metadata and value is not option.default:
                object.__setattr__(self, option.name, option.metadata[_READER](key_of(option), value))
        if after is not None:
            after(self)

    if not in_files:
        cls.__post_init__ = check  # type: ignore[attr-defined]
    result = dataclass(frozen=True, eq=eq, repr=repr)(cls)
    lines = []
    for option in fields(result):  # type: ignore[arg-type]
        if help_of(option):
            lines.append(f"    {key_of(option)}: {help_of(option)}")
    if lines:
        result.__doc__ = "\n".join([(result.__doc__ or "").rstrip(), "", "Options:", *lines])
    return result


@record
class NoOptions:
    """Options of what has none."""


class WithOptions:
    """Base of what reads its options by a record; without one, it takes the mapping as it is."""

    options: type[Any] | None = None

    def read_options(self, options: Mapping[str, Any]) -> Any:
        """Return the options as the methods get them; ArgumentError for an unknown one or a wrong value."""
        return options if self.options is None else read(self.options, options)


def read(cls: type[T], value: object, where: str = "") -> T:
    """Return the record that a mapping, as of a file, describes.

    Args:
        cls: a class made by :func:`record`.
        value: what should be a mapping of keys to values.
        where: of the mapping in its file, for messages.

    Raises:
        ArgumentError: no mapping, an unknown or missing key, or as a reader raises.
    """
    given = _given(fields(cls), value, where)  # type: ignore[arg-type]
    try:
        return cls(**given)
    except ArgumentError as cause:
        raise ArgumentError(f"{where}.{cause.args[0]}" if where else cause.args[0]) from cause


def read_fields(cls: type[Any], value: object) -> dict[str, Any]:
    """Return the values of a mapping, as of a file, by the names of a record's fields, as their readers
    convert them; ArgumentError as :func:`read`."""
    known = {option.name: option for option in fields(cls) if reader_of(option)}
    values = {}
    for name, entry in _given(known.values(), value, "").items():
        option = known[name]
        is_default = entry is option.default or (entry is None and option.default_factory is not MISSING)
        if not is_default:
            values[name] = option.metadata[_READER](key_of(option), entry)
    return values


def _given(known: Iterable[Field[Any]], value: object, where: str) -> dict[str, Any]:
    """Return the values of a mapping by the names of fields; ArgumentError for a key that is unknown or
    missing."""
    by_key = {key_of(option): option for option in known}
    given = mapping(where, value, by_key)
    for key, option in by_key.items():
        if key not in given and option.default is MISSING and option.default_factory is MISSING:
            start = f"{where}: " if where else ""
            raise ArgumentError(f"{start}missing key {key!r}; known keys: {', '.join(by_key)}")
    return {by_key[key].name: entry for key, entry in given.items()}


def mapping(where: str, value: object, known: Collection[str] | None = None) -> dict[str, Any]:
    """Return a mapping as a dict; ArgumentError for anything else, or for a key that is not known.

    Args:
        where: it stands in its file, for messages; "" for the file itself.
        value: what should be a mapping.
        known: the keys that it may have; None: any.
    """
    start = f"{where}: " if where else ""
    if not isinstance(value, Mapping):
        wanted = f"a mapping with {', '.join(known)}" if known else "a mapping"
        raise ArgumentError(f"{start}expected {wanted}, got {shown(value)}")
    for key in value:
        if known is not None and key not in known:
            hint = did_you_mean(key, known)
            separator = f"{hint} " if hint else "; "
            listed = ", ".join(known) or "none"
            raise ArgumentError(f"{start}unknown key {shown(key)}{separator}known keys: {listed}")
    return dict(value)


def nested(cls: type[Any]) -> Reader:
    """Return a reader of a record inside another: takes the record itself, or its mapping."""
    return lambda name, value: value if isinstance(value, cls) else read(cls, value, name)


def listed(reader: Reader) -> Reader:
    """Return a reader of lists, as tuples, whose items a reader checks as ``NAME[INDEX]``."""

    def items(name: str, value: object) -> tuple[Any, ...]:
        """Return ``value`` checked, with ``name`` in errors."""
        if not isinstance(value, list | tuple):
            raise ArgumentError(f"{name}: expected a list, got {shown(value)}")
        return tuple(reader(f"{name}[{i}]", item) for i, item in enumerate(value))

    return items


def named(reader: Reader) -> Reader:
    """Return a reader of mappings by names, as dicts, whose values a reader checks as ``FIELD.NAME``."""

    def items(name: str, value: object) -> dict[str, Any]:
        """Return ``value`` checked, with ``name`` in errors."""
        entries: dict[str, Any] = {}
        for key, entry in mapping(name, value).items():
            entries[text(name, key)] = reader(f"{name}.{key}", entry)
        return entries

    return items


def optional(reader: Reader) -> Reader:
    """Return a reader that also takes None."""
    return lambda name, value: None if value is None else reader(name, value)


def key_of(option: Field[Any]) -> str:
    """Return the key of a record's field in files."""
    return str(option.metadata.get(_KEY) or option.name)


def reader_of(option: Field[Any]) -> Reader | None:
    """Return the reader of a record's field; None if it is no key of files."""
    return option.metadata.get(_READER)


def help_of(option: Field[Any]) -> str:
    """Return what a record's field is for, in one line."""
    return str(option.metadata.get(_HELP, ""))
