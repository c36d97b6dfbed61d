"""The formats that datasets are exported to, by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from omniscv import plugins
from omniscv.arguments import one_of
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.records import NoOptions, read

RELATIVE_ERROR_HELP = "part of the depth; leave out pixels whose depth_error is larger; null: none"
"""Of the option of formats of points."""


class Format(ABC):
    """Base of the formats. A subclass has at least a name and :meth:`write`.

    Attributes:
        name: of the format in jobs and commands.
        needs: kinds of files that its frames must have.
        keys: keys of the job that are added to the options, such as ``seam``.
        options: record of the options (:mod:`omniscv.records`) that the methods get; None: they get the
            mapping as it is.
    """

    name: str
    needs: Sequence[str] = ()
    keys: Sequence[str] = ()
    options: type[Any] | None = NoOptions

    def refuses(self, camera: Camera) -> str | None:
        """Return why the format cannot carry a camera, in one line; None if it can."""
        return None

    def check_options(  # noqa: B027 - most formats take every camera with any of their options
        self, options: Any, cameras: Mapping[str, Camera]
    ) -> None:
        """Raise ArgumentError for options that do not fit the cameras, before anything is captured."""

    @abstractmethod
    def write(self, frames: Sequence[Frame], out: Path, options: Any) -> list[Path]:
        """Write frames below a folder, and return the files.

        Raises:
            ArgumentError: frames that the format cannot carry.
        """

    def export(self, frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
        """Write frames as :meth:`write` does, with options as a job has them."""
        return self.write(frames, out, self.read_options(options))

    def check(self, frames: Sequence[Frame], out: Path) -> list[str] | None:
        """Return a line for each fault of an export; None: compare it with a new export."""
        return None

    def read_options(self, options: Mapping[str, Any]) -> Any:
        """Return the options as the methods get them.

        Raises:
            ArgumentError: an unknown option, or a wrong value.
        """
        return options if self.options is None else read(self.options, options)


class _Outside(Format):
    """A format that is no subclass of :class:`Format`: an object with ``name``, ``refuses``, ``write``."""

    options = None

    def __init__(self, format: Any) -> None:
        if missing := [name for name in ("name", "refuses", "write") if not hasattr(format, name)]:
            raise ArgumentError(f"format: expected an object with {', '.join(missing)}, got {format!r}")
        self._format = format
        names = ("name", "needs", "keys", "options", "refuses", "check_options", "check")
        vars(self).update({name: getattr(format, name) for name in names if hasattr(format, name)})

    def write(self, frames: Sequence[Frame], out: Path, options: Any) -> list[Path]:
        """Write frames as the object does."""
        files: list[Path] = self._format.write(frames, out, options)
        return files


_NAMES = (
    "ply",
    "depth_png",
    "normals_png",
    "poses",
    "colmap",
    "nerfstudio",
    "kalibr",
    "tum_mono",
    "flow",
    "cfl",
    "horizonnet",
    "structured3d",
    "webdataset",
    "hf",
    "coco",
    "omni3d",
)
"""The formats of this package; the module of each name in :mod:`omniscv.dataset.formats` registers it."""

_FORMATS: dict[str, Format] = {}


def register(format: Any) -> None:
    """Add a format, or replace the one of its name.

    Args:
        format: a :class:`Format`, or an object with ``name``, ``refuses`` and ``write``.

    Raises:
        ArgumentError: it lacks one of these.
    """
    adapted = format if isinstance(format, Format) else _Outside(format)
    _FORMATS[adapted.name] = adapted


def names() -> tuple[str, ...]:
    """Return the names of all formats."""
    plugins.load()
    return tuple(dict.fromkeys((*_NAMES, *_FORMATS)))


def get(name: str) -> Format:
    """Return a format by its name; ``-`` and ``_`` are alike.

    Raises:
        ArgumentError: no format has that name.
    """
    known = {format.replace("-", "_"): format for format in names()}
    one_of("format", name.replace("-", "_"), known)
    name = known[name.replace("-", "_")]
    if name not in _FORMATS:
        import_module(f"omniscv.dataset.formats.{name}")
    return _FORMATS[name]
