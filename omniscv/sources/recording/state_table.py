"""The states of the world that a recording holds captures of: a row of JSON each, from version 4 on."""

import json
import sqlite3
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from omniscv.arguments import Reader, fields, shown, text, within
from omniscv.errors import ArgumentError, DamagedRecordingError, RecordingNotWritableError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import ObjectBox, SceneGeometry
from omniscv.sources.recording import geometry_table, schema
from omniscv.sources.recording.rows import checksum, object_from_json

Query = Callable[..., list[Any]]

_LONGEST = 1 << 25  # characters: of as many boxes as a recording can have objects
_MOST = 1_000_000  # states


@dataclass(frozen=True, eq=False)
class HeldState:
    """What is known of a state of the world.

    Attributes:
        instant: what was set, or read back; None where nothing is known.
        boxes: by name, of the objects whose boxes are not those of the still world.
        asked: the state that was to be set, where the world was found in this one; else None.
        poses: of objects that moved by themselves: those that the instant has not.
    """

    instant: Instant | None = None
    boxes: Mapping[str, ObjectBox] = field(default_factory=lambda: MappingProxyType({}))
    asked: str | None = None
    poses: Mapping[str, Pose] = field(default_factory=lambda: MappingProxyType({}))

    def object_poses(self) -> dict[str, Pose]:
        """Return the poses of all objects that are known."""
        return {**self.poses, **(self.instant or Instant()).poses}

    def geometry(self, still: SceneGeometry) -> SceneGeometry:
        """Return the shapes in this state, given those of the still world."""
        return SceneGeometry(MappingProxyType({**still.boxes, **self.boxes}), still.room)


def read(query: Query, recording: str, only: str | None = None) -> dict[str, HeldState]:
    """Return the states in the recording of an id, by name, or only that of a name; none before version 4.

    Raises:
        DamagedRecordingError: they are not as they were written.
    """
    if not query("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'state'"):
        return {}
    where = "" if only is None else "WHERE name = ?"
    named = () if only is None else (only,)
    rows = query(f"SELECT name, content, checksum FROM state {where} ORDER BY name LIMIT {_MOST}", *named)
    return {name: _read(recording, name, content, crc) for name, content, crc in rows}


def write(database: sqlite3.Connection, recording: str, name: str, state: HeldState) -> None:
    """Write a state into the recording of an id, in place of what was known of it, within a transaction.

    Raises:
        RecordingNotWritableError: too many boxes.
    """
    content = json.dumps(to_dict(state), ensure_ascii=False, allow_nan=False)
    if len(content) > _LONGEST:
        wanted = f"expected boxes and poses of at most {_LONGEST} characters of JSON"
        raise RecordingNotWritableError(f"{wanted}, got {len(content)}")
    if schema.present_version(database) == schema.WITHOUT_GEOMETRY:
        geometry_table.write(database, recording, SceneGeometry())
    if schema.present_version(database) == schema.WITHOUT_STATES:
        schema.add_states(database)
    crc = checksum((recording, name, content))
    database.execute("INSERT OR REPLACE INTO state VALUES (?, ?, ?)", (name, content, crc))


def from_dict(name: str, data: object) -> HeldState:
    """Return what JSON has of the state of a name; ArgumentError for anything else."""
    found = fields(name, data, _STATE, needed=("instant", "boxes"))
    instant = found["instant"]
    if instant is not None and instant.state != name:
        raise ArgumentError(f"{name}: expected the instant of this state, got that of {instant.state!r}")
    return HeldState(instant, found["boxes"], found.get("asked"), found.get("poses", {}))


def to_dict(state: HeldState) -> dict[str, Any]:
    """Return plain values for JSON: the inverse of :func:`from_dict`."""
    boxes = SceneGeometry(state.boxes).to_dict()["boxes"]
    found = {"instant": state.instant and state.instant.to_dict(), "boxes": boxes}
    found |= {} if state.asked is None else {"asked": state.asked}
    return found | ({"poses": Instant(state.poses).to_dict()["poses"]} if state.poses else {})


def _read(recording: str, name: Any, content: Any, crc: Any) -> HeldState:
    whole = isinstance(name, str) and isinstance(content, str) and len(content) <= _LONGEST
    if not whole or crc != checksum((recording, name, content)):
        raise DamagedRecordingError(f"expected checksum {shown(crc)} of state {shown(name)}, got another")
    try:
        return from_dict(name, object_from_json(content))
    except ArgumentError as cause:
        raise DamagedRecordingError(f"state {shown(name)}: {cause}") from cause


def _instant(name: str, value: object) -> Instant | None:
    with within(name):
        return None if value is None else Instant.from_dict(value)


def _boxes(name: str, value: object) -> Mapping[str, ObjectBox]:
    with within(name):
        return SceneGeometry.from_dict({"boxes": value, "room": None}).boxes


def _poses(name: str, value: object) -> Mapping[str, Pose]:
    with within(name):
        return Instant.from_dict({**Instant().to_dict(), "poses": value}).poses


def _asked(name: str, value: object) -> str:
    return text(name, value) if value != "" else ""


_STATE: Mapping[str, Reader] = {"instant": _instant, "boxes": _boxes, "asked": _asked, "poses": _poses}
