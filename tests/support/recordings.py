"""What tests compare of recordings, and a source that counts what is requested of it."""

import json
import sqlite3
import zlib
from contextlib import closing

from omniscv.sources import SourceWrapper
from omniscv.sources.recording import object_tables
from omniscv.sources.recording.rows import Head, Row, write_head
from omniscv.sources.recording.store import Store

TABLES_1 = """
PRAGMA application_id = 1869442665;
PRAGMA user_version = 1;
CREATE TABLE capture (
    key TEXT PRIMARY KEY,          -- mode and View.key() of the request
    mode TEXT NOT NULL,
    asked TEXT NOT NULL,           -- the requested view, JSON
    captured TEXT NOT NULL,        -- the captured view, JSON
    encoding TEXT NOT NULL,        -- see omniscv.sources.codecs
    checksum INTEGER NOT NULL,     -- CRC-32 of the payload
    provenance TEXT NOT NULL,      -- JSON
    payload BLOB NOT NULL          -- the bytes as received
);
CREATE TABLE object (name TEXT PRIMARY KEY, red INTEGER, green INTEGER, blue INTEGER);
"""
"""What omniscv wrote at 07d31f4."""


def contents(path):
    """All that a replay can show: by key, views, encoding and payload; and the objects."""
    with closing(Store(path)) as store:
        rows = {row.key: (row.asked, row.captured, row.encoding, row.payload) for row in store.rows()}
        return rows, store.objects()


def provenances(path):
    """(mode, provenance) of each capture, in the order of recording."""
    with closing(Store(path)) as store:
        return [(row.mode, row.capture().provenance) for row in store.rows()]


class CountingSource(SourceWrapper):
    """Keeps the requests that reach the source behind it."""

    def __init__(self, source):
        super().__init__(source)
        self.requests = []

    def capture(self, requests):
        return super().capture(self.requests.append(request) or request for request in requests)


def downgrade(path, target):
    """Write a recording as version 1 of the schema has it."""
    with closing(sqlite3.connect(target)) as old, old, closing(Store(path)) as store:
        old.executescript(TABLES_1)
        for row in store.rows():
            values = row.key, row.mode, row.asked, row.captured, row.encoding
            rest = row.payload_checksum, row.provenance, row.payload
            old.execute("INSERT INTO capture VALUES (?, ?, ?, ?, ?, ?, ?, ?)", (*values, *rest))
        table = store.objects()
        rows = [(name, *color) for name, color in table.colors.items()]
        old.executemany("INSERT INTO object VALUES (?, ?, ?, ?)", rows)
        if table.ids or table.tolerance != 3:
            old.execute("CREATE TABLE mask (tolerance INTEGER NOT NULL, ids TEXT NOT NULL)")
            old.execute("INSERT INTO mask VALUES (?, ?)", (table.tolerance, json.dumps(table.ids)))


def reseal(path):
    """Compute all checksums of a recording anew, as its author could who wants to have it believed."""
    with closing(sqlite3.connect(path)) as database, database:
        database.text_factory = bytes.decode
        head = Head._make(database.execute("SELECT * FROM recording").fetchone())
        head = head._replace(captures=0, capture_sum=0)
        for found in database.execute(f"SELECT {', '.join(Row._fields[:-1])} FROM capture").fetchall():
            row = Row(*found)
            row = row._replace(payload_checksum=zlib.crc32(row.payload))
            row = row._replace(checksum=row.own_checksum(head.id))
            update = "UPDATE capture SET payload_checksum = ?, checksum = ? WHERE number = ?"
            database.execute(update, (row.payload_checksum, row.checksum, row.number))
            head = head.with_rows([row], ())
        objects = database.execute("SELECT * FROM object ORDER BY name").fetchall()
        write_head(database, head._replace(object_checksum=object_tables.checksum_of(objects)))
