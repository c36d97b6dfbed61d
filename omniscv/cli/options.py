"""Options of commands: classes whose attributes describe them, and how their texts become values."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from functools import wraps
from inspect import Parameter, Signature, get_annotations
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, get_args, get_origin

from typer import Context, Option

from omniscv.errors import ArgumentError

if TYPE_CHECKING:
    from omniscv.sources.registry import Deadlines

AsJson = Annotated[bool, Option("--json", help="As JSON, for programs.")]


class Options:
    """The options of a command: a subclass describes each by ``name: type = typer.Option(default, ...)``.

    Args:
        given: the names of those that the command line has.
        values: of all; attributes, too.
    """

    def __init__(self, given: Collection[str], values: Mapping[str, Any]) -> None:
        vars(self).update(values)
        self.given, self.values = frozenset(given), dict(values)

    @classmethod
    def command(cls, body: Callable[[Self], None]) -> Callable[..., None]:
        """Return the function of a command for typer; ``body`` is called with one object for all options."""

        @wraps(body)
        def run(context: Context, **values: Any) -> None:
            origins = {name: context.get_parameter_source(name) for name in values}
            given = [name for name, origin in origins.items() if origin and origin.name == "COMMANDLINE"]
            body(cls(given, values))

        kinds: dict[str, Any] = {"context": Context}
        for each in cls.__mro__:  # a command's own options before those that it shares with others
            for name, kind in get_annotations(each, eval_str=True).items():
                if ClassVar not in (kind, get_origin(kind)):
                    kinds.setdefault(name, kind)
        parameters = [
            Parameter(
                name, Parameter.KEYWORD_ONLY, default=getattr(cls, name, Parameter.empty), annotation=kind
            )
            for name, kind in kinds.items()
        ]
        run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
        return run


class ConnectionOptions(Options):
    """How long to wait for a live server."""

    timeout: float | None = Option(None, help="Seconds for connecting, and for each reply of a server; 15.")
    patience: float | None = Option(None, help="Seconds for connecting and sending again after a fault; 10.")
    freeze: str | None = Option(
        None, help="How a live world is kept still: auto, puppet, pause, batch or none."
    )


def deadlines(timeout: float | None, patience: float | None) -> Deadlines:
    """``--timeout`` and ``--patience`` as options of a source, where they are given."""
    given: Deadlines = {}
    if timeout is not None:
        given["timeout_s"] = one_number("--timeout", timeout)
    if patience is not None:
        given["patience_s"] = one_number("--patience", patience)
    return given


def freeze(text: str) -> str:
    """``--freeze``: one of its words."""
    from omniscv.arguments import one_of
    from omniscv.sources.world import Freeze

    found: str = one_of("--freeze", text, get_args(Freeze))
    return found


def size(text: str) -> tuple[int, int]:
    """``1024x512`` as (width, height)."""
    if not re.fullmatch(r"[0-9]{1,9}[xX][0-9]{1,9}", text):
        raise _wrong("--size", "WIDTHxHEIGHT such as 1024x512", text)
    width, height = text.lower().split("x")
    return int(width), int(height)


def edge(text: str) -> Any:
    """``--face-size``: ``auto``, or px as a whole number."""
    if text != "auto" and not re.fullmatch(r"[0-9]{1,9}", text):
        raise _wrong("--face-size", "auto or a number of px", text)
    return text if text == "auto" else int(text)


def numbers(option: str, text: str, example: str = "0,0,1.5") -> tuple[float, ...]:
    """``0,0,1.5`` as numbers, as many as the example has."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != len(example.split(",")):
        raise _wrong(option, f"numbers such as {example}", text)
    return values


def one_number(option: str, text: object) -> float:
    """A number above 0."""
    from omniscv.arguments import number

    return number(option, text, above=0)


def modes(text: str) -> tuple[str, ...]:
    """``lit,mask`` as modes, each once."""
    return tuple(dict.fromkeys(part.strip() for part in text.split(",")))


def parameter(text: str) -> tuple[str, Any]:
    """``NAME=VALUE``; the value is YAML, or a list separated by commas."""
    from omniscv.storage import bounded

    name, equals, value = text.partition("=")
    try:
        if not (equals and name.isidentifier()):
            raise ArgumentError("no name")
        found = bounded.parse_yaml(value)
        return name, bounded.parse_yaml(f"[{value}]") if isinstance(found, str) and "," in found else found
    except ArgumentError as cause:
        raise _wrong("--param", "NAME=VALUE such as radius=1.0 or k=0.1,0.2", text) from cause


def _wrong(option: str, wanted: str, text: str) -> ArgumentError:
    from omniscv.arguments import shown  # loads NumPy, which help does without

    return ArgumentError(f"{option}: expected {wanted}, got {shown(text)}")
