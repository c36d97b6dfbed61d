"""What a recording holds of the world beside its captures, as values: objects, shapes, states, the scene.

A file may come from anybody: values are checked when they are read. What is written is read first.
"""

import contextlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any, Self, TypeVar

from zlib_ng import zlib_ng

from omniscv.arguments import shown, text
from omniscv.errors import ArgumentError, DamagedRecordingError, RecordingNotWritableError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import ObjectBox, SceneGeometry
from omniscv.records import checked, named, nested, optional, read, record
from omniscv.sources.base import Capture, ObjectTable, SceneIdentity

T = TypeVar("T")

DEFAULT_TOLERANCE = 3  # of a new recording's object table: that of UnrealCV servers
MOST_OBJECTS = 0xFFFF
_LONGEST_JSON = 1 << 25  # characters of boxes and poses: enough for MOST_OBJECTS


def checksum(values: Iterable[str | int | bytes]) -> int:
    """Return the CRC-32 of values, each as ``LENGTH:BYTES``: texts in UTF-8, numbers in decimals."""
    parts = []
    for value in values:
        coded = value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogatepass")
        parts.append(b"%d:%b" % (len(coded), coded))
    return zlib_ng.crc32(b"".join(parts))


@record(eq=False)
class WorldState:
    """What is known of a state of the world: a row of ``state``."""

    instant: Instant | None = checked(optional(nested(Instant)), default=None)  # as set, or read back
    # Of the objects whose boxes are not those of the still world.
    boxes: Mapping[str, ObjectBox] = checked(named(nested(ObjectBox)), default_factory=dict)
    # The state that was to be set, where the world was found in this one.
    asked: str | None = checked(
        optional(lambda name, value: "" if value == "" else text(name, value)), default=None
    )
    # Of objects that moved by themselves, which the instant does not have.
    poses: Mapping[str, Pose] = checked(named(nested(Pose)), default_factory=dict)

    def object_poses(self) -> dict[str, Pose]:
        """Return the poses of all objects that are known."""
        return {**self.poses, **(self.instant.poses if self.instant else {})}

    def geometry(self, still: SceneGeometry) -> SceneGeometry:
        """Return the shapes in this state, given those of the still world."""
        return SceneGeometry({**still.boxes, **self.boxes}, still.room)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        instant = None if self.instant is None else self.instant.to_dict()
        values = {"instant": instant, "boxes": SceneGeometry(self.boxes).to_dict()["boxes"]}
        if self.asked is not None:
            values["asked"] = self.asked
        if self.poses:
            values["poses"] = Instant(self.poses).to_dict()["poses"]
        return values

    @classmethod
    def from_dict(cls, name: str, data: object) -> Self:
        """Return the state ``name`` that :meth:`to_dict` described by ``data``; ArgumentError otherwise."""
        state = read(cls, data, name)
        if state.instant is not None and state.instant.state != name:
            raise ArgumentError(f"{name}: expected its instant, got that of {state.instant.state!r}")
        return state


ObjectRow = tuple[str, int, int, int, int | None]
"""A row of ``object``: name, red, green, blue, and the id, which is None where masks hold colours."""


def object_checksum(rows: Iterable[ObjectRow]) -> int:
    """Return the checksum of rows; an id that is not known counts as an empty text."""
    values: list[str | int] = []
    for row in rows:
        for value in row:
            values.append("" if value is None else value)
    return checksum(values)


def object_table(rows: list[ObjectRow], tolerance: int) -> ObjectTable:
    """Return the object table of ``rows``; DamagedRecordingError for values out of bounds.

    ``tolerance`` is how far a channel of a mask may be off its object's colour.
    """
    _check_bound(tolerance, 255)
    for row in rows:
        for level in row[1:4]:
            _check_bound(level, 255)
    colors = {}
    ids = {}
    for name, red, green, blue, instance in rows:
        colors[name] = (red, green, blue)
        if instance is not None:
            ids[name] = instance
    for instance in ids.values():
        _check_bound(instance, MOST_OBJECTS)
    if len(rows) > MOST_OBJECTS:
        raise DamagedRecordingError(f"expected at most {MOST_OBJECTS} objects, got more")
    return ObjectTable(colors, tolerance, ids)


def _check_bound(value: object, most: int) -> None:
    if type(value) is not int or not 0 <= value <= most:
        expected = f"expected colours, ids and a tolerance of 0 to {most}"
        raise DamagedRecordingError(f"{expected}, got {shown(value)}")


def object_rows(table: ObjectTable) -> list[ObjectRow]:
    """Return the rows of an object table; RecordingNotWritableError if readers would refuse them."""
    rows = [(name, *table.colors[name], table.ids.get(name)) for name in table.names()]
    with readable():
        "".join(table.names()).encode()
        object_table(rows, table.tolerance)
    return rows


def table_conflict(before: ObjectTable, after: ObjectTable) -> str:
    """Return why masks would get other names by a table ``after`` than by that ``before``; empty if not.

    That is if a name has two colours, or a colour two names.
    """
    if before.colors and before.tolerance != after.tolerance:
        return f"the tolerance is {after.tolerance} and was {before.tolerance}"
    known: Mapping[str, Any] = before.ids if after.ids else before.colors
    new: Mapping[str, Any] = after.ids if after.ids else after.colors
    names = {known[name]: name for name in known}
    for name, value in new.items():
        if known.get(name, value) != value:
            return f"{shown(name)} is {value} and was {known[name]}"
        if names.get(value, name) != name:
            return f"{shown(name)} is {value}, which was {shown(names[value])}"
    return ""


def checked_json(data: Mapping[str, Any], read: Callable[[Any], Any], *prefix: str) -> tuple[str, int]:
    """Return content and checksum of a row of JSON.

    Args:
        data: the content, as plain values.
        read: what readers make of it.
        prefix: what the checksum has before it, such as the recording's id.

    Raises:
        RecordingNotWritableError: ``read`` refuses it.
    """
    content = json.dumps(data, ensure_ascii=False, allow_nan=False)
    crc = checksum((*prefix, content))
    with readable():
        "".join((*prefix, content)).encode()
        json_of_row("boxes and poses", read, content, crc, *prefix)
    return content, crc


@contextlib.contextmanager
def readable() -> Iterator[None]:
    """Refuse to write what readers, who know the limits, would refuse: it is read within."""
    try:
        yield
    except DamagedRecordingError as cause:
        raise RecordingNotWritableError(f"{cause.reason}; nothing of it is written") from cause
    except UnicodeEncodeError as cause:
        actual = f"{cause.object[cause.start]!a}; nothing of it is written"
        raise RecordingNotWritableError(f"expected texts of Unicode, got {actual}") from cause


def json_of_row(name: str, read: Callable[[Any], T], content: Any, crc: Any, *prefix: str) -> T:
    """Return what is read of a row of :func:`checked_json`.

    Args:
        name: of the row, for messages.
        read: what makes a value of the plain ones.
        content: the row's text.
        crc: its checksum.
        prefix: as it was written.

    Raises:
        DamagedRecordingError: the row has other values.
    """
    if isinstance(content, str) and len(content) > _LONGEST_JSON:
        expected = f"expected {name} of at most {_LONGEST_JSON} characters"
        raise DamagedRecordingError(f"{expected}, got {len(content)}")
    if not isinstance(content, str) or crc != checksum((*prefix, content)):
        raise DamagedRecordingError(f"expected checksum {shown(crc)} of {name}, got another")
    try:
        return read(object_from_json(content))
    except ArgumentError as cause:
        raise DamagedRecordingError(f"{name}: {cause.message}") from cause


def scene_to_json(identity: SceneIdentity) -> str:
    """Return a scene's identity as it is stored."""
    return json.dumps(asdict(identity), ensure_ascii=False)


def scene_from_json(text: Any) -> SceneIdentity:
    """Return a scene's identity as it is stored; DamagedRecordingError for anything else."""
    try:
        return read(SceneIdentity, object_from_json(text), "scene")
    except ArgumentError as cause:
        raise DamagedRecordingError(cause.message) from cause


def scene_in_words(identity: SceneIdentity) -> str:
    """Return a scene's identity in a few words."""
    parts = []
    if identity.name:
        parts.append(shown(identity.name))
    if identity.level:
        parts.append(f"level {shown(identity.level)}")
    if identity.content:
        parts.append(f"content {shown(identity.content[:12])}")
    return ", ".join(parts) or "an unknown one"


def scene_of(capture: Capture) -> set[str]:
    """Return the name of the scene in a capture's provenance; an empty set where it names none."""
    name = capture.provenance.get("scene")
    return {name} if isinstance(name, str) and name else set()


def listed_scenes(names: Iterable[str]) -> str:
    """Return the names of several scenes in a few words."""
    return " and ".join(map(shown, sorted(names)[:3]))


def object_from_json(text: Any) -> dict[str, Any]:
    """Return a JSON object; DamagedRecordingError for anything else."""
    try:
        data = json.loads(text)
    except (TypeError, ValueError, RecursionError) as cause:
        raise DamagedRecordingError(f"expected JSON, got {shown(text)}") from cause
    if not isinstance(data, dict):
        raise DamagedRecordingError(f"expected a JSON object, got {shown(text)}")
    return data
