"""Add to recordings as a whole, merge and split them: each capture stays as recorded, byte for byte."""

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np

from omniscv import storage
from omniscv.arguments import number, shown, whole_number
from omniscv.errors import ArgumentError, OtherSceneError, RecordingError, RecordingNotWritableError
from omniscv.geometry.clusters import cluster_starts
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import ObjectTable
from omniscv.sources.recording.files import kind_of, publish_new, target_of, written_for
from omniscv.sources.recording.replay import in_words
from omniscv.sources.recording.rows import Row, view_from_json
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.world_rows import object_from_json, table_conflict
from omniscv.storage.local import remove_scratch, scratch_folder

Address = TypeVar("Address", str, Path)
Progress = Callable[[int, int], None]
"""``progress(done, total)``."""

_SCRATCH = ".split-"
_LEAST_DISTANCE_M = 0.001  # files of a split are named by positions in millimetres
_JUST_CREATED = "expected a new file, but another recorder has just created one; run again to add to it"


def merge(out: Path | str, files: Sequence[Path | str], progress: Progress | None = None) -> int:
    """Join recordings into one, and return the number of captures that were added.

    All or nothing. Captures that are there already are left out, so that a merge may be repeated. Shapes and
    states of the world are those of the first recording that knows them.

    Args:
        out: path or URL of the recording that gets the captures; new, or one to add to.
        files: paths or URLs of the recordings, in the order in which their captures are added.
        progress: called with (recordings done, recordings in all).

    Raises:
        ArgumentError: no recordings, or ``out`` among them.
        OtherSceneError: recordings of different scenes or mask colours.
        RecordingError: recordings of different dialects, with different captures of one request, or damaged;
            or one cannot be read or written.
    """
    if not files:
        raise ArgumentError("files: expected recordings to merge, got none")
    if str(out) in map(str, files):
        raise ArgumentError(f"files: expected recordings other than {shown(str(out))}, which gets them")
    added = 0
    with opened_whole(out) as target:
        dialects = _dialects(target.listing())  # checks that no capture is damaged or lost
        for done, file in enumerate(files, start=1):
            with _errors_of(file), closing(Store(storage.fetch_file(file))) as store:
                more = _dialects(store.listing())
                if dialects and more and dialects.isdisjoint(more):
                    expected = f"expected captures of dialect {', '.join(sorted(dialects))}"
                    raise RecordingError(f"{expected}, as in those before, got {', '.join(sorted(more))}")
                added += _add_all(target, store)
            dialects |= more
            if progress:
                progress(done, len(files))
    return added


def split(file: Path | str, out: Path | str, distance_m: float = 0.5) -> list[tuple[str, int]]:
    """Write a recording for each cluster of optical centres of one, and return their names and counts.

    Each replays what was captured there. It has the name ``STEM.X,Y,Z.SUFFIX``: X, Y, Z is the cluster's
    first centre, metres.

    Args:
        file: path or URL of the recording.
        out: a folder, or its URL, which must be empty or new.
        distance_m: centres belong to one cluster if steps of at most so much lead from one to the other.

    Raises:
        ArgumentError: the folder holds something.
        RecordingError: the recording cannot be read, is damaged, or one cannot be written.
    """
    number("distance_m", distance_m, least=_LEAST_DISTANCE_M)
    folder = storage.folder(out)
    if folder.names():
        raise ArgumentError(f"{folder}: expected an empty or new folder, but it holds something")
    with closing(Store(storage.fetch_file(file))) as store:
        source_name = Path(str(file).rpartition("/")[2])
        numbers: dict[str, list[int]] = {}
        for row, start in _clustered(store.listing(), distance_m):
            cluster = ",".join(f"{coordinate + 0.0:.3f}" for coordinate in start)
            numbers.setdefault(f"{source_name.stem}.{cluster}{source_name.suffix}", []).append(row.number)
        if folder.local is not None:  # temporary files are on the file system of the folder
            folder.local.mkdir(parents=True, exist_ok=True)
        parent = Path(tempfile.gettempdir()) if folder.local is None else folder.local
        remove_scratch(parent, _SCRATCH)
        with scratch_folder(parent, _SCRATCH) as scratch:
            for name in numbers:
                with opened_whole(scratch / name) as target:
                    _add_all(target, store, numbers[name])
            for name in numbers:
                folder.put(name, scratch / name)
    return [(name, len(numbers[name])) for name in numbers]


def _clustered(rows: Sequence[Row], distance_m: float) -> Iterator[tuple[Row, Sequence[float]]]:
    """Yield captures with the first centre of their cluster, metres."""
    centers = []
    for row in rows:
        centers.append(tuple(view_from_json(row.asked).pose.position.tolist()))
    distinct = list(dict.fromkeys(centers))
    starts = dict(zip(distinct, cluster_starts(np.array(distinct), distance_m).tolist(), strict=True))
    for row, center in zip(rows, centers, strict=True):
        yield row, starts[center]


def part_file(address: Address, index: int, count: int) -> Address:
    """Return where a part of a recording is recorded: ``room.part-0-of-4.sqlite``.

    Each part is recorded by a process of its own, at the same time.

    Args:
        address: of the whole recording.
        index: of the part, from 0.
        count: of all parts.

    Raises:
        ArgumentError: there is no such part.
    """
    whole_number("part", count, least=1)
    whole_number("part", index, least=0, most=count - 1)
    folder, slash, name = str(address).rpartition("/")
    stem, dot, suffix = name.rpartition(".")
    if not stem:
        return type(address)(f"{folder}{slash}{name}.part-{index}-of-{count}")
    return type(address)(f"{folder}{slash}{stem}.part-{index}-of-{count}{dot}{suffix}")


@contextmanager
def opened_whole(address: Path | str) -> Iterator[Store]:
    """Yield a recording, new or not, to add to, in a transaction: everything is written together, or nothing.

    Raises RecordingError if it cannot be written there, StorageError if it cannot be put into the store.
    """
    if storage.is_url(address):
        with _opened_remote(storage.file_at(address)) as store:
            yield store
        return
    target = target_of(address)
    if kind_of(target) and target.stat().st_size:
        with closing(Store(address, write=True)) as store, store.transaction():
            yield store
        return
    with written_for(target) as file:
        try:
            with closing(Store(file, write=True)) as store, store.transaction():
                yield store
        except RecordingNotWritableError as cause:
            if cause.path != file:
                raise
            raise cause.at(address) from cause
        if not publish_new(file, target):
            raise RecordingNotWritableError(_JUST_CREATED, address)


@contextmanager
def _opened_remote(place: storage.StoredFile) -> Iterator[Store]:
    """As :func:`opened_whole`, of a file in a store: a copy that is put there at the end."""
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / place.name
        exists = place.folder.exists(place.name)
        if exists:
            shutil.copyfile(place.folder.fetch(place.name), copy)
        with opened_whole(copy) as store:
            yield store
        if not place.folder.put(place.name, copy, first=not exists):
            raise RecordingNotWritableError(_JUST_CREATED, f"{place.folder}/{place.name}")


def _add_all(target: Store, store: Store, numbers: Sequence[int] | None = None) -> int:
    """Add captures of a recording to another one, all or those of some numbers; return how many were new."""
    target.set_scene(store.scene_identity)
    add_objects(target, store.objects(), store.has_masks())
    if geometry := store.geometry():
        known = target.geometry()
        boxes = {**geometry.boxes, **known.boxes}
        target.set_geometry(SceneGeometry(boxes, known.room or geometry.room))
    states = store.states()  # that are to be added
    for name, state in target.states().items():
        if state.instant is not None:
            states.pop(name, None)
    added = 0
    for row in store.rows(numbers):
        if row.state in states:
            target.set_state(row.state, states.pop(row.state))
        added += _add_new(target, row)
    return added


def _add_new(target: Store, row: Row) -> bool:
    """Add a capture; return False if it is there already; RecordingError if its request has other bytes."""
    row.check_payload()
    request, view, _ = row.description()
    existing = target.get_row(request)
    if existing is None:
        target.add_row(row)
        return True
    if (existing.payload, existing.encoding, existing.captured) != (row.payload, row.encoding, row.captured):
        state = f" in state {shown(request.state)}" if request.state else ""
        expected = f"expected the bytes that were recorded before of {request.mode}, {in_words(view)}{state}"
        raise RecordingError(f"{expected}; got others")
    return False


def _dialects(rows: Sequence[Row]) -> set[str]:
    dialects = set()
    for row in rows:
        dialect = object_from_json(row.provenance).get("dialect")
        if dialect:
            dialects.add(shown(dialect))
    return dialects


def add_objects(target: Store, table: ObjectTable, has_masks: bool) -> None:
    """Add the objects of other captures to a recording.

    Args:
        target: the recording.
        table: the objects.
        has_masks: whether there are masks among the captures.

    Raises:
        OtherSceneError: masks would get wrong names, or none.
    """
    before = target.objects()
    if bool(before.colors) != bool(table.colors) and (has_masks if before.colors else target.has_masks()):
        expected = "expected object masks with an object table both in it and in what is added"
        raise OtherSceneError(f"{expected}, got one without; add to another file", target.path)
    is_needed = has_masks or not target.has_masks() or not table_conflict(before, table)
    if is_needed and (table.colors or not before.colors):
        target.set_objects(table)


@contextmanager
def _errors_of(file: Path | str) -> Iterator[None]:
    """Name a recording in errors; those of the file that is written pass."""
    try:
        yield
    except RecordingError as cause:
        if isinstance(cause, RecordingNotWritableError) and not isinstance(cause, OtherSceneError):
            raise
        raise cause.at(storage.without_secrets(file), cause.advice) from cause
