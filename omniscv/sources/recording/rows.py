"""Rows of a recording as values, and their checksums; docs/recording-format.md describes them.

A file may come from anybody: values are checked when they are read.
"""

import contextlib
import json
import re
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple, Self, TypeVar

from zlib_ng import zlib_ng

from omniscv import modalities
from omniscv.arguments import shown, text
from omniscv.errors import ArgumentError, BadReplyError, DamagedRecordingError, RecordingNotWritableError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import ObjectBox, SceneGeometry
from omniscv.records import checked, named, nested, optional, read, record
from omniscv.sources.base import Capture, Lens, ObjectTable, Request, SceneIdentity, View
from omniscv.sources.codecs import decode, payload_of

T = TypeVar("T")

DEFAULT_TOLERANCE = 3  # of a new recording's object table: that of UnrealCV servers
MOST_OBJECTS = 0xFFFF

_LONGEST_TEXT = 1 << 20  # characters of a text column
_LONGEST = {
    **dict.fromkeys(("key", "asked", "captured", "provenance"), _LONGEST_TEXT),
    **dict.fromkeys(("mode", "encoding", "state"), 100),
}
_LONGEST_JSON = 1 << 25  # characters of boxes and poses: enough for MOST_OBJECTS
_LONGEST_CAUSE = 150  # characters of an error about a part of a capture
_STOPS = re.compile(r'\["lit@(-?\d+(?:\.\d+)?(?:e-\d+)?)"', re.ASCII)


def checksum(values: Iterable[str | int | bytes]) -> int:
    """Return the CRC-32 of values, each as ``LENGTH:BYTES``: texts in UTF-8, numbers in decimals."""
    texts = (
        value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogatepass") for value in values
    )
    return zlib_ng.crc32(b"".join([b"%d:%b" % (len(text), text) for text in texts]))


class Row(NamedTuple):
    """A row of ``capture``; ``number`` and ``checksum`` are 0 before the capture is in a recording."""

    number: int
    key: str
    mode: str
    asked: str
    captured: str
    encoding: str
    provenance: str
    payload_checksum: int
    checksum: int
    payload: bytes
    state: str

    @classmethod
    def of(cls, capture: Capture) -> Self:
        """Return the row of a capture.

        Raises:
            ArgumentError: provenance that is no JSON, or too long.
            BadReplyError: pixels that do not fit the modality or the view.
        """
        payload, encoding = payload_of(capture)
        try:
            provenance = json.dumps(dict(capture.provenance), allow_nan=False)
        except (TypeError, ValueError, RecursionError) as cause:
            got = f"{shown(capture.provenance)}: {cause}"
            raise ArgumentError(f"provenance: expected plain JSON values, got {got}") from cause
        if len(provenance) > _LONGEST_TEXT:
            expected = f"expected at most {_LONGEST_TEXT} characters of JSON"
            raise ArgumentError(f"provenance: {expected}, got {len(provenance)}")
        request = capture.request
        views = view_to_json(request.view), view_to_json(capture.view)
        texts = key_of(request), capture.mode, *views, encoding, provenance
        return cls(0, *texts, zlib_ng.crc32(payload), 0, payload, request.state)

    def in_recording(self, number: int, recording: str) -> Self:
        """Return the row with its number in the recording of an id, and its checksum there."""
        row = self._replace(number=number)
        return row._replace(checksum=row.expected_checksum(recording))

    def expected_checksum(self, recording: str) -> int:
        """Return the checksum in the recording of an id: of all columns but the payload."""
        state = (self.state,) if self.state else ()
        return checksum((recording, *self[:8], *state))

    def check(self, recording: str) -> None:
        """Raise DamagedRecordingError if anything but the payload is not as recorded."""
        self._check_texts()
        if self.checksum != (crc := self.expected_checksum(recording)):
            reason = f"expected checksum {self.checksum} of the row, got {crc}"
            raise DamagedRecordingError(f"capture {shown(self.key)}: {reason}")

    def check_payload(self) -> None:
        """Raise DamagedRecordingError if the payload is not as recorded."""
        crc = zlib_ng.crc32(self.payload) if isinstance(self.payload, bytes) else "no bytes"
        with self._named():
            if crc != self.payload_checksum:
                raise ArgumentError(f"expected checksum {shown(self.payload_checksum)}, got {crc}")

    @property
    def stops(self) -> float | None:
        """The stops of its exposure, as its key says; None for the source's own."""
        match = _STOPS.match(self.key)
        return float(match[1]) if match else None

    def description(self) -> tuple[Request, View, dict[str, Any]]:
        """Return request, captured view and provenance; DamagedRecordingError for other values."""
        self._check_texts()
        with self._named():
            request = Request(view_from_json(self.asked), self.mode, self.state, stops=self.stops)
            if self.key != key_of(request):
                raise ArgumentError("expected the key of its view, mode and state, got another")
            return request, view_from_json(self.captured), object_from_json(self.provenance)

    def capture(self) -> Capture:
        """Return the capture, checked and decoded; DamagedRecordingError if it is not as recorded."""
        request, view, provenance = self.description()
        self.check_payload()
        with self._named():
            pixels = decode(self.payload, self.encoding, request.mode, view)
        return Capture(request, view, pixels, provenance, self.payload, self.encoding)

    def _check_texts(self) -> None:
        for name, most in _LONGEST.items():
            value = getattr(self, name)
            if not isinstance(value, str) or len(value) > most:
                reason = f"expected a {name} of at most {most} characters, got {shown(value)}"
                raise DamagedRecordingError(f"capture {shown(self.key)}: {reason}")

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        """Name the capture in errors."""
        try:
            yield
        except (ArgumentError, BadReplyError, DamagedRecordingError) as cause:
            reason = str(cause)[:_LONGEST_CAUSE]
            raise DamagedRecordingError(f"capture {shown(self.key)}: {reason}") from cause


class Head(NamedTuple):
    """The row of ``recording``.

    Attributes:
        id: 32 random hexadecimal digits, made with the file.
        token, parent: of the last change and of the one before it; random, as long.
        scene: a :class:`SceneIdentity`, JSON.
        tolerance: of the object table.
        captures, capture_sum: their number, and the sum of their checksums modulo 2^32.
        object_checksum: of all rows of ``object``, in the order of names.
        checksum: of the columns before.
    """

    id: str
    token: str
    parent: str
    scene: str
    tolerance: int
    captures: int
    capture_sum: int
    object_checksum: int
    checksum: int

    @classmethod
    def new(cls) -> Self:
        """Return the row of a new recording."""
        token, scene = secrets.token_hex(16), scene_to_json(SceneIdentity())
        head = cls(secrets.token_hex(16), token, token, scene, DEFAULT_TOLERANCE, 0, 0, checksum(()), 0)
        return head.sealed()

    def changed(self) -> Self:
        """Return the row with a new token."""
        return self._replace(token=secrets.token_hex(16), parent=self.token)

    def sealed(self) -> Self:
        """Return the row with its checksum."""
        return self._replace(checksum=checksum(self[:-1]))

    def check(self) -> None:
        """Raise DamagedRecordingError if it is not as written."""
        if self.checksum != (crc := checksum(self[:-1])):
            raise DamagedRecordingError(f"expected checksum {self.checksum} of its head, got {crc}")

    def with_rows(self, added: Iterable[Row], removed: Iterable[int] = ()) -> Self:
        """Return the row after some captures were added, and those with some checksums removed."""
        more, fewer = [row.checksum for row in added], list(removed)
        total = (self.capture_sum + sum(more) - sum(fewer)) % (1 << 32)
        return self._replace(captures=self.captures + len(more) - len(fewer), capture_sum=total)


@record(eq=False)
class WorldState:
    """What is known of a state of the world: a row of ``state``.

    Attributes:
        instant: what was set, or read back; None where nothing is known.
        boxes: by name, of the objects whose boxes are not those of the still world.
        asked: the state that was to be set, where the world was found in this one; else None.
        poses: of objects that moved by themselves: those that the instant does not have.
    """

    instant: Instant | None = checked(optional(nested(Instant)), default=None)
    boxes: Mapping[str, ObjectBox] = checked(named(nested(ObjectBox)), default_factory=dict)
    asked: str | None = checked(
        optional(lambda name, value: "" if value == "" else text(name, value)), default=None
    )
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


def labelled_modes() -> list[str]:
    """Return the modes whose captures need the object table."""
    return [row.name for row in modalities.layers() if row.derives]


def table_conflict(before: ObjectTable, after: ObjectTable) -> str:
    """Return why captured masks would get other names: a name has two colours, or a colour two names.

    Empty where the tables agree.
    """
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


def checked_json(data: Mapping[str, Any], *prefix: str) -> tuple[str, int]:
    """Return the columns ``content`` and ``checksum`` of a row of JSON; the prefix is under the checksum too.

    Raises:
        RecordingNotWritableError: more boxes and poses than a recording can hold.
    """
    content = json.dumps(data, ensure_ascii=False, allow_nan=False)
    if len(content) > _LONGEST_JSON:
        expected = f"expected boxes and poses of at most {_LONGEST_JSON} characters of JSON"
        raise RecordingNotWritableError(f"{expected}, got {len(content)}")
    return content, checksum((*prefix, content))


def json_of_row(name: str, read: Callable[[Any], T], content: Any, crc: Any, *prefix: str) -> T:
    """Return what ``read`` makes of a row of :func:`checked_json`; DamagedRecordingError for other values."""
    is_text = isinstance(content, str) and len(content) <= _LONGEST_JSON
    if not is_text or crc != checksum((*prefix, content)):
        raise DamagedRecordingError(f"expected checksum {shown(crc)} of {name}, got another")
    try:
        return read(object_from_json(content))
    except ArgumentError as cause:
        raise DamagedRecordingError(f"{name}: {cause.message}") from cause


def sizes_of(rows: Iterable[Row]) -> set[tuple[int, int]]:
    """Return widths and heights of requested views, by the keys; DamagedRecordingError for other keys."""
    texts = {tuple(row.key.split(",", 3)[1:3]) for row in rows}
    try:
        return {(int(width), int(height)) for width, height in texts}
    except ValueError as cause:
        raise DamagedRecordingError(f"expected keys of captures, got others: {cause}") from cause


def key_of(request: Request) -> str:
    """Return the key of a request: equal requests have equal keys."""
    width, height, position, rotation, fov_deg, lens = request.view.key()
    state = (request.state,) if request.state else ()
    mode = request.mode if request.stops is None else f"{request.mode}@{request.stops:.15g}"
    numbers = width, height, *position, *rotation, fov_deg, *lens
    return json.dumps([mode, *numbers, *state], separators=(",", ":"))


def view_to_json(view: View) -> str:
    """Return a view as it is stored."""
    size = {"fov_deg": view.fov_deg, "width": view.width, "height": view.height}
    lens = {} if view.lens is None else {"lens": view.lens._asdict()}
    return json.dumps({**view.pose.to_dict(), **size, **lens})


def view_from_json(text: Any) -> View:
    """Return a view as it is stored; DamagedRecordingError for anything else."""
    try:
        return view_from_dict(object_from_json(text))
    except ArgumentError as cause:
        raise DamagedRecordingError(f"expected a view, got {shown(text)}: {cause}") from cause


def view_from_dict(data: dict[str, Any]) -> View:
    """Return the view that :func:`view_to_json` describes; ArgumentError for anything else."""
    try:
        fov_deg, size = data["fov_deg"], (data["width"], data["height"])
        if not all(type(edge) is int for edge in size):
            raise ArgumentError(f"size: expected whole numbers, got {shown(size)}")
        lens = data.get("lens")
        return View(Pose.from_dict(data), fov_deg, *size, None if lens is None else Lens(**lens))
    except KeyError as cause:
        raise ArgumentError(f"missing key {cause}") from cause
    except TypeError as cause:
        raise ArgumentError(f"expected numbers of a view, got {shown(data)}: {cause}") from cause


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
