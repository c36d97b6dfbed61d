"""The formats that datasets are exported to, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from omniscv import plugins
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame


@runtime_checkable
class Format(Protocol):
    """What a format is: a module, or any object, with a name and two functions.

    It may also have ``needs``, the kinds of files that its frames must have; ``keys``, those of a job that it
    takes among its options, such as ``seam``; ``check_options(options, cameras)``, which raises ArgumentError
    before anything is captured; and ``check(frames, out)``, which returns a line for each fault of an export.
    """

    name: str

    def write(self, frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
        """Write frames below a folder, and return the files; an unknown option is an ArgumentError."""

    def refuses(self, camera: Camera) -> str | None:
        """Return why the format cannot carry a camera, in one line; None where it can."""


_MODULES: tuple[str, ...] = (
    "ply",
    "depth_png",
    "normals_png",
    "poses",
    "colmap",
    "nerfstudio",
    "kalibr",
    "flow",
    "cfl",
    "horizonnet",
    "structured3d",
    "webdataset",
    "hf",
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
    """Return a format by its name; ``-`` and ``_`` are alike.

    Raises:
        ArgumentError: no format has that name.
    """
    plugins.load()
    found = next((each for each in names() if each.replace("-", "_") == name.replace("-", "_")), None)
    if found is None:
        raise ArgumentError(f"format: expected one of {', '.join(names())}; got {name!r}")
    if found not in _FORMATS:
        register(import_module(f"omniscv.dataset.formats.{found.replace('-', '_')}"))
    return _FORMATS[found]
