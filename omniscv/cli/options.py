"""Options that several commands have, and those that describe a job.

Beside a job's file these override its keys; without a file they are the job.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Argument, Context, Option

from omniscv.cli import console
from omniscv.errors import ArgumentError

if TYPE_CHECKING:
    from omniscv.cameras import Camera
    from omniscv.job import Job
    from omniscv.sources.registry import Deadlines

AsJson = Annotated[bool, Option("--json", help="As JSON, for programs.")]


@dataclass(frozen=True)
class Waiting:
    """Options of commands that ask a live server; see :func:`with_blocks`."""

    timeout: Annotated[
        float | None, Option(help="Seconds for connecting, and for each reply of a server; 15.")
    ] = None
    patience: Annotated[float | None, Option(help="Seconds of retries after a fault; 10.")] = None

    def deadlines(self) -> Deadlines:
        """Return the options that are given, as those of a source."""
        from omniscv.arguments import number  # loads NumPy, which help does without

        values: Deadlines = {}
        if self.timeout is not None:
            values["timeout_s"] = number("--timeout", self.timeout, above=0)
        if self.patience is not None:
            values["patience_s"] = number("--patience", self.patience, above=0)
        return values


Keys = dict[str, Any]
"""Values by dotted keys of a job's file, as :func:`omniscv.job.overridden` takes them."""
_PATHS = ("source", "out", "record")
_CAMERA = "Camera"
_POSE = "Pose"
_OUTPUT = "Captures and output"
_ANY = "Every other key"
SOURCE_HELP = "unreal://host:port, mock://NAME, scene://NAME, recording."
_SET_HELP = (
    "KEY=VALUE: a key of the job, dotted, and its value in YAML, such as strategy=exact, camera.fov_deg=185, "
    "source_options.timeout_s=60; repeatable. 'omniscv job --keys' lists the keys."
)


def size(text: str) -> tuple[int, int]:
    """Return ``1024x512`` as (width, height)."""
    if not re.fullmatch(r"[0-9]{1,9}[xX][0-9]{1,9}", text):
        raise wrong("--size", "WIDTHxHEIGHT such as 1024x512", text)
    width, height = text.lower().split("x")
    return int(width), int(height)


def numbers(option: str, text: str, example: str = "0,0,1.5") -> tuple[float, ...]:
    """Return the numbers of a text such as ``0,0,1.5``.

    Args:
        option: that has it, for messages.
        text: as it was given.
        example: has as many numbers.
    """
    try:
        values = tuple(map(float, text.split(",")))
    except ValueError:
        values = ()
    if len(values) != len(example.split(",")):
        raise wrong(option, f"numbers such as {example}", text)
    return values


def setting(text: str, example: str = "strategy=exact or camera.fov_deg=185") -> tuple[str, Any]:
    """Return ``--set KEY=VALUE`` as a dotted key and YAML's value.

    ``camera.`` and ``pose.`` at the start stand for every camera and every pose.

    Args:
        text: as it was given.
        example: of one, for messages.
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
    """Return the error of an option's value.

    Args:
        option: that has it.
        expected: what it takes.
        text: as it was given.
    """
    from omniscv.arguments import shown  # loads NumPy, which help does without

    return ArgumentError(f"{option}: expected {expected}, got {shown(text)}")


class JobOption(NamedTuple):
    """An option that stands for keys of a job.

    Attributes:
        keys: function from the option's value to the keys that it sets.
        type: of the value.
        default: where there is no file; None and empty lists set nothing.
        help: in the command's help.
        panel: group of options in the help.
        complete: yields words for the shell's completion.
    """

    keys: Callable[[Any], Keys]
    type: Any
    default: Any
    help: str
    panel: str = ""
    complete: Callable[[], Iterable[str]] | None = None

    def parameter(self, name: str, shows_default: bool) -> Parameter:
        """Return the parameter of a command for typer.

        Args:
            name: of the parameter, from which that of the option follows.
            shows_default: whether the help shows the default.
        """
        option = Option(
            self.default,
            f"--{name.replace('_', '-')}",
            help=self.help,
            show_default=shows_default,
            rich_help_panel=self.panel or None,
            autocompletion=self.complete,
        )
        return Parameter(name, Parameter.KEYWORD_ONLY, default=option, annotation=self.type)


def key(name: str, value_of: Callable[[Any], Any] = lambda value: value) -> Callable[[Any], Keys]:
    """Return the ``keys`` of an option that stands for one key.

    Args:
        name: of the key, dotted.
        value_of: returns the key's value by the option's; the same if not given.
    """
    return lambda value: {name: value_of(value)}


def _models() -> Iterator[str]:
    """Yield the names of camera models."""
    from omniscv.cameras import names

    yield from names()


def _key_names() -> Iterator[str]:
    """Yield the keys of jobs, with an equals sign."""
    from omniscv.job import keys

    for key in keys():
        yield f"{key.name}="


def is_calibration(camera: str) -> bool:
    """Return whether the text of ``--camera`` is a file's name: models have neither dots nor folders."""
    return "." in camera or len(Path(camera).parts) > 1


def central_camera(option: str, text: str, size: tuple[int, int], settings: list[str]) -> Camera:
    """Return the camera that an option names, in a size.

    Args:
        option: its name, for messages.
        text: a model, or a calibration file with one camera.
        size: width and height, px.
        settings: ``KEY=VALUE`` parameters of a model.

    Raises:
        ArgumentError: parameters beside a calibration file, or one with several cameras.
    """
    from omniscv.calibration import load
    from omniscv.cameras import create

    if is_calibration(text):
        if settings:
            raise ArgumentError(
                f"{option}: expected no parameters beside a calibration file, got {settings[0]!r}"
            )
        cameras = load(Path(text), size=size)
        if len(cameras) != 1:
            raise ArgumentError(f"{option}: expected a file with one camera, got {', '.join(cameras)}")
        return next(iter(cameras.values()))
    parameters = {}
    for item in settings:
        name, value = setting(item, "fov_deg=185")
        parameters[name] = value
    return create(text, width=size[0], height=size[1], **parameters)


def _camera(text: str) -> Keys:
    """Return the keys of ``--camera``: a model, or a calibration file."""
    is_file = is_calibration(text)
    name = Path(text).stem.replace(".", "-") if is_file else text
    return {"cameras": {name: {"file" if is_file else "model": text}}, "rig": None}


def _modes(text: str) -> tuple[str, ...]:
    """Return the words of a text with commas, each once."""
    return tuple(dict.fromkeys(map(str.strip, text.split(","))))


def _size(text: str) -> Keys:
    """Return the keys of ``--size``."""
    width, height = size(text)
    return {"cameras.*.width": width, "cameras.*.height": height}


MODES = JobOption(
    key("modes", _modes),
    str,
    "lit",
    "Some of lit,object_mask (or mask),depth,normals.",
    _OUTPUT,
)

SET: Mapping[str, JobOption] = {
    "set": JobOption(lambda texts: dict(map(setting, texts)), list[str], [], _SET_HELP, _ANY, _key_names)
}

VIEW: Mapping[str, JobOption] = {
    "source": JobOption(key("source"), str, "mock://four-wall", SOURCE_HELP, _OUTPUT),
    "camera": JobOption(
        _camera,
        str,
        "equirectangular",
        "A camera model; see 'omniscv cameras'. Or a calibration file, which has the size.",
        _CAMERA,
        _models,
    ),
    "size": JobOption(
        _size,
        str,
        "1024x512",
        "Width x height of the image, px.",
        _CAMERA,
    ),
    "position": JobOption(
        lambda text: {"poses": [{"position": numbers("--position", text)}]},
        str,
        "0,0,1.5",
        "X,Y,Z in metres: X forward, Y left, Z up. Of a recording of one place: that place.",
        _POSE,
    ),
    "yaw": JobOption(key("poses.*.yaw_deg"), float, 0.0, "Degrees, to the left +.", _POSE),
    "pitch": JobOption(key("poses.*.pitch_deg"), float, 0.0, "Degrees, nose up +.", _POSE),
    "roll": JobOption(key("poses.*.roll_deg"), float, 0.0, "Degrees, right side down +.", _POSE),
    "modes": MODES,
    "accuracy": JobOption(
        key("accuracy"), str | None, None, "Share of the pixels that may be doubtful, such as 0.1%.", _OUTPUT
    ),
    "most_captures": JobOption(
        key("most_captures"), int | None, None, "Captures of an image at which --accuracy stops.", _OUTPUT
    ),
    "most_megapixels": JobOption(
        key("most_megapixels"), float | None, None, "Megapixels at which --accuracy stops.", _OUTPUT
    ),
    **SET,
}
"""One camera at one pose."""

IMAGES: Mapping[str, JobOption] = {
    **VIEW,
    # A text: as a path, a URL would lose a slash.
    "out": JobOption(key("out"), str, "out", "Folder for the images.", _OUTPUT),
    **SET,
}
"""One camera at one pose, and where its images are written."""


@dataclass(frozen=True)
class JobArguments:
    """The job of a command line.

    Attributes:
        file: of the job; None without one.
        options: by name.
        values: of the options, by name.
        given: names of the options on the command line.
        described: the keys of a job without a file, before its options.
        typed: the words of the command line, without the program's name.
    """

    file: Path | None
    options: Mapping[str, JobOption]
    values: dict[str, Any]
    given: frozenset[str]
    described: Keys = field(default_factory=dict)
    typed: tuple[str, ...] = ()

    def load(self) -> Job:
        """Return the job of the file, changed by the given options; without a file, the job of all options.

        A line on standard error says which options override keys of a file.
        """
        from omniscv.job import load

        job = self._described_job() if self.file is None else load(self.file, self._overriding_keys())
        for line in job.assumed.splitlines():
            console.error(line)
        if self.file is not None:
            self._say_what_is_overridden()
        return job

    @property
    def _needs_size(self) -> bool:
        """Whether ``--camera`` is a model that has no size of its own."""
        camera = self.values.get("camera", "")
        return not is_calibration(camera) and camera != "lidar"

    def _described_job(self) -> Job:
        """Return the job of all options."""
        from omniscv.job import overridden, read

        if "position" in self.options and "position" not in self.given:
            place = _only_place(self.values["source"])
            if place is not None:
                self.values["position"] = place
        names = set(self.options)
        if not self._needs_size and "size" not in self.given:
            names.discard("size")
        return read(overridden(self.described, self._keys(names)), Path())

    def _overriding_keys(self) -> Keys:
        """Return the keys of given options; paths in them are relative to the working folder, not the
        file's."""
        from omniscv.job import address

        assert self.file is not None
        names = set(self.given)
        if "camera" in self.given and self._needs_size:
            names.add("size")
        keys = self._keys(names)
        if self.file.resolve().parent == Path.cwd():
            return keys
        for name in _PATHS:
            if keys.get(name) is not None:
                keys[name] = address(keys[name], Path.cwd())
        if is_calibration(self.values.get("camera", "")):
            for camera in keys.get("cameras", {}).values():
                camera["file"] = str(Path.cwd() / camera["file"])
        return keys

    def _say_what_is_overridden(self) -> None:
        """Print which options override keys of the file, if any does."""
        overriding = []
        for name in self._ordered(self.given):
            changed = []
            for key, value in self.options[name].keys(self.values[name]).items():
                if value is not None or name == "set":
                    changed.append(key)
            overriding.append(f"--{name.replace('_', '-')} overrides {' and '.join(changed)}")
        if overriding:
            console.error(f"{self.file}: {'; '.join(overriding)}")

    def _keys(self, names: Iterable[str]) -> Keys:
        """Return the keys that options set, by their names."""
        keys: Keys = {}
        for name in self._ordered(names):
            if self.values[name] not in (None, []):
                keys |= self.options[name].keys(self.values[name])
        return keys

    def _ordered(self, names: Iterable[str]) -> list[str]:
        """Return names in the order of the options: a camera before its size, ``--set`` last."""
        order = [name for name in self.options if name != "set"]
        return sorted(names, key=[*order, "set"].index)


def _only_place(source: object) -> str | None:
    """Return the position of a recording of one place, as ``--position`` has it; None for other sources."""
    from omniscv.sources.registry import is_recording

    if not isinstance(source, str) or not is_recording(Path(source)):
        return None
    from omniscv.sources.recording.inspection import centers  # loads OpenCV

    places = {center.center for center in centers(source)}
    return ",".join(map(repr, places.pop())) if len(places) == 1 else None


def with_blocks(body: Callable[..., None]) -> Callable[..., None]:
    """Return a command that has the fields of its dataclass parameters as options of their own."""
    blocks: dict[str, Any] = {}
    options: list[Parameter] = []
    for parameter in signature(body, eval_str=True).parameters.values():
        block = parameter.annotation
        if is_dataclass(block) and block is not JobArguments:
            blocks[parameter.name] = block
            options += signature(blocks[parameter.name], eval_str=True).parameters.values()
        else:
            options.append(parameter)

    @wraps(body)
    def command(**values: Any) -> None:
        for name, block in blocks.items():
            values[name] = block(**{option.name: values.pop(option.name) for option in fields(block)})
        body(**values)

    options = [option.replace(kind=Parameter.KEYWORD_ONLY) for option in options]
    command.__signature__ = Signature(options)  # type: ignore[attr-defined]
    command.__annotations__ = {}
    return command


def with_job(
    options: Mapping[str, JobOption], *, needs_file: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a command the options of a job; ``job`` is its :class:`JobArguments`.

    Args:
        options: by name.
        needs_file: the job's file must be given.
    """
    file = Argument(
        ... if needs_file else None, metavar="JOB.yaml", help="A job; options beside it override its keys."
    )

    def decorate(body: Callable[..., None]) -> Callable[..., None]:
        @wraps(body)
        def command(context: Context, job: Path | None, **values: Any) -> None:
            """Call the body with the arguments of the job in ``job``; ``context`` knows which were given."""
            given = set()
            of_job = {}
            for name in options:
                origin = context.get_parameter_source(name)
                if origin and origin.name == "COMMANDLINE":
                    given.add(name)
                of_job[name] = values.pop(name)
            typed = tuple(context.find_root().obj or ())
            body(job=JobArguments(job, options, of_job, frozenset(given), typed=typed), **values)

        parameters = [
            Parameter("context", Parameter.KEYWORD_ONLY, annotation=Context),
            Parameter("job", Parameter.KEYWORD_ONLY, default=file, annotation=Path | None),
        ]
        for name, option in options.items():
            parameters.append(option.parameter(name, shows_default=not needs_file))
        for parameter in signature(body, eval_str=True).parameters.values():
            if parameter.name != "job":
                parameters.append(parameter.replace(kind=Parameter.KEYWORD_ONLY))
        command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {}
        return command

    return decorate
