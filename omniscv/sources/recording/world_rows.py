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
    coded = (v if isinstance(v, bytes) else str(v).encode("utf-8", "surrogatepass") for v in values)
    return zlib_ng.crc32(b"".join([b"%d:%b" % (len(part), part) for part in coded]))


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
        boxes = SceneGeometry(self.boxes).to_dict()["boxes"]
        values = {"instant": self.instant and self.instant.to_dict(), "boxes": boxes}
        values |= {} if self.asked is None else {"asked": self.asked}
        return values | ({"poses": Instant(self.poses).to_dict()["poses"]} if self.poses else {})

    @classmethod
    def from_dict(cls, name: str, data: object) -> Self:
        """Return the state of a name that :meth:`to_dict` described; ArgumentError for anything else."""
        state = read(cls, data, name)
        if state.instant is not None and state.instant.state != name:
            raise ArgumentError(f"{name}: expected its instant, got that of {state.instant.state!r}")
        return state


ObjectRow = tuple[str, int, int, int, int | None]
"""A row of ``object``: name, red, green, blue, and the id, which is None where masks hold colours."""


def object_checksum(rows: Iterable[ObjectRow]) -> int:
    """Return the checksum of rows; an id that is not known counts as an empty text."""
    return checksum("" if value is None else value for row in rows for value in row)


def object_table(rows: list[ObjectRow], tolerance: int) -> ObjectTable:
    """Return the object table of rows; DamagedRecordingError for values out of bounds."""
    ids = {row[0]: row[4] for row in rows if row[4] is not None}
    limits = [(tolerance, 255), *((value, 255) for row in rows for value in row[1:4])]
    limits += [(instance, MOST_OBJECTS) for instance in ids.values()]
    for value, most in limits:
        if type(value) is not int or not 0 <= value <= most:
            expected = f"expected colours, ids and a tolerance of 0 to {most}"
            raise DamagedRecordingError(f"{expected}, got {shown(value)}")
    if len(rows) > MOST_OBJECTS:
        raise DamagedRecordingError(f"expected at most {MOST_OBJECTS} objects, got more")
    return ObjectTable({row[0]: row[1:4] for row in rows}, tolerance, ids)


def object_rows(table: ObjectTable) -> list[ObjectRow]:
    """Return the rows of an object table; RecordingNotWritableError if readers would refuse them."""
    rows = [(name, *table.colors[name], table.ids.get(name)) for name in table.names()]
    with readable():
        "".join(table.names()).encode()
        object_table(rows, table.tolerance)
    return rows


def table_conflict(before: ObjectTable, after: ObjectTable) -> str:
    """Return why masks would get other names: a name has two colours, or a colour two names; empty if not."""
    if before.colors and before.tolerance != after.tolerance:
        return f"the tolerance is {after.tolerance} and was {before.tolerance}"
    column = "ids" if after.ids else "colors"
    known: dict[str, Any] = getattr(before, column)
    names = {value: name for name, value in known.items()}
    for name, value in getattr(after, column).items():
        if known.get(name, value) != value:
            return f"{shown(name)} is {value} and was {known[name]}"
        if names.get(value, name) != name:
            return f"{shown(name)} is {value}, which was {shown(names[value])}"
    return ""


def checked_json(data: Mapping[str, Any], read: Callable[[Any], Any], *prefix: str) -> tuple[str, int]:
    """Return content and checksum of a row of JSON; RecordingNotWritableError if ``read`` would refuse it."""
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
        got = f"{cause.object[cause.start]!a}; nothing of it is written"
        raise RecordingNotWritableError(f"expected texts of Unicode, got {got}") from cause


def json_of_row(name: str, read: Callable[[Any], T], content: Any, crc: Any, *prefix: str) -> T:
    """Return what ``read`` makes of a row of :func:`checked_json`; DamagedRecordingError for other values."""
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
    parts = {"": identity.name, "level ": identity.level, "content ": identity.content[:12]}
    return ", ".join(f"{what}{shown(part)}" for what, part in parts.items() if part) or "an unknown one"


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
