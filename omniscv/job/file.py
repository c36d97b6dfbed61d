"""The file of a job: YAML, checked key by key. ``example.yaml`` beside this module has every key."""

import inspect
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from omniscv.arguments import shown, stem, stems, within, wrong
from omniscv.cameras import Camera
from omniscv.cameras.lidar import PRESETS
from omniscv.cameras.registry import model, names
from omniscv.errors import ArgumentError
from omniscv.geometry.trajectory import NS, SINCE_1970_NS, Curve, Trajectory
from omniscv.geometry.trajectory_columns import FRAMES
from omniscv.job.job import Exposure, FailureLimit, Job, within_path
from omniscv.job.own_cameras import split_own_cameras
from omniscv.job.poses import Posed, PoseFile, at_times
from omniscv.job.readers import KnownOptions
from omniscv.job.recipe import Media, Recipe, Split
from omniscv.job.sampling import KINDS
from omniscv.job.vary import Vary
from omniscv.job.world_patterns import one_by_one
from omniscv.planning import RenderOptions
from omniscv.records import help_of, key_of, mapping, read_fields, reader_of
from omniscv.records import read as read_record
from omniscv.render_options import Tolerance
from omniscv.sensor import Sensor
from omniscv.sensor.imu import PASSES, Imu, ImuNoise, ImuTrack
from omniscv.sensor.optics import NATURAL
from omniscv.sources.registry import is_recording, scheme_of
from omniscv.storage import bounded, is_url

EXAMPLE = Path(__file__).parent / "example.yaml"
"""A job with every key, and a comment for each."""

EPOCH_NS = 1_700_000_000 * NS
"""Epoch of jobs with an IMU: in November 2023."""

EVERY = "*"
"""In a dotted key: every entry of a mapping or a list."""

_RENDER = {key_of(field): field for field in fields(RenderOptions)}
_RECIPE = {key_of(field): field for field in fields(Recipe)}
_JOB = {key_of(field): field for field in fields(Job) if reader_of(field)}
_FIELDS = _JOB | _RECIPE | _RENDER
_BELOW: dict[str, type[Any]] = {
    "poses": PoseFile,
    **{f"poses.{kind}": cls for kind, cls in KINDS.items()},
    "source_options": KnownOptions,
    "exposure": Exposure,
    "sensor": Sensor,
    "imu": Imu,
    "imu.gyroscope": ImuNoise,
    "imu.accelerometer": ImuNoise,
    "vary": Vary,
    "failures": FailureLimit,
    "split": Split,
    "media": Media,
    "truth.tolerance": Tolerance,
}
_GONE = {
    "shards": "write it into 'export', as {format: webdataset, max_count: 1000}",
    "seam": "write it into 'export', as {format: coco, seam: split}",
    "layout": "write truth: {layout: {source: fitted}}, and options of maps into 'export'",
    "poses.grid.visible": "write poses: {random: {visible: ...}}",
}
"""Keys of earlier versions, and what stands in their place."""


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
    for name, field in _FIELDS.items():
        yield _key(name, field)
        for path, cls in _BELOW.items():
            if path.partition(".")[0] == name:
                for below in fields(cls):
                    if help_of(below):
                        yield _key(f"{path}.{key_of(below)}", below)


def _key(name: str, field: Field[Any]) -> Key:
    return Key(name, field.default if field.default_factory is MISSING else None, help_of(field))


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
    """Return a copy of a job's ``description`` with the values of ``overrides``.

    Keys have dots between levels: ``face_size``, ``source_options.timeout_s``. A star is every entry of a
    mapping or a list: ``cameras.*.width``. None removes a key. ArgumentError: a key below something that is
    no mapping, or below cameras though there is a rig.
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
    key, *further = path
    below = key if name == "job" else f"{name}.{key}"
    if key == EVERY and isinstance(old, list):
        return [_replaced(item, further, new, below) for item in old]
    if old is None and key != EVERY:
        changed = {}
    elif isinstance(old, Mapping):
        changed = dict(old)
    else:
        raise wrong(name, f"something in which {'.'.join(path)} can be set", old)
    for entry in list(changed) if key == EVERY else [key]:
        changed[entry] = _replaced(changed.get(entry), further, new, below)
    if new is None and not further:
        changed.pop(key, None)
    return changed


_OF_WORLDS = ("source", "source_options", "record", "poses", "times", "motions", "split", "vary")


def _read_worlds(worlds: Mapping[str, Any], shared: Mapping[str, Any], folder: Path) -> Job:
    """Return the job of several worlds; each has its keys, and those of the job that it does not give."""
    if not worlds or "source" in shared:
        wanted = "expected worlds by name, in place of source"
        raise ArgumentError(f"worlds: {wanted}, got {'both' if worlds else 'none'}")
    worlds = one_by_one(worlds, folder)
    stems("worlds", worlds)
    jobs = []
    for name, keys in worlds.items():
        own = mapping(f"worlds.{name}", keys, _OF_WORLDS)
        split = own.pop("split", "")
        with within(f"worlds.{name}"):
            job = _read_one({**shared, **own}, folder, name)
            for camera, followed in job.own_cameras.items():
                if not followed.has_lens:
                    wanted = "expected width, height and fov_deg, with which all worlds are seen"
                    raise ArgumentError(f"cameras.{camera}: {wanted}, got those of a scene's camera")
            jobs.append(replace(job, world_split=split and stem("split", split)))
    cameras: dict[str, Camera] = {}
    for job in jobs:
        cameras = {**job.cameras, **cameras}
    return replace(jobs[0], cameras=cameras, worlds=tuple(jobs))


def read(description: object, folder: Path) -> Job:
    """Return the job of a ``description``, a mapping, whose paths are relative to a ``folder``.

    ArgumentError: as of :func:`load`.
    """
    values = mapping("", description)
    for path, instead in _GONE.items():
        below: Any = values
        for key in path.split("."):
            below = below.get(key) if isinstance(below, Mapping) else None
        if below is not None:
            raise ArgumentError(f"{path}: expected no such key, got {shown(below)}; {instead}")
    _refuse_parameters(values)
    values = mapping("", values, _FIELDS)
    worlds = values.pop("worlds", None)
    if worlds is not None:
        return _read_worlds(mapping("worlds", worlds), values, folder)
    job = _read_one(values, folder)
    if job.recipe.split is not None and job.recipe.split.by == "world":
        raise ArgumentError("split.by: expected place in a job without 'worlds', got world")
    return job


def _refuse_parameters(values: Mapping[str, Any]) -> None:
    """Refuse a key that is a parameter of the job's cameras: it is meant for these."""
    described = values.get("cameras")
    for key in values:
        if key in _FIELDS or not isinstance(described, Mapping):
            continue
        for name, camera in described.items():
            known = camera.get("model") if isinstance(camera, Mapping) else None
            if known in names() and key in inspect.signature(model(known)).parameters:
                meant = f"did you mean cameras.{name}.{key} (--set camera.{key}=...)?"
                raise ArgumentError(f"unknown key {shown(key)}; {meant}")


def _read_one(values: dict[str, Any], folder: Path, world: str = "") -> Job:
    """Return the job of one world."""
    for key in _FILES:
        values = _located(values, key.split("."), folder, ("", *PRESETS, *_NO_FILES.get(key, ())))
    vary = read_record(Vary, values.get("vary") or {}, "vary")
    if vary.cameras:
        values = {**values, "cameras": vary.draw_cameras(values.get("cameras", {}), world)}
    values, own_cameras = split_own_cameras(values)
    options = RenderOptions(**_take(values, _RENDER))
    recipe = read_record(Recipe, _take(values, _RECIPE))
    given = _one_exposure(read_fields(Job, values), values.get("sensor"))
    given |= _timed(given)
    given["source"] = address(given["source"], folder)
    out = given.get("out", "out")
    given["out"] = out if is_url(out) else folder / out
    job = Job(**given, own_cameras=own_cameras, options=options, recipe=recipe, world=world)
    return within_path(job)


def _take(values: dict[str, Any], keys: Iterable[str]) -> dict[str, Any]:
    """Remove the values of some keys, of those that there are, and return them."""
    taken = {}
    for key in keys:
        if key in values:
            taken[key] = values.pop(key)
    return taken


def _timed(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a job that depend on its times: poses, motions, the path and the IMU.

    Args:
        given: the fields, with ``poses`` as read and ``times_ns`` of the key ``times``.
    """
    imu = given.get("imu")
    times = given.get("times_ns")
    curve: Curve = "linear" if imu is None else "spline"
    posed = at_times(given["poses"], times, curve)
    motions = given.get("motions", {})
    lines = [posed.assumed]
    for name, motion in motions.items():
        lines += [f"motions.{name}: {line}" for line in motion.waypoints.says]
    path = _path(given["poses"], posed.times_ns, curve, imu is not None or _needs_path(given))
    epoch_ns = given.get("epoch_ns", 0)
    if imu is not None:
        lines.append(_check_spline(path, posed))
        epoch_ns = given.get("epoch_ns", _epoch_ns(path))
    if path is not None:
        path = path.later(epoch_ns)
    moved = {}
    for name, motion in motions.items():
        moved[name] = motion.later(epoch_ns)
    return {
        **posed.later(epoch_ns)._replace(assumed="\n".join(filter(None, lines)))._asdict(),
        "epoch_ns": epoch_ns,
        "motions": moved,
        "path": path,
        "imu": None if imu is None or path is None else ImuTrack(imu, path),
        "clock": times is not None,
    }


def _needs_path(given: Mapping[str, Any]) -> bool:
    """Return whether images have other times than their poses: in a rig with offsets, or by an exposure."""
    if "exposure" in given and given["exposure"].seconds:
        return True
    rig = given.get("rig")
    return rig is not None and any(mounted.time_offset for mounted in rig.cameras.values())


def _one_exposure(given: dict[str, Any], sensor: object) -> dict[str, Any]:
    """Return fields in which the sensor is exposed as long as the shutter is open; refuse two times."""
    seconds = given["exposure"].seconds if "exposure" in given else 0.0
    if not seconds or given.get("sensor") is None:
        return given
    if isinstance(sensor, Mapping) and sensor.get("exposure_s") not in (None, seconds):
        wanted = "expected none beside exposure.seconds, which is the sensor's, too"
        raise ArgumentError(f"sensor.exposure_s: {wanted}, got {shown(sensor['exposure_s'])}")
    return {**given, "sensor": replace(given["sensor"], exposure_s=seconds)}


def _path(given: Posed, times_ns: tuple[int, ...] | None, curve: Curve, wanted: bool) -> Trajectory | None:
    """Return the path through the poses that were given, at their own times or the job's; None if they have
    none, or times that do not increase and no path is wanted: such cameras rest."""
    times_ns = given.times_ns or times_ns
    if times_ns is None or not 2 <= len(given.poses) == len(times_ns):
        return None
    if not wanted and any(after <= before for before, after in pairwise(times_ns)):
        return None
    return Trajectory(given.poses, times_ns, curve)


def _check_spline(path: Trajectory | None, posed: Posed) -> str:
    """Return in one line how far the spline that an IMU moves on passes from the poses."""
    if path is None:
        wanted = "expected two or more poses with times, such as a trajectory's or a path's"
        present = f"{len(posed.poses)} poses and {len(posed.times_ns or ())} times"
        raise ArgumentError(f"imu: {wanted}, got {present}")
    with within("imu"):
        metres, radians = path.misses()
    if not max(metres, radians) <= PASSES:
        wanted = f"expected a spline within {PASSES:g} m and rad of the poses"
        raise ArgumentError(f"imu: {wanted}, got {metres:.2g} m and {radians:.2g} rad")
    return f"imu: a spline through {len(path)} poses, within {metres:.1g} m and {radians:.1g} rad of them"


def _epoch_ns(path: Trajectory | None) -> int:
    """Return the epoch of a sequence that does not say one: readers of bags and of EuRoC take stamps for
    nanoseconds since 1970, and 0 for none."""
    since_1970 = path is not None and path.times_ns is not None and path.times_ns[-1] > SINCE_1970_NS
    return 0 if since_1970 else EPOCH_NS


_FILES = (
    *("rig", "record", "classes", "poses", "poses.file", "poses.frame", "sensor.shading", "motions.*"),
    *("source_options.qpos", "cameras.*", "cameras.*.file", "cameras.*.preset", "cameras.*.base.preset"),
    *("motions.*.spline", "rig.cameras.*.camera.preset", "rig.cameras.*.camera.base.preset"),
)
"""Keys whose values may be names of files, relative to the job's file."""
_NO_FILES: dict[str, tuple[str, ...]] = {"poses.frame": FRAMES, "sensor.shading": (NATURAL,)}
"""Words that such a key has beside names of files."""


def _located(value: Any, path: Sequence[str], folder: Path, words: Sequence[str]) -> Any:
    """Return a copy of nested mappings in which the name of a file at a path has a folder before it; words
    are no names."""
    if not path:
        is_name = isinstance(value, str) and value not in words and not is_url(value)
        return str(folder / value) if is_name else value
    if not isinstance(value, Mapping):
        return value
    key, *further = path
    located = dict(value)
    for name in value if key == EVERY else value.keys() & {key}:
        located[name] = _located(value[name], further, folder, words)
    return located


def address(source: str | Sequence[str], folder: Path) -> Any:
    """Return the address of a ``source``, or several as a tuple; their paths are relative to a ``folder``."""
    if not isinstance(source, str):
        return tuple(address(replica, folder) for replica in source)
    scheme = scheme_of(source)
    if scheme is None:
        return str(folder / source)
    path, question, options = source.removeprefix(f"{scheme}:").partition("?")
    slashes = "//" if path.startswith("//") else ""
    file = folder / path.removeprefix("//")
    if scheme == "launch" or os.path.isfile(file):
        return f"{scheme}:{slashes}{file}{question}{options}"
    return source
