"""What the commands' arguments look like, and how they become values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from omniscv import cameras
from omniscv.captures.view import MODES
from omniscv.errors import ArgumentError


def size(text: str) -> tuple[int, int]:
    """``1024x512`` as (width, height)."""
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise ArgumentError(f"--size: expected WIDTHxHEIGHT such as 1024x512, got {text!r}")
    return int(width), int(height)


def numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    """``0,0,1.5`` as ``count`` numbers."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise ArgumentError(f"{option}: expected {count} numbers separated by commas, got {text!r}")
    return values


def modes(text: str) -> tuple[str, ...]:
    """``lit,depth`` as modes; ``mask`` is short for ``object_mask``."""
    chosen = tuple({"mask": "object_mask"}.get(part.strip(), part.strip()) for part in text.split(","))
    if unknown := [mode for mode in chosen if mode not in MODES]:
        raise ArgumentError(f"--modes: expected some of {', '.join(MODES)}; got {unknown[0]!r}")
    return tuple(dict.fromkeys(chosen))


def face_size(text: str) -> int | str:
    """``auto`` or a whole number of pixels."""
    if text == "auto":
        return text
    if not text.isdigit() or int(text) < 1:
        raise ArgumentError(f"--face-size: expected 'auto' or a whole number of pixels >= 1, got {text!r}")
    return int(text)


def launched(path: Path, edge: int | str) -> str:
    """The address of a game that is to be started, with images of a face's size where it sets its own."""
    return f"launch:{path}" + (f"?size={edge}x{edge}" if isinstance(edge, int) else "")


def pixels(option: str, text: str) -> float:
    """``0.5px`` or ``0.5`` as pixels."""
    try:
        return float(text.removesuffix("px"))
    except ValueError:
        raise ArgumentError(f"{option}: expected pixels such as 0.5px, got {text!r}") from None


def parameters(pairs: list[str]) -> dict[str, Any]:
    """``key=value`` pairs, each value read as YAML: numbers, lists, words."""
    result: dict[str, Any] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.isidentifier():
            raise ArgumentError(f"--param: expected NAME=VALUE such as radius=1.0, got {pair!r}")
        try:
            result[key] = yaml.safe_load(value)
        except yaml.YAMLError as cause:
            raise ArgumentError(f"--param: expected NAME=VALUE with a YAML value, got {pair!r}") from cause
    return result


def camera(name: str, size_text: str, fov_deg: float | None, params: list[str]) -> cameras.Camera:
    """A camera from the options --camera, --size, --fov and --param."""
    width, height = size(size_text)
    arguments = parameters(params)
    if fov_deg is not None:
        arguments["fov_deg"] = fov_deg
    return cameras.create(name, width=width, height=height, **arguments)
