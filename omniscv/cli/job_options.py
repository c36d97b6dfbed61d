"""The options that describe a job: beside its file they override the file's keys, without one they are it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from typer import Argument, Option

from omniscv.cli import console
from omniscv.cli.options import ConnectionOptions, edge, freeze, modes, numbers, one_number, parameter, size

if TYPE_CHECKING:
    from omniscv.job import Job

Keys = dict[str, Any]
"""Values by the keys of a job's file, as :func:`omniscv.job.overridden` takes them."""

_PATHS = ("source", "out", "record")


def models() -> Iterator[str]:
    """Yield the names of the camera models, for the shell's completion."""
    from omniscv.cameras import names

    yield from names()


def strategies() -> Iterator[str]:
    """Yield the names of the strategies, for the shell's completion."""
    from omniscv.planning import names

    yield from names()


def _as(key: str, value_of: Callable[[Any], Any] = lambda value: value) -> Callable[[Any], Keys]:
    """An option that stands for one key."""
    return lambda value: {key: value_of(value)}


class CaptureOptions(ConnectionOptions):
    """How to capture and compose; each option stands for keys of a job.

    Attributes:
        keys_of: the keys that an option stands for, as a function of its value.
    """

    keys_of: ClassVar[Mapping[str, Callable[[Any], Keys]]] = {
        "modes": _as("modes", modes),
        "strategy": _as("strategy"),
        "viewpoints": _as("viewpoints"),
        "face_size": _as("face_size", edge),
        "filter": _as("filter"),
        "max_error": _as("max_error_px", lambda text: one_number("--max-error", text.removesuffix("px"))),
        "normals": _as("normals"),
        "truth_scale": _as("truth_scale"),
        "timeout": _as("source_options.timeout_s", lambda value: one_number("--timeout", value)),
        "patience": _as("source_options.patience_s", lambda value: one_number("--patience", value)),
        "freeze": _as("freeze", freeze),
    }

    job: Path | None = Argument(None, metavar="JOB.yaml", help="A job; options beside it override its keys.")
    modes: str = Option("lit", help="Some of lit,object_mask (or mask),depth,normals.")
    strategy: str = Option(
        "auto",
        help="auto, cube, faces, strips, reproject, adaptive; see 'omniscv plan'.",
        autocompletion=strategies,
    )
    viewpoints: int | None = Option(None, help="Optical centres of a non-central camera.")
    face_size: str = Option("auto", help="px of a 90 degree face, or auto.")
    filter: str = Option("auto", help="auto, nearest, bilinear, bicubic or area.")
    max_error: str | None = Option(None, help="Error that reproject and adaptive may make, such as 0.5px.")
    normals: str = Option("captured", help="captured, or from-depth: of planes fitted to depth.")
    truth_scale: int = Option(1, help="How many times finer masks, depth and normals are captured, 1 to 8.")

    def to_job(self) -> Job:
        """Return the job of the file, changed by the options that are given beside it; without, that of all.

        Options that override keys of a file are named in a line on standard error.
        """
        from omniscv.job import address, load, overridden, read

        if self.job is None:
            return read(overridden(self.described(), self.keys(list(self.values))), Path())
        keys = self.keys([name for name in self.values if name in self.given])
        if self.job.resolve().parent != Path.cwd():
            for key in keys.keys() & set(_PATHS):
                keys[key] = address(keys[key], Path.cwd())
        job = load(self.job, keys)
        if said := "; ".join(self._said()):
            console.error(f"{self.job}: {said}")
        return job

    def keys(self, names: list[str]) -> Keys:
        """Return the keys of a job that some options stand for."""
        keys: Keys = {}
        for name in names:
            if name in self.keys_of and self.values[name] not in (None, []):
                keys |= self.keys_of[name](self.values[name])
        return keys

    def described(self) -> Keys:
        """Return the keys of a job that has no file, and for which there are no options."""
        return {}

    def _said(self) -> Iterator[str]:
        """What each option overrides."""
        for name in self.values:
            if name in self.given and name in self.keys_of:
                found = self.keys_of[name](self.values[name])
                keys = " and ".join(key for key, value in found.items() if value is not None)
                yield f"--{name.replace('_', '-')} overrides {keys}"


class JobOptions(CaptureOptions):
    """A job: from its file, or with one camera and one pose."""

    keys_of: ClassVar = {
        **CaptureOptions.keys_of,
        "source": _as("source"),
        "camera": lambda model: {"cameras": {model: {"model": model}}, "rig": None},
        "size": lambda text: dict(zip(("cameras.*.width", "cameras.*.height"), size(text), strict=True)),
        "fov": _as("cameras.*.fov_deg"),
        "param": lambda texts: {f"cameras.*.{name}": value for name, value in map(parameter, texts)},
        "position": lambda text: {"poses": [{"position": numbers("--position", text)}]},
        "yaw": _as("poses.*.yaw_deg"),
        "pitch": _as("poses.*.pitch_deg"),
        "roll": _as("poses.*.roll_deg"),
    }

    source: str = Option("mock://four-wall", help="unreal://host:port, mock://NAME, scene://NAME, recording.")
    camera: str = Option(
        "equirectangular", help="A camera model; see 'omniscv cameras'.", autocompletion=models
    )
    size: str = Option("1024x512", help="Width x height of the image, px.")
    fov: float | None = Option(None, help="Full field of view, degrees.")
    param: list[str] = Option([], help="A camera parameter such as radius=1 or k=0.1,0.2,0,0; repeatable.")
    position: str = Option("0,0,1.5", help="X,Y,Z in metres: X forward, Y left, Z up.")
    yaw: float = Option(0.0, help="Degrees, to the left +.")
    pitch: float = Option(0.0, help="Degrees, nose up +.")
    roll: float = Option(0.0, help="Degrees, right side down +.")

    def keys(self, names: list[str]) -> Keys:
        if "camera" in names and "size" not in names:
            names = ["size", *names]
        return super().keys(sorted(names, key=lambda name: name != "camera"))  # others change what it is


class ImageOptions(JobOptions):
    """A job, and where its images are written."""

    keys_of: ClassVar = {
        **JobOptions.keys_of,
        "out": _as("out"),
        "record": _as("record", str),
        "image_format": _as("image_format"),
    }

    out: str = Option("out", help="Folder for the images.")  # a text: as a path, a URL would lose a slash
    record: Path | None = Option(None, help="A recording to take captures from, and to add new ones to.")
    image_format: str = Option("png", help="png, jxl or jpg, for lit.")
