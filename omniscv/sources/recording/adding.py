"""Recordings that captures are added to as one change: a new file appears when it is complete."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from omniscv import storage
from omniscv.errors import RecordingNotWritableError
from omniscv.sources.recording.replacing import kind_of, part_of, place_of, publish_new
from omniscv.sources.recording.store import Store


@contextmanager
def opened_whole(where: Path | str) -> Iterator[Store]:
    """Yield a recording to add to, in a transaction: all is written together, or nothing.

    Args:
        where: of the recording that is there, or of a new one, which appears when all is well; a path or a
            URL.

    Raises:
        RecordingError: a recording cannot be written there.
        StorageError: it cannot be put into the store.
    """
    if storage.is_url(where):
        with _opened_remote(storage.file_at(where)) as store:
            yield store
        return
    place = place_of(where)
    if kind_of(place) and place.stat().st_size:
        with closing(Store(where, write=True)) as store, store.transaction():
            yield store
        return
    with part_of(place) as part:
        try:
            with closing(Store(part, write=True)) as store, store.transaction():
                yield store
        except RecordingNotWritableError as cause:
            raise RecordingNotWritableError(str(cause).replace(str(part), str(where))) from cause
        if not publish_new(part, place):
            wanted = "expected a new file, but another recorder has just created one"
            raise RecordingNotWritableError(f"{where}: {wanted}; run again to add to it")


@contextmanager
def _opened_remote(place: storage.StoredFile) -> Iterator[Store]:
    """As :func:`opened_whole`, of a file in a store: a copy that is put there at the end."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / place.name
        there = place.folder.exists(place.name)
        if there:
            shutil.copyfile(place.folder.fetch(place.name), copy)
        with opened_whole(copy) as store:
            yield store
        if not place.folder.put(place.name, copy, first=not there):
            wanted = "expected a new file, but another recorder has just created one"
            raise RecordingNotWritableError(f"{place.folder}/{place.name}: {wanted}; run again to add to it")
