"""The formats that datasets are exported to, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from omniscv import plugins
from omniscv.cameras import Camera
from omniscv.dataset.frames import Frame
from omniscv.errors import ArgumentError


@runtime_checkable
class Format(Protocol):
    """What a format is: a module, or any object, with a name and two functions."""

    name: str

    def write(self, frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
        """Write frames below a folder, and return the files; an unknown option is an ArgumentError."""

    def refuses(self, camera: Camera) -> str | None:
        """Return why the format cannot carry a camera, in one line; None where it can."""


_MODULES: tuple[str, ...] = (
    "coco",
    "omni3d",
)
"""The formats of this package: modules of :mod:`omniscv.dataset.formats`, ``-`` as ``_``, imported on use."""

_FORMATS: dict[str, Format] = {}


def register(format: Format) -> None:
    """Add a format, or replace the one of its name.

    Raises:
        ArgumentError: it lacks ``name``, ``write`` or ``refuses``.
    """
    if not isinstance(format, Format):
        raise ArgumentError(f"format: expected an object with name, write and refuses, got {format!r}")
    _FORMATS[format.name] = format


def names() -> tuple[str, ...]:
    """Return the names of all formats."""
    plugins.load()
    return tuple(dict.fromkeys((*_MODULES, *_FORMATS)))


def get(name: str) -> Format:
    """Return a format by its name.

    Raises:
        ArgumentError: no format has that name.
    """
    if name not in _FORMATS and name in _MODULES:
        register(import_module(f"omniscv.dataset.formats.{name.replace('-', '_')}"))
    if name not in _FORMATS:
        plugins.load()
    if name not in _FORMATS:
        raise ArgumentError(f"format: expected one of {', '.join(names())}; got {name!r}")
    return _FORMATS[name]
