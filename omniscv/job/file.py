"""The file of a job: YAML, checked key by key. ``example.yaml`` beside this module has every key.

Paths are relative to the file. A rig may stand in the file; positions of its cameras are metres in the rig's
frame (x right, y down, z forward), angles degrees from where the rig looks::

    rig:
      cameras:
        left:  {camera: {model: fisheye-equidistant, width: 640, height: 640, fov_deg: 190}}
        right: {camera: {model: fisheye-equidistant, width: 640, height: 640, fov_deg: 190},
                position: [0.1, 0, 0], yaw_deg: -90, time_offset: 0.002}
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, get_args

from omniscv.arguments import (
    Reader,
    flag,
    number,
    numbers,
    one_of,
    shown,
    stem,
    stems,
    text,
    texts,
    whole_number,
    within,
    wrong,
)
from omniscv.calibration import load as load_cameras
from omniscv.calibration import load_rig
from omniscv.cameras import Camera, from_dict
from omniscv.cameras.lidar import PRESETS
from omniscv.cameras.rig import Rig
from omniscv.errors import ArgumentError
from omniscv.geometry.motion import Motion
from omniscv.geometry.trajectory import Trajectory
from omniscv.job.job import Exposure, Job
from omniscv.job.poses import Posed, PoseFile, Times, at_times, read_motions, read_poses, read_times
from omniscv.job.recipe import Media, Recipe, Split
from omniscv.job.sampling import KINDS
from omniscv.job.vary import Vary, read_vary
from omniscv.modalities import TRANSFERS
from omniscv.planning import RenderOptions
from omniscv.records import checked, help_of, key_of, mapping, nested, optional, record
from omniscv.records import read as read_record
from omniscv.render_options import LayoutKey, MapOptions, Tolerance
from omniscv.sensor import Sensor
from omniscv.sensor.imu import PASSES, Imu, ImuNoise, ImuTrack
from omniscv.sensor.optics import NATURAL
from omniscv.sources.registry import is_recording, scheme_of
from omniscv.sources.requests import MOST_STOPS
from omniscv.sources.world import Freeze, exposure_bias
from omniscv.storage import bounded, is_url, without_secrets

EXAMPLE = Path(__file__).parent / "example.yaml"
"""A job with every key, and a comment for each."""

EVERY = "*"
"""In a dotted key: every entry of a mapping or a list."""


_freeze: Reader = partial(one_of, words=get_args(Freeze))
_seconds, _count = partial(number, above=0), partial(whole_number, least=0)
_SOURCE_OPTIONS: dict[str, tuple[Reader, Any, str]] = {
    "timeout_s": (_seconds, 15.0, "seconds that connecting, and each reply, may take"),
    "patience_s": (_seconds, 10.0, "seconds of connecting and sending again after a fault"),
    "retries": (_count, 5, "how often, with exponential backoff"),
    "transfer": (
        partial(one_of, words=TRANSFERS),
        None,
        "what 8-bit colours say of light: srgb, linear, film or unknown",
    ),
    "fix_exposure": (flag, False, "switch off vignette and auto exposure in the running game"),
    "exposure": (exposure_bias, None, "exposure of the camera: auto, its bias in stops, or game"),
    "warmup": (_count, 0, "frames of colour to drop after each move, where effects blend them"),
    "freeze": (_freeze, None, ""),
}
"""Reader, default and help; ``freeze`` is a key of its own."""


# -- readers of the keys ---------------------------------------------------------------------------------


def _source(name: str, value: object) -> str | tuple[str, ...]:
    if not isinstance(value, str | list | tuple):
        raise wrong(name, "an address, a recording, or a list of them", value)
    return text(name, value) if isinstance(value, str) else texts(name, value)


@record
class _CameraFile:
    """A camera in a calibration file of another program."""

    file: str = checked(text)
    name: str | None = checked(optional(text), default=None)
    format: Any = None
    width: int | None = checked(optional(whole_number), default=None)
    height: int | None = checked(optional(whole_number), default=None)

    def load(self) -> Camera:
        """Return the camera; ArgumentError if the file has several and ``name`` is none of them."""
        sizes = self.width, self.height
        size = None if sizes == (None, None) else sizes
        cameras = load_cameras(self.file, self.format, size)  # type: ignore[arg-type]
        if self.name is None and len(cameras) == 1:
            return next(iter(cameras.values()))
        with within(self.file):
            return cameras[one_of("name", self.name, cameras)]


def _cameras(name: str, value: object) -> dict[str, Camera]:
    if not isinstance(value, dict) or not value:
        raise wrong(name, "a mapping from file stem to model and parameters, or to a calibration file", value)
    stems(name, value, dots=True)
    cameras: dict[str, Camera] = {}
    for camera, description in value.items():
        with within(f"{name}.{camera}"):
            if isinstance(description, str):
                description = {"file": description}
            if isinstance(description, Mapping) and "file" in description:
                cameras[camera] = read_record(_CameraFile, description).load()
            else:
                cameras[camera] = from_dict(description)
    return cameras


def _rig(name: str, value: object) -> Rig:
    """Return the rig of a file, or an inline one."""
    if not isinstance(value, str | Mapping):
        raise ArgumentError(f"{name}: expected a file's name or cameras by name, got {shown(value)}")
    with within(name):
        return load_rig(text("file", value)) if isinstance(value, str) else Rig.from_dict(value)


def _record(name: str, value: object) -> Path:
    if is_url(value):
        wanted = "expected a path on this machine, to be put into a store by 'omniscv recording merge'"
        raise ArgumentError(f"{name}: {wanted}; got {without_secrets(value)}")
    path = Path(text(name, value))
    if os.path.isdir(path):  # Path's own raises where the name is too long
        raise ArgumentError(f"{name}: expected a file or a free name, got a folder: {path}")
    return path


def _source_options(name: str, value: object) -> dict[str, Any]:
    """Check the options that are known here; the opener checks all."""
    return {
        key: _SOURCE_OPTIONS[key][0](f"{name}.{key}", option) if key in _SOURCE_OPTIONS else option
        for key, option in mapping(name, value).items()
    }


def _brackets(name: str, value: object) -> tuple[float, ...]:
    """Return stops in increasing order; none if there are none."""
    stops = numbers(name, value, (None,)).tolist() if isinstance(value, list | tuple) and value else []
    if (value and len(stops) < 2) or stops != sorted(set(stops)) or any(abs(s) > MOST_STOPS for s in stops):
        raise wrong(name, f"two or more increasing stops within {MOST_STOPS:g}, such as [-2, 0, 2]", value)
    return tuple(stops)


# -- the keys --------------------------------------------------------------------------------------------


@record
class Failures:
    """What happens to frames that fail."""

    skip: float = checked(
        number, least=0, most=1, default=0.0, help="share of frames that may fail, and are left out"
    )


@record
class _Keys:
    """The keys of a job's file, but for those of :class:`omniscv.RenderOptions` and :class:`Recipe`."""

    source: Any = checked(_source, help="an address, a recording, or a list: replicas of one game")
    poses: Posed = checked(read_poses, help="a list of poses, a trajectory file, or random, grid, path")
    source_options: Any = checked(_source_options, default=None, help="how the source is opened")
    record: Path | None = checked(
        optional(_record),
        default=None,
        help="recording whose captures are reused, and that new captures are added to",
    )
    cameras: Any = checked(
        _cameras, default=None, help="by name: model and parameters, or a calibration file"
    )
    rig: Any = checked(_rig, default=None, help="cameras that move together, or the name of a rig's file")
    modes: tuple[str, ...] = checked(texts, default=("lit",), help="some of lit, object_mask, depth, normals")
    out: str = checked(text, default="out", help="folder to write into, or the URL of a dataset")
    image_format: str = checked(text, default="png", help="file format of lit: png or jpg")
    depth_format: str = checked(
        text, default="exr", help="file format of depth, its bounds and normals: exr, tiff or npy"
    )
    store: str = checked(
        one_of,
        words=("files", "fast"),
        default="files",
        help="how layers are stored: files (pictures), or fast (arrays of Blosc2, by the extra fast)",
    )
    motions: Mapping[str, Motion] | None = checked(
        read_motions,
        default=None,
        help="by object: waypoints, {spline: waypoints}, or a trajectory file",
    )
    times: Times | None = checked(
        read_times,
        default=None,
        help="seconds: a list, {start, rate, count}, {rate}, or poses for the poses' times",
    )
    freeze: Freeze | None = checked(_freeze, default=None, help="how a live world is held at one instant")
    exposure: Exposure = checked(nested(Exposure), default=Exposure(), help="motion blur")
    brackets: tuple[float, ...] = checked(
        _brackets, default=(), help="stops of the exposures that are merged to floating-point light"
    )
    sensor: Sensor | None = checked(
        optional(nested(Sensor)), default=None, help="simulated noise and lens effects"
    )
    imu: Imu | None = checked(
        optional(nested(Imu)), default=None, help="an IMU on the rig; cameras then move on a spline"
    )
    vary: Vary | None = checked(
        optional(read_vary), default=None, help="what is drawn for each frame, place or world"
    )
    worlds: Any = checked(
        optional(mapping), default=None, help="by name, in place of source: each with a source, poses, split"
    )
    failures: Failures = checked(
        nested(Failures), default=Failures(), help="how many frames of a dataset may fail"
    )


_RENDER, _RECIPE = ({key_of(field): field for field in fields(cls)} for cls in (RenderOptions, Recipe))
_FIELDS = {key_of(field): field for field in fields(_Keys)} | _RECIPE | _RENDER
_BELOW: dict[str, type[Any]] = {
    "poses": PoseFile,
    **{f"poses.{kind}": cls for kind, cls in KINDS.items()},
    "exposure": Exposure,
    "sensor": Sensor,
    "imu": Imu,
    "imu.gyroscope": ImuNoise,
    "imu.accelerometer": ImuNoise,
    "vary": Vary,
    "failures": Failures,
    "split": Split,
    "media": Media,
    "layout": LayoutKey,
    "layout.maps": MapOptions,
    "truth.tolerance": Tolerance,
}


class Key(NamedTuple):
    """A key of a job's file.

    Attributes:
        name: dotted, as ``exposure.seconds``.
        default: the value if it is left out; ``dataclasses.MISSING`` if it must be given.
        help: one line.
    """

    name: str
    default: Any
    help: str


def keys() -> Iterator[Key]:
    """Yield every key that has a fixed name, each followed by the keys below it."""
    for name, key in _FIELDS.items():
        yield Key(name, key.default, help_of(key))
        for option, (_, default, line) in _SOURCE_OPTIONS.items() if name == "source_options" else ():
            if line:
                yield Key(f"{name}.{option}", default, line)
        for path, cls in _BELOW.items():
            if path.partition(".")[0] == name:
                for field in filter(help_of, fields(cls)):
                    default = field.default if field.default_factory is MISSING else None
                    yield Key(f"{path}.{key_of(field)}", default, help_of(field))


# -- reading ---------------------------------------------------------------------------------------------


def load(job: str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | None = None) -> Job:
    """Return the job in a YAML file, or that a mapping of the same keys describes.

    Args:
        job: path of the file, to whose folder paths in it are relative; or a mapping, whose paths are
            relative to the current folder.
        overrides: values in place of the file's, as :func:`overridden` takes them.

    Raises:
        ArgumentError: the file cannot be read, or a key is unknown, missing or wrong.
    """
    if isinstance(job, Mapping):
        return read(overridden(job, overrides or {}), Path())
    path = Path(job)
    if scheme_of(str(path)) or is_recording(path):
        source = str(path).replace(":/", "://", 1)
        wanted = "expected the file of a job, got a source of captures"
        raise ArgumentError(f"{source}: {wanted}; write --source {source}, or 'source: {source}' in a job")
    with within(path):
        return read(overridden(bounded.parse_yaml(bounded.read_text(path)), overrides or {}), path.parent)


def overridden(description: object, overrides: Mapping[str, Any]) -> Any:
    """Return a copy of a description with other values.

    Args:
        description: a job's, before it is read.
        overrides: by key, with dots between levels: ``face_size``, ``source_options.timeout_s``. A star is
            every entry of a mapping or a list: ``cameras.*.width``. None removes a key.

    Raises:
        ArgumentError: a key below something that is no mapping, or below cameras though there is a rig.
    """
    for key, value in overrides.items():
        if key.startswith(f"cameras.{EVERY}.") and isinstance(description, Mapping) and "rig" in description:
            wanted = "expected a job without a rig, to change all its cameras"
            raise ArgumentError(f"{key}: {wanted}; write it into the rig")
        description = _replaced(description, key.split("."), value, "job")
    return description


def _replaced(old: object, path: Sequence[str], new: object, name: str) -> Any:
    """Return a copy of nested mappings with another value at a path; ``name`` is that of ``old``."""
    if not path:
        return new
    key, *rest = path
    below = key if name == "job" else f"{name}.{key}"
    if key == EVERY and isinstance(old, list):
        return [_replaced(item, rest, new, below) for item in old]
    if not isinstance(old, Mapping) and (old is not None or key == EVERY):
        raise wrong(name, f"something in which {'.'.join(path)} can be set", old)
    changed = dict(old or {})
    for entry in list(changed) if key == EVERY else [key]:
        changed[entry] = _replaced(changed.get(entry), rest, new, below)
    if new is None and not rest:
        changed.pop(key, None)
    return changed


_OF_WORLDS = ("source", "source_options", "record", "poses", "times", "motions", "split", "vary")


def _read_worlds(worlds: Mapping[str, Any], shared: Mapping[str, Any], folder: Path) -> Job:
    """Return the job of several worlds; each has its keys, and those of the job that it does not give."""
    if not worlds or "source" in shared:
        wanted = "expected worlds by name, in place of source"
        raise ArgumentError(f"worlds: {wanted}, got {'both' if worlds else 'none'}")
    stems("worlds", worlds)
    jobs = []
    for name, keys in worlds.items():
        own = mapping(f"worlds.{name}", keys, _OF_WORLDS)
        split = own.pop("split", "")
        with within(f"worlds.{name}"):
            job = _read_one({**shared, **own}, folder, name)
            jobs.append(replace(job, world_split=split and stem("split", split)))
    cameras: dict[str, Camera] = {}
    for job in jobs:
        cameras = {**job.cameras, **cameras}
    return replace(jobs[0], cameras=cameras, worlds=tuple(jobs))


def read(description: object, folder: Path) -> Job:
    """Return the job that a mapping describes; its paths are relative to a folder.

    Raises:
        ArgumentError: a key is unknown, missing or wrong.
    """
    values = mapping("", description, _FIELDS)
    worlds = values.pop("worlds", None)
    if worlds is not None:
        return _read_worlds(mapping("worlds", worlds), values, folder)
    job = _read_one(values, folder)
    if job.recipe.split is not None and job.recipe.split.by == "world":
        raise ArgumentError("split.by: expected place in a job without 'worlds', got world")
    return job


_AS_READ = (
    *("modes", "record", "image_format", "store", "depth_format"),
    *("rig", "exposure", "brackets", "sensor", "vary"),
)
"""Keys that are attributes of a job as they are read."""


def _read_one(values: dict[str, Any], folder: Path, world: str = "") -> Job:
    """Return the job of one world."""
    for path in _FILES:
        values = _located(values, path.split("."), folder, ("", *PRESETS, *_NO_FILES.get(path, ())))
    vary = read_vary("vary", values.get("vary") or {})
    if vary.cameras:
        values = {**values, "cameras": vary.draw_cameras(values.get("cameras", {}), world)}
    options = RenderOptions(**{key: values.pop(key) for key in _RENDER if key in values})
    recipe = read_record(Recipe, {key: values.pop(key) for key in _RECIPE if key in values})
    keys = read_record(_Keys, values)
    freeze = {} if keys.freeze is None else {"freeze": keys.freeze}
    posed = at_times(keys.poses, keys.times, "linear" if keys.imu is None else "spline")
    moved = {name: motion.waypoints.says for name, motion in (keys.motions or {}).items()}
    lines = [posed.assumed, *(f"motions.{name}: {line}" for name, says in moved.items() for line in says)]
    track = None
    if keys.imu is not None:
        track, passed = _track(keys.imu, keys.poses, posed.times)
        lines.append(passed)
    posed = posed._replace(assumed="\n".join(filter(None, lines)))
    return Job(
        **{name: getattr(keys, name) for name in _AS_READ},
        **posed._asdict(),
        source=address(keys.source, folder),
        cameras=keys.cameras or {},
        out=keys.out if is_url(keys.out) else folder / keys.out,
        options=options,
        source_options={**(keys.source_options or {}), **freeze},  # type: ignore[typeddict-item]
        recipe=recipe,
        motions=keys.motions or {},
        clock=keys.times is not None,
        imu=track,
        failures=keys.failures.skip,
        world=world,
    )


def _track(imu: Imu, given: Posed, times: tuple[float, ...] | None) -> tuple[ImuTrack, str]:
    """Return an IMU on the spline through the poses that were given, at their own times or the job's, and in
    one line how far from them it passes."""
    wanted = "expected two or more poses with times, such as a trajectory's or a path's"
    times = given.times or times
    if times is None or len(times) != len(given.poses) or len(times) < 2:
        raise ArgumentError(f"imu: {wanted}, got {len(given.poses)} poses and {len(times or ())} times")
    with within("imu"):
        track = ImuTrack(imu, Trajectory(given.poses, times, "spline"))
        metres, radians = track.path.misses()
    if not max(metres, radians) <= PASSES:
        got = f"{metres:.2g} m and {radians:.2g} rad"
        raise ArgumentError(f"imu: expected a spline within {PASSES:g} m and rad of the poses, got {got}")
    passed = f"imu: a spline through {len(times)} poses, within {metres:.1g} m and {radians:.1g} rad of them"
    return track, passed


_FILES = (
    *("rig", "record", "classes", "poses", "poses.file", "poses.frame", "sensor.shading"),
    *("cameras.*", "cameras.*.file", "cameras.*.preset", "cameras.*.base.preset", "motions.*"),
    *("motions.*.spline", "rig.cameras.*.camera.preset", "rig.cameras.*.camera.base.preset"),
)
"""Keys whose values may be names of files, relative to the job's file."""
_NO_FILES = {"poses.frame": ("camera", "body"), "sensor.shading": (NATURAL,)}
"""Words that such a key has beside names of files."""


def _located(value: Any, path: Sequence[str], folder: Path, words: Sequence[str]) -> Any:
    """Return a copy of nested mappings in which the name of a file at a path has a folder before it; words
    are no names."""
    if not path:
        is_name = isinstance(value, str) and value not in words and not is_url(value)
        return str(folder / value) if is_name else value
    if not isinstance(value, Mapping):
        return value
    key, *rest = path
    names = value.keys() if key == EVERY else value.keys() & {key}
    return {**value, **{name: _located(value[name], rest, folder, words) for name in names}}


def address(source: str | Sequence[str], folder: Path) -> Any:
    """Return an address, or several as a tuple, whose paths, if they have any, are relative to a folder."""
    if not isinstance(source, str):
        return tuple(address(each, folder) for each in source)
    scheme = scheme_of(source)
    if scheme is None:
        return str(folder / source)
    path, question, options = source.removeprefix(f"{scheme}:").partition("?")
    slashes = "//" if path.startswith("//") else ""
    file = folder / path.removeprefix("//")
    if scheme == "launch" or os.path.isfile(file):
        return f"{scheme}:{slashes}{file}{question}{options}"
    return source
