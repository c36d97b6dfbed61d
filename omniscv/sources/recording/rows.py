"""Rows of a recording as values: views as JSON, keys, checksums."""

import contextlib
import json
import secrets
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple, Self

from zlib_ng import zlib_ng

from omniscv import modalities
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError, DamagedRecordingError
from omniscv.geometry import Pose
from omniscv.sources.base import Capture, Request, SceneIdentity, View
from omniscv.sources.codecs import decode, payload_of

DEFAULT_TOLERANCE = 3  # of the object table in recordings that hold none: that of UnrealCV servers

_LONGEST_TEXT, _LONGEST_WORD = 1 << 20, 100  # characters of a text column, and of a mode or encoding
_LONGEST_CAUSE = 150  # characters of an error about a part of a capture


def checksum(values: Iterable[str | int | bytes]) -> int:
    """Return the CRC-32 of values, each as ``LENGTH:BYTES``: texts in UTF-8, numbers in decimals."""
    crc = 0
    for value in values:
        data = value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogatepass")
        crc = zlib_ng.crc32(data, zlib_ng.crc32(b"%d:" % len(data), crc))
    return crc


class Row(NamedTuple):
    """A capture as it is stored, see docs/recording-format.md; anything may be written in a file.

    ``checksum`` is None in version 1, which has none but the payload's. ``state`` is empty before version 4.
    """

    number: int
    key: str
    mode: str
    asked: str
    captured: str
    encoding: str
    provenance: str
    payload_checksum: int
    checksum: int | None
    payload: bytes
    state: str = ""

    @classmethod
    def of(cls, capture: Capture, number: int, recording: str) -> Self:
        """Return the row of a capture in the recording of an id.

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
            wanted = f"expected at most {_LONGEST_TEXT} characters of JSON"
            raise ArgumentError(f"provenance: {wanted}, got {len(provenance)}")
        requested, captured = map(view_to_json, (capture.request.view, capture.view))
        key, crc = keys(capture.request)[0], zlib_ng.crc32(payload)
        texts = key, capture.mode, requested, captured, encoding, provenance
        row = cls(number, *texts, crc, 0, payload, capture.request.state)
        return row._replace(checksum=row.own_checksum(recording))

    def own_checksum(self, recording: str) -> int:
        """Return the checksum of all but the payload, whose own checksum it covers, in a recording."""
        state = (self.state,) if self.state else ()
        return checksum((recording, *self[:8], *state))

    @property
    def mode_name(self) -> str:
        """The name of the modality, which earlier versions may have stored by an alias."""
        with contextlib.suppress(ArgumentError):
            return modalities.get(self.mode).name
        return str(self.mode)

    def check(self, recording: str) -> None:
        """Raise DamagedRecordingError if anything but the payload is not what was recorded."""
        self._check_texts()
        if self.checksum is not None and self.checksum != self.own_checksum(recording):
            wanted = f"expected checksum {self.checksum} of the row"
            got = self.own_checksum(recording)
            raise DamagedRecordingError(f"capture {shown(self.key)}: {wanted}, got {got}")

    def _check_texts(self) -> None:
        words = self.mode, self.encoding, self.state
        for text in (*self[1:7], self.state):
            longest = _LONGEST_WORD if text in words else _LONGEST_TEXT
            if not isinstance(text, str) or len(text) > longest:
                wanted = f"expected texts of at most {longest} characters"
                raise DamagedRecordingError(f"capture {shown(self.key)}: {wanted}, got {shown(text)}")

    def description(self) -> tuple[Request, View, dict[str, Any]]:
        """The request, the captured view and the provenance; DamagedRecordingError for anything else."""
        self._check_texts()
        with self._named():
            request = Request(view_from_json(self.asked), self.mode_name, self.state)
            if self.key not in keys(request):
                raise ArgumentError("expected the key of its view, mode and state, got another")
            return request, view_from_json(self.captured), object_from_json(self.provenance)

    def capture(self) -> Capture:
        """The capture, checked and decoded; DamagedRecordingError if a value is not what was recorded."""
        request, view, provenance = self.description()
        self.check_payload()
        with self._named():
            pixels = decode(self.payload, self.encoding, request.mode, view)
        return Capture(request, view, pixels, provenance, self.payload, self.encoding)

    def check_payload(self) -> None:
        """Raise DamagedRecordingError if the payload is not what was recorded."""
        crc = zlib_ng.crc32(self.payload) if isinstance(self.payload, bytes) else "no bytes"
        with self._named():
            if crc != self.payload_checksum:
                raise ArgumentError(f"expected checksum {shown(self.payload_checksum)}, got {crc}")

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        """Name the capture in errors."""
        try:
            yield
        except (ArgumentError, BadReplyError, DamagedRecordingError) as cause:
            reason = str(cause)[:_LONGEST_CAUSE]
            raise DamagedRecordingError(f"capture {shown(self.key)}: {reason}") from cause

    @property
    def scene(self) -> SceneIdentity:
        """The scene that its provenance names."""
        with contextlib.suppress(DamagedRecordingError):
            return scene_in(object_from_json(self.provenance))
        return SceneIdentity()


class Head(NamedTuple):
    """The one row of ``recording``: what a recording is.

    Attributes:
        id: unique, made with the file, 32 hexadecimal digits.
        token, parent: of the last change, and of the one before it; random, as long.
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

    def sealed(self) -> Self:
        """Return the row with its checksum."""
        return self._replace(checksum=checksum(self[:-1]))

    def check(self) -> None:
        """Raise DamagedRecordingError if it is not as it was written."""
        if self.checksum != checksum(self[:-1]):
            wanted = f"expected checksum {self.checksum} of what the recording is"
            raise DamagedRecordingError(f"{wanted}, got {checksum(self[:-1])}")

    def with_rows(self, added: Iterable[Row], removed: Iterable[int]) -> Self:
        """Return the row after some captures were added, and those with some checksums removed."""
        more, fewer = [row.checksum or 0 for row in added], list(removed)
        total = (self.capture_sum + sum(more) - sum(fewer)) % (1 << 32)
        return self._replace(captures=self.captures + len(more) - len(fewer), capture_sum=total)

    @property
    def identity(self) -> SceneIdentity:
        """The scene that the captures are of."""
        return scene_from_json(self.scene)


def insert(database: sqlite3.Connection, row: Row) -> None:
    """Write a capture; of another state than the still one, into a recording of version 4 only."""
    values = row if row.state else row[:-1]
    columns, marks = ", ".join(Row._fields[: len(values)]), ", ".join("?" * len(values))
    database.execute(f"INSERT INTO capture ({columns}) VALUES ({marks})", values)


def write_head(database: sqlite3.Connection, head: Head) -> None:
    """Write what a recording is, with its checksum."""
    columns = ", ".join(f"{name} = ?" for name in Head._fields)
    database.execute(f"UPDATE recording SET {columns}", head.sealed())


def keys(request: Request) -> list[str]:
    """The keys of a request in a file: the one to write, then those by aliases of its mode."""
    names = (request.mode, *modalities.get(request.mode).aliases)
    width, height, position, rotation, fov_deg = request.view.key()
    state = (request.state,) if request.state else ()
    numbers = width, height, *position, *rotation, fov_deg, *state
    return [json.dumps([name, *numbers], separators=(",", ":")) for name in names]


def view_to_json(view: View) -> str:
    """A view as it is stored."""
    size = {"fov_deg": view.fov_deg, "width": view.width, "height": view.height}
    return json.dumps({**view.pose.to_dict(), **size})


def view_from_json(text: Any) -> View:
    """A view as it is stored, JSON; DamagedRecordingError for anything else."""
    data = object_from_json(text)
    try:
        size = data["width"], data["height"]
        if not all(type(edge) is int for edge in size):
            raise ArgumentError(f"size: expected whole numbers, got {shown(size)}")
        return View(Pose.from_dict(data), data["fov_deg"], *size)
    except (KeyError, TypeError, ValueError) as cause:
        got = f"{shown(text)}: {cause}"
        raise DamagedRecordingError(f"expected a view in a recording, got {got}") from cause


def scene_to_json(identity: SceneIdentity) -> str:
    """A scene's identity as it is stored."""
    return json.dumps(asdict(identity), ensure_ascii=False)


def scene_from_json(text: Any) -> SceneIdentity:
    """A scene's identity as it is stored, JSON; DamagedRecordingError for anything else."""
    data = object_from_json(text)
    if not (
        set(data) <= set(asdict(SceneIdentity())) and all(isinstance(each, str) for each in data.values())
    ):
        raise DamagedRecordingError(f"expected a scene in a recording, got {shown(text)}")
    return SceneIdentity(**data)


def scene_in(provenance: Mapping[str, Any]) -> SceneIdentity:
    """The scene that a provenance names."""
    name = provenance.get("scene", "")
    return SceneIdentity(name if isinstance(name, str) else "")


def scene_in_words(identity: SceneIdentity) -> str:
    """A scene's identity in a few words."""
    parts = {"": identity.name, "level ": identity.level, "content ": identity.content[:12]}
    return ", ".join(f"{what}{shown(part)}" for what, part in parts.items() if part) or "an unknown one"


def the_scene(named: Iterable[SceneIdentity]) -> SceneIdentity:
    """The scene of captures that all name the same; an unknown one where they do not."""
    found = set(named)
    return found.pop() if len(found) == 1 else SceneIdentity()


def object_from_json(text: Any) -> dict[str, Any]:
    """A JSON object; DamagedRecordingError for anything else."""
    try:
        data = json.loads(text)
    except (TypeError, ValueError, RecursionError) as cause:
        raise DamagedRecordingError(f"expected JSON in a recording, got {shown(text)}") from cause
    if not isinstance(data, dict):
        raise DamagedRecordingError(f"expected a JSON object in a recording, got {shown(text)}")
    return data
