"""Options of commands: classes whose attributes describe them, and how their texts become values."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self, get_args, get_type_hints

from typer import Argument, Context, Option

from omniscv.errors import ArgumentError

if TYPE_CHECKING:
    from omniscv.jobs import Job
    from omniscv.sources.registry import Deadlines, SourceOptions

AsJson = Annotated[bool, Option("--json", help="As JSON, for programs.")]


class Options:
    """The options of a command: a subclass describes each by ``name: type = typer.Option(default, ...)``.

    Attributes:
        beside_job: what may be given beside a job file.
    """

    beside_job = frozenset(("job",))

    def __init__(self, **values: Any) -> None:
        vars(self).update(values)

    @classmethod
    def command(cls, body: Callable[[Self], None]) -> Callable[..., None]:
        """Return the function of a command for typer; ``body`` is called with one object for all options."""

        @wraps(body)
        def run(context: Context, **values: Any) -> None:
            for name in values if values.get("job") else ():
                origin = context.get_parameter_source(name)
                if name not in cls.beside_job and origin is not None and origin.name == "COMMANDLINE":
                    option = f"--{name.replace('_', '-')}"
                    raise ArgumentError(f"{option}: expected a job file or this option, got both")
            body(cls(**values))

        kinds = {"context": Context, **get_type_hints(cls)}
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

    beside_job = frozenset(("job", "timeout", "patience", "freeze"))
    timeout: float | None = Option(None, help="Seconds for connecting, and for each reply of a server; 15.")
    patience: float | None = Option(None, help="Seconds for connecting and sending again after a fault; 10.")
    freeze: str | None = Option(
        None, help="How a live world is kept still: auto, puppet, pause, batch or none."
    )

    def source_options(self) -> SourceOptions:
        """Those that are given, as options of :func:`omniscv.open_source`."""
        return {**deadlines(self.timeout, self.patience), **frozen(self.freeze)}


class JobOptions(ConnectionOptions):
    """A job: from its file, or with one camera and one pose."""

    job: Path | None = Argument(None, metavar="JOB.yaml", help="A job, in place of options.")
    source: str = Option("mock://four-wall", help="unreal://host:port, mock://NAME, scene://NAME, recording.")
    camera: str = Option("equirectangular", help="A camera model; see 'omniscv cameras'.")
    size: str = Option("1024x512", help="Width x height of the image, px.")
    fov: float | None = Option(None, help="Full field of view, degrees.")
    param: list[str] = Option([], help="A camera parameter such as radius=1 or k=0.1,0.2,0,0; repeatable.")
    position: str = Option("0,0,1.5", help="X,Y,Z in metres: X forward, Y left, Z up.")
    yaw: float = Option(0.0, help="Degrees, to the left +.")
    pitch: float = Option(0.0, help="Degrees, nose up +.")
    roll: float = Option(0.0, help="Degrees, right side down +.")
    modes: str = Option("lit", help="Some of lit,object_mask (or mask),depth,normals.")
    strategy: str = Option("auto", help="auto, cube, faces, strips, reproject, adaptive; see 'omniscv plan'.")
    viewpoints: int | None = Option(None, help="Optical centres of a non-central camera.")
    face_size: str = Option("auto", help="px of a 90 degree face, or auto.")
    filter: str = Option("auto", help="auto, nearest, bilinear, bicubic or area.")
    max_error: str | None = Option(None, help="Error that reproject and adaptive may make, such as 0.5px.")
    normals: str = Option("captured", help="captured, or from-depth: of planes fitted to depth.")
    truth_scale: int = Option(1, help="How many times finer masks, depth and normals are captured, 1 to 8.")

    def to_job(self, stem: str | None = None, **others: Any) -> Job:
        """Return the job; ``others`` are further fields of :class:`omniscv.jobs.Job`, not for a job file."""
        from omniscv.cameras import create
        from omniscv.geometry import Pose
        from omniscv.jobs import Job, load
        from omniscv.planning import RenderOptions

        if self.job is not None:
            job = load(self.job)
            return replace(job, source_options={**job.source_options, **self.source_options()})
        width, height = size(self.size)
        fov = {} if self.fov is None else {"fov_deg": self.fov}
        parameters = {"width": width, "height": height, **fov, **dict(map(parameter, self.param))}
        position = numbers("--position", self.position)
        error = self.max_error
        bound = None if error is None else numbers("--max-error", error.removesuffix("px"), "0.5")[0]
        filter: Any = self.filter
        normals: Any = self.normals
        return Job(
            source=self.source,
            cameras={stem or self.camera: create(self.camera, **parameters)},
            poses=(Pose.from_angles(position, self.yaw, self.pitch, self.roll),),
            modes=modes(self.modes),
            options=RenderOptions(
                self.strategy, self.viewpoints, edge(self.face_size), filter, bound, self.truth_scale, normals
            ),
            source_options=self.source_options(),
            **others,
        )


def deadlines(timeout: float | None, patience: float | None) -> Deadlines:
    """``--timeout`` and ``--patience`` as options of a source, where they are given."""
    from omniscv.arguments import number

    given: Deadlines = {}
    if timeout is not None:
        given["timeout_s"] = number("--timeout", timeout, above=0)
    if patience is not None:
        given["patience_s"] = number("--patience", patience, above=0)
    return given


def frozen(freeze: str | None) -> SourceOptions:
    """``--freeze`` as an option of a source, where it is given."""
    from omniscv.arguments import one_of
    from omniscv.sources.world import Freeze

    return {} if freeze is None else {"freeze": one_of("--freeze", freeze, get_args(Freeze))}


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


def modes(text: str) -> tuple[str, ...]:
    """``lit,mask`` as modes, each once."""
    return tuple(dict.fromkeys(part.strip() for part in text.split(",")))


def parameter(text: str) -> tuple[str, Any]:
    """``NAME=VALUE``; the value is YAML, or a list separated by commas."""
    from omniscv import yaml_text

    name, equals, value = text.partition("=")
    try:
        if not (equals and name.isidentifier()):
            raise ArgumentError("no name")
        found = yaml_text.parse(value)
        return name, yaml_text.parse(f"[{value}]") if isinstance(found, str) and "," in found else found
    except ArgumentError as cause:
        raise _wrong("--param", "NAME=VALUE such as radius=1.0 or k=0.1,0.2", text) from cause


def _wrong(option: str, wanted: str, text: str) -> ArgumentError:
    from omniscv.arguments import shown  # loads NumPy, which help does without

    return ArgumentError(f"{option}: expected {wanted}, got {shown(text)}")
