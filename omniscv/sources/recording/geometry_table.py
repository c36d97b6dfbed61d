"""What a recording knows of shapes: one row of JSON, of version 3 of the schema."""

import json
import sqlite3
from collections.abc import Callable
from typing import Any

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, DamagedRecordingError, RecordingNotWritableError
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.recording import schema
from omniscv.sources.recording.rows import checksum, object_from_json

Query = Callable[..., list[Any]]

_LONGEST = 1 << 25  # characters: of as many boxes as a recording can have objects


def read(query: Query, recording: str) -> SceneGeometry:
    """Return the shapes in the recording of an id; empty in versions without.

    Raises:
        DamagedRecordingError: they are not as they were written.
    """
    if not query("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'geometry'"):
        return SceneGeometry()
    rows = query("SELECT content, checksum FROM geometry LIMIT 2")
    if len(rows) != 1:
        raise DamagedRecordingError(f"expected one row in geometry, got {len(rows)}")
    content, crc = rows[0]
    if not isinstance(content, str) or len(content) > _LONGEST or crc != checksum((recording, content)):
        raise DamagedRecordingError(f"expected checksum {shown(crc)} of the geometry, got another")
    try:
        return SceneGeometry.from_dict(object_from_json(content))
    except ArgumentError as cause:
        raise DamagedRecordingError(f"geometry: {cause}") from cause


def write(database: sqlite3.Connection, recording: str, geometry: SceneGeometry) -> None:
    """Write shapes into the recording of an id, in place of those it had, within a transaction.

    Raises:
        RecordingNotWritableError: too many of them.
    """
    content = json.dumps(geometry.to_dict(), ensure_ascii=False, allow_nan=False)
    if len(content) > _LONGEST:
        wanted = f"expected boxes of at most {_LONGEST} characters of JSON"
        raise RecordingNotWritableError(f"{wanted}, got {len(content)}")
    if schema.present_version(database) == schema.WITHOUT_GEOMETRY:
        schema.add_geometry(database)
    database.execute("DELETE FROM geometry")
    database.execute("INSERT INTO geometry VALUES (?, ?)", (content, checksum((recording, content))))
