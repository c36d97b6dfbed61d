"""What tests compare of recordings, and a source that counts what is requested of it."""

import sqlite3
import zlib
from contextlib import closing

import omniscv
from omniscv.sources import SourceWrapper
from omniscv.sources.recording.rows import Head, Row
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.world_rows import object_checksum


def contents(path):
    """All that a replay can show: by key, views, encoding and payload; and the objects."""
    with closing(Store(path)) as store:
        rows = {row.key: (row.asked, row.captured, row.encoding, row.payload) for row in store.rows()}
        return rows, store.objects()


def provenances(path):
    """(mode, provenance) of each capture, in the order of recording."""
    with closing(Store(path)) as store:
        return [(row.mode, row.capture().provenance) for row in store.rows()]


def filled(path, requests, source="scene://four-wall", **options):
    """Record requests of a source, or of an address; the path again."""
    live = omniscv.open_source(source) if isinstance(source, str) else source
    with omniscv.record(live, path, **options) as recording:
        list(recording.capture(requests))
    return path


class CountingSource(SourceWrapper):
    """Keeps the requests that reach the source behind it."""

    def __init__(self, source):
        super().__init__(source)
        self.requests = []

    def capture(self, requests):
        return super().capture(self.requests.append(request) or request for request in requests)


def reseal(path):
    """Compute all checksums of a recording anew, as its author could who wants to have it believed."""
    with closing(sqlite3.connect(path)) as database, database:
        database.text_factory = bytes.decode
        head = Head._make(database.execute("SELECT * FROM recording").fetchone())
        head = head._replace(captures=0, capture_sum=0)
        for values in database.execute(f"SELECT {', '.join(Row._fields)} FROM capture").fetchall():
            row = Row(*values)
            row = row._replace(payload_checksum=zlib.crc32(row.payload)).in_recording(row.number, head.id)
            update = "UPDATE capture SET payload_checksum = ?, checksum = ? WHERE number = ?"
            database.execute(update, (row.payload_checksum, row.checksum, row.number))
            head = head.with_rows([row])
        objects = database.execute("SELECT * FROM object ORDER BY name").fetchall()
        head = head._replace(object_checksum=object_checksum(objects)).sealed()
        columns = ", ".join(f"{name} = ?" for name in Head._fields)
        database.execute(f"UPDATE recording SET {columns}", head)
