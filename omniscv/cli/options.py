"""Options that several commands have, and how their texts become values."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from omniscv.errors import ArgumentError

if TYPE_CHECKING:
    from omniscv.sources.registry import Deadlines

AsJson = Annotated[bool, Option("--json", help="As JSON, for programs.")]
Timeout = Annotated[float | None, Option(help="Seconds for connecting, and for each reply of a server; 15.")]
Patience = Annotated[float | None, Option(help="Seconds of retries after a fault; 10.")]


def deadlines(timeout: float | None, patience: float | None) -> Deadlines:
    """Return ``--timeout`` and ``--patience``, where given, as options of a source."""
    from omniscv.arguments import number  # loads NumPy, which help does without

    values: Deadlines = {}
    if timeout is not None:
        values["timeout_s"] = number("--timeout", timeout, above=0)
    if patience is not None:
        values["patience_s"] = number("--patience", patience, above=0)
    return values


def size(text: str) -> tuple[int, int]:
    """Return ``1024x512`` as (width, height)."""
    if not re.fullmatch(r"[0-9]{1,9}[xX][0-9]{1,9}", text):
        raise wrong("--size", "WIDTHxHEIGHT such as 1024x512", text)
    width, height = text.lower().split("x")
    return int(width), int(height)


def numbers(option: str, text: str, example: str = "0,0,1.5") -> tuple[float, ...]:
    """Return ``0,0,1.5`` as numbers, as many as the example has."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != len(example.split(",")):
        raise wrong(option, f"numbers such as {example}", text)
    return values


def modes(text: str) -> tuple[str, ...]:
    """Return ``lit,mask`` as modes, each once."""
    return tuple(dict.fromkeys(part.strip() for part in text.split(",")))


def setting(text: str, example: str = "face_size=512 or camera.fov_deg=185") -> tuple[str, Any]:
    """Return ``--set KEY=VALUE`` as a dotted key and YAML's value.

    ``camera.`` and ``pose.`` at the start stand for every camera and every pose.
    """
    from omniscv.storage import bounded

    name, equals, value = text.partition("=")
    if not equals or not all(name.split(".")):
        raise wrong("--set", f"KEY=VALUE such as {example}", text)
    try:
        return re.sub(r"^(camera|pose)\.", r"\1s.*.", name), bounded.parse_yaml(value)
    except ArgumentError as cause:
        raise ArgumentError(f"--set {name}: {cause.message}") from cause


def wrong(option: str, expected: str, text: str) -> ArgumentError:
    """Return the error of an option's value."""
    from omniscv.arguments import shown  # loads NumPy, which help does without

    return ArgumentError(f"{option}: expected {expected}, got {shown(text)}")
