"""Rows of a recording as values, and their checksums; docs/recording-format.md describes them.

A file may come from anybody: values are checked when they are read.
"""

import contextlib
import json
import re
import secrets
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, Self, TypeVar

from zlib_ng import zlib_ng

from omniscv import modalities
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError, DamagedRecordingError
from omniscv.geometry import Pose
from omniscv.sources.base import Capture, Lens, Request, SceneIdentity, View
from omniscv.sources.codecs import decode, payload_of
from omniscv.sources.recording.world_rows import DEFAULT_TOLERANCE, checksum, object_from_json, scene_to_json

T = TypeVar("T")

_LONGEST_TEXT = 1 << 20  # characters of a text column
_LONGEST = {
    **dict.fromkeys(("key", "asked", "captured", "provenance"), _LONGEST_TEXT),
    **dict.fromkeys(("mode", "encoding", "state"), 100),
}
_LONGEST_CAUSE = 150  # characters of an error about a part of a capture
_STOPS = re.compile(r'\["lit@(-?\d+(?:\.\d+)?(?:e-\d+)?)"', re.ASCII)


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
        """Return a capture's row; ArgumentError if provenance is no JSON, BadReplyError for wrong pixels."""
        payload, encoding = payload_of(capture)
        request = capture.request
        try:
            provenance = json.dumps(dict(capture.provenance), allow_nan=False)
            asked = view_to_json(request.view)
            captured = view_to_json(capture.view)
        except (TypeError, ValueError, RecursionError) as cause:
            actual = f"{shown(capture.provenance)}: {cause}"
            raise ArgumentError(f"provenance: expected plain JSON values, got {actual}") from cause
        return cls(
            number=0,
            key=key_of(request),
            mode=capture.mode,
            asked=asked,
            captured=captured,
            encoding=encoding,
            provenance=provenance,
            payload_checksum=zlib_ng.crc32(payload),
            checksum=0,
            payload=payload,
            state=request.state,
        )

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
    """The row of ``recording``."""

    id: str  # 32 random hexadecimal digits, made with the file
    token: str  # of the last change; random, as long
    parent: str  # the token before it
    scene: str  # a `SceneIdentity`, JSON
    tolerance: int  # of the object table
    captures: int
    capture_sum: int  # the sum of their checksums modulo 2^32
    object_checksum: int  # of all rows of `object`, in the order of names
    checksum: int  # of the columns before

    @classmethod
    def new(cls) -> Self:
        """Return the row of a new recording."""
        token = secrets.token_hex(16)
        scene = scene_to_json(SceneIdentity())
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
        more = [row.checksum for row in added]
        fewer = list(removed)
        total = (self.capture_sum + sum(more) - sum(fewer)) % (1 << 32)
        return self._replace(captures=self.captures + len(more) - len(fewer), capture_sum=total)


def labelled_modes() -> list[str]:
    """Return the modes whose captures need the object table."""
    return [row.name for row in modalities.layers() if row.derives]


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
    numbers = (width, height, *position, *rotation, fov_deg, *lens)
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
        fov_deg = data["fov_deg"]
        size = (data["width"], data["height"])
        if not all(type(edge) is int for edge in size):
            raise ArgumentError(f"size: expected whole numbers, got {shown(size)}")
        lens = data.get("lens")
        return View(Pose.from_dict(data), fov_deg, *size, None if lens is None else Lens(**lens))
    except KeyError as cause:
        raise ArgumentError(f"missing key {cause}") from cause
    except TypeError as cause:
        raise ArgumentError(f"expected numbers of a view, got {shown(data)}: {cause}") from cause
