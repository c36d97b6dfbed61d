"""Recordings of one scene become one: each capture as it was recorded, byte for byte."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from omniscv import storage
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, RecordingError, RecordingNotWritableError
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import ObjectTable, Request, View
from omniscv.sources.recording import object_tables
from omniscv.sources.recording.adding import opened_whole
from omniscv.sources.recording.recorded_views import in_words
from omniscv.sources.recording.rows import Row, object_from_json, scene_in_words
from omniscv.sources.recording.store import Store

Progress = Callable[[int, int], None]
"""``progress(done, total)``."""


def merge(out: Path | str, files: Sequence[Path | str], progress: Progress | None = None) -> int:
    """Join recordings into one, and return the number of captures that were added.

    All or nothing: the recording that is there stays as it was, or a new one appears, complete. Captures that
    it holds already are left out, so that a merge may be repeated. What is known of shapes and of states of
    the world is taken of the first recording that has it, as one recorder would.

    Args:
        out: path or URL of the recording that gets the captures; new, or one to add to.
        files: paths or URLs of the recordings, in the order in which their captures are added.
        progress: called with (recordings done, recordings in all).

    Raises:
        ArgumentError: no recordings, or ``out`` among them.
        DamagedRecordingError: a capture is not as it was recorded.
        RecordingError: recordings of different scenes, dialects or mask colours, or with different captures
            of one request; or one cannot be read or written.
    """
    if not files:
        raise ArgumentError("files: expected recordings to merge, got none")
    if str(out) in map(str, files):
        raise ArgumentError(f"files: expected recordings other than {shown(str(out))}, which gets them")
    added = 0
    with opened_whole(out) as into:
        dialects = _dialects(into.listing())  # checks that no capture is damaged or lost
        for done, file in enumerate(files, start=1):
            with _named(file), closing(Store(storage.fetch_file(file))) as store:
                more = _dialects(store.listing())
                _check_origin(into, store, dialects, more)
                added += _add(into, store)
            dialects |= more
            if progress:
                progress(done, len(files))
    return added


def _add(into: Store, store: Store) -> int:
    """Add a recording to another one; return the number of captures that were new."""
    into.set_scene(store.scene_identity)
    if (objects := _objects(into, store)) != into.objects():
        into.set_objects(objects)
    if geometry := store.geometry():
        known = into.geometry()
        boxes = {**geometry.boxes, **known.boxes}
        into.set_geometry(SceneGeometry(boxes, known.room or geometry.room))
    held = into.states()
    for name, state in store.states().items():
        if name not in held or held[name].instant is None:
            into.set_state(name, state)
    added = 0
    for row in store.rows():
        row.check_payload()
        request, view, _ = row.description()
        there = into.get_row(request)
        if there is None:
            into.add_row(row, request)
            added += 1
        elif (there.payload, there.encoding, there.captured) != (row.payload, row.encoding, row.captured):
            raise _other_bytes(request, view)
    return added


def _check_origin(into: Store, store: Store, before: set[str], after: set[str]) -> None:
    """Raise RecordingError for captures of another scene, or of a server of another dialect."""
    known, found = into.scene_identity, store.scene_identity
    if known.differs(found):
        wanted = f"expected captures of the scene {scene_in_words(known)}, as in those before"
        raise RecordingError(f"{wanted}, got {scene_in_words(found)}")
    if before and after and before.isdisjoint(after):
        wanted = f"expected captures of dialect {', '.join(sorted(before))}, as in those before"
        raise RecordingError(f"{wanted}, got {', '.join(sorted(after))}")
    names, more = into.objects().colors, store.objects().colors
    if names and more and not names.keys() & more.keys():
        wanted = f"expected objects of the scene of those before, such as {shown(min(names))}"
        raise RecordingError(f"{wanted}, got only others, such as {shown(min(more))}")


def _dialects(rows: Sequence[Row]) -> set[str]:
    found: Iterator[Any] = (object_from_json(row.provenance).get("dialect") for row in rows)
    return {shown(each) for each in found if each}


def _objects(into: Store, store: Store) -> ObjectTable:
    """The objects of two recordings; RecordingError where masks of one would get names of the other."""
    tables, masks = (into.objects(), store.objects()), (into.has_masks(), store.has_masks())
    named = [bool(each.colors) for each in tables]
    if not all(named):
        if any(named) and any(mask and not name for mask, name in zip(masks, named, strict=True)):
            raise RecordingError(
                "expected object masks with an object table in all recordings, got one without"
            )
        return tables[0 if named[0] else 1]
    conflict = object_tables.conflict(*tables)
    if conflict and all(masks):
        raise RecordingError(f"expected the mask colours of those before, but {conflict}")
    return tables[0 if masks[0] else 1] if conflict else object_tables.union(*tables)


def _other_bytes(request: Request, view: View) -> RecordingError:
    state = f" in state {shown(request.state)}" if request.state else ""
    wanted = f"expected the bytes that were recorded before of {request.mode}, {in_words(view)}{state}"
    return RecordingError(f"{wanted}; got others")


@contextmanager
def _named(file: Path | str) -> Iterator[None]:
    """Name a recording in errors."""
    try:
        yield
    except RecordingNotWritableError:  # of what gets the captures
        raise
    except RecordingError as cause:
        shown_file = storage.without_secrets(file)
        if str(cause).startswith(f"{shown_file}: "):
            raise
        raise type(cause)(f"{shown_file}: {cause}") from cause
