"""What a dataset is made of: a record by which a job, a shard or a writer is recognised as one of it.

``dataset.json`` has it as ``origin``, beside the cameras, classes, splits and options, before the first frame
is written. Datasets of version 0.2 have none. Values that a record does not have are unknown, and no
difference from other records. Options that it does not have had their defaults.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from typing import Any, Self

from omniscv.arguments import shown, text
from omniscv.compose.files import versions
from omniscv.errors import ArgumentError
from omniscv.job import Exposure
from omniscv.job.readers import KnownOptions
from omniscv.job.recipe import Media
from omniscv.job.vary import Vary
from omniscv.records import key_of, mapping
from omniscv.render_options import RenderOptions, Tolerance
from omniscv.sensor import Sensor
from omniscv.sensor.imu import Imu
from omniscv.truth import registry as truths

VERSION = 1

MAY_DIFFER = ("exports", "poses")
"""What a run may change of a dataset that it continues: exports, and the number of poses if existing frames
stay as they are. Timeouts, retries, workers, shards and ``failures`` are in no record."""

_RECORDS: dict[str, type[Any]] = {
    "options": RenderOptions,
    "options.exposure": Exposure,
    "options.sensor": Sensor,
    "options.imu.sensor": Imu,
    "options.vary": Vary,
    "options.media": Media,
    "source_options": KnownOptions,
}
"""By dotted key: the records whose fields have the defaults of options that a dataset does not have."""

_UNKNOWN = ("scene", "world", "frozen")
"""Keys of a world that are None if a source does not give them. None differs from nothing."""

_LAST_DIGITS = 1e-9
"""Largest difference of a number of a pose on two machines: absolute below 1, else relative."""

_OTHER_DEFAULTS = {"options.store": "files", "options.depth_format": "exr", "splits.rule": "hash"}

World = Mapping[str, Any]
"""What the frames of a world are captured of, as plain values:

``source``, ``source_options``, ``freeze`` as the job has them, without hosts, folders and time limits;
``scene``, its identity, and ``world``, a digest of all that it shows, None where the source cannot tell;
``frozen``, a digest of where its objects were when it was frozen for all frames, None if it was not;
``sampling``, how poses were drawn; and ``poses``, their number and a digest."""


@dataclass(frozen=True)
class Origin:
    """What ``dataset.json`` says of where frames come from.

    Attributes:
        worlds: by their names; a job without ``worlds`` has one, whose name is empty.
        runs: versions of the packages that frames were made with, each once, in order.
    """

    worlds: Mapping[str, World] = field(default_factory=dict)
    runs: Sequence[Mapping[str, str]] = field(default_factory=lambda: (versions(),))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        worlds = {name: plain(world) for name, world in self.worlds.items()}
        return {"version": VERSION, "worlds": worlds, "runs": [dict(run) for run in self.runs]}

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """The inverse of :meth:`to_dict`; ArgumentError for anything else."""
        values = mapping("origin", data)
        if values.get("version") != VERSION:
            raise ArgumentError(f"origin: expected version {VERSION}, got {shown(values.get('version'))}")
        worlds = {}
        for name, world in values["worlds"].items():
            worlds[name] = mapping("origin.worlds", world)
        return cls(worlds, tuple(map(_read_versions, values["runs"])))

    def joined(self, other: Self) -> Self:
        """Return this record with the worlds and the versions of another one, which does not differ."""
        worlds = dict(self.worlds)
        for name, world in other.worlds.items():
            known = {key: value for key, value in world.items() if value is not None}
            worlds[name] = {**worlds.get(name, {}), **known}
        runs = list(self.runs)
        for run in other.runs:
            if run not in self.runs:
                runs.append(run)
        return replace(self, worlds=worlds, runs=tuple(runs))


def _read_versions(run: Any) -> dict[str, str]:
    return {text("run", package): text(package, run[package]) for package in run}


def world_difference(there: World, wanted: World) -> str:
    """Return the first thing in which two records of a world differ, and both values; empty for none.

    ``there`` is the record of the dataset, ``wanted`` that of the job.
    """
    before = dict(there)
    after = dict(plain(wanted))
    for key in MAY_DIFFER:
        before.pop(key, None)
        after.pop(key, None)
    for key in _UNKNOWN:
        if there.get(key) is None or wanted.get(key) is None:
            before.pop(key, None)
            after.pop(key, None)
    return next(differences(before, after), "")


def plain(value: Any) -> Any:
    """Return a value as JSON has it: lists for tuples."""
    return json.loads(json.dumps(value, default=list))


def digest(values: Any) -> str:
    """Return a digest of plain values, 16 hexadecimal digits."""
    return hashlib.sha256(json.dumps(plain(values), sort_keys=True).encode()).hexdigest()[:16]


def without_defaults(values: Mapping[str, Any], start: str = "") -> dict[str, Any]:
    """Return plain values without those that are the defaults of their options.

    ``start`` is the dotted key of all ``values``, with a dot at its end.
    """
    kept = {}
    for key, value in values.items():
        name = f"{start}{key}"
        below = without_defaults(value, f"{name}.") if isinstance(value, Mapping) else value
        if below != _default(name):
            kept[key] = below
    return kept


def differences(there: Mapping[str, Any], wanted: Mapping[str, Any], start: str = "") -> Iterator[str]:
    """Yield what two records have with other values, and both values.

    Args:
        there: of the dataset, as plain values.
        wanted: of what is to be made, in the same form.
        start: the dotted key of both, with a dot at its end.
    """
    for key in {**wanted, **there}:
        name = f"{start}{key}"
        before = _value(there, key, name)
        after = _value(wanted, key, name)
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            yield from differences(before, after, f"{name}.")
        elif _are_lists(before, after):
            for index, (old, new) in enumerate(zip(before, after, strict=True)):
                if old != new:
                    indexed = f"{key}[{index}]"
                    yield from differences({indexed: old}, {indexed: new}, start)
        elif before != after:
            yield f"{name} is {shown(before)}, in the job {shown(after)}"


def _are_lists(before: Any, after: Any) -> bool:
    """Return whether two values are lists of as many mappings or lists, to be compared one by one."""
    if not (isinstance(before, list) and isinstance(after, list) and len(before) == len(after)):
        return False
    return all(isinstance(value, Mapping | list) for value in [*before, *after])


def _value(values: Mapping[str, Any], key: str, name: str) -> Any:
    return values[key] if key in values else _default(name)


def _default(name: str) -> Any:
    """Return the value that an option has where it is not given; None for one that has no default."""
    if name in _OTHER_DEFAULTS:
        return _OTHER_DEFAULTS[name]
    parent, _, key = name.rpartition(".")
    cls = _RECORDS.get(parent)
    if parent.startswith("options.truth."):
        cls = _truth_options(parent.removeprefix("options.truth."))
    for option in fields(cls) if cls is not None else ():
        if key in (option.name, key_of(option)):
            return _plain_default(option)
    if name in _RECORDS and name not in ("options.sensor", "options.imu.sensor", "options.vary"):
        return {}
    return None


def _truth_options(name: str) -> type[Any] | None:
    """Return the record of a truth's options; None for a truth that is not known here."""
    head, _, below = name.partition(".")
    if below == "tolerance":
        return Tolerance
    return truths.get(head).options if head in truths.names() and not below else None


def _plain_default(option: Any) -> Any:
    default = option.default
    if default is MISSING and option.default_factory is not MISSING:
        default = option.default_factory()
    if default is MISSING:
        return None
    if is_dataclass(default):
        return {field.name: plain(getattr(default, field.name)) for field in fields(default)}
    return plain(default)


_FOUND = ("files", "blank", "watch")
"""Keys of a frame's line whose values are found while the frame is made."""


def frame_difference(there: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return the first value in which two lines of a frame differ, and both values; empty if there is none.

    ``there`` is the line of the dataset, ``wanted`` that of the job. Files, and values that are found while a
    frame is made, are not compared; nor are values that one of the lines does not have.
    """
    for key in {**wanted, **there}:
        before = there.get(key)
        after = wanted.get(key)
        is_unknown = key == "shows" and None in (before, after)  # version 0.2 did not write it
        if key in _FOUND or is_unknown or _same(before, after):
            continue
        if key == "scene" and _one_scene(str(before), str(after)):
            continue
        if key == "shows":
            return "other motions during its exposure than the job"
        return f"{key} {shown(before)}, in the job {shown(after)}"
    return ""


def _same(before: Any, after: Any) -> bool:
    """Return whether two plain values are the same, numbers but for their last digits."""
    if isinstance(before, float) and isinstance(after, float):
        return abs(before - after) <= _LAST_DIGITS * max(1.0, abs(after))
    if isinstance(before, list) and isinstance(after, list):
        return len(before) == len(after) and all(map(_same, before, after))
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        return before.keys() == after.keys() and all(_same(before[key], after[key]) for key in before)
    return bool(before == after)


def _one_scene(before: str, after: str) -> bool:
    """Return whether two identities of a scene differ only in parts that one of them does not have."""
    return f"{before}/".startswith(f"{after}/") or f"{after}/".startswith(f"{before}/")
