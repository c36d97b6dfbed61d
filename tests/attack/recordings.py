"""Mutated recordings: bytes of every region, and what SQL can do to one."""

import contextlib
import shutil
import sqlite3

from attack.commands import clear, nothing_left, ran, require
from attack.samples import contents, same, sample
from attack.words import SQL
from omniscv.errors import OmniscvError

PAGE = 4096


def bytes_changed(rng, data):
    """The file with bytes changed, in its header, a page's head, or anywhere."""
    data = bytearray(data)
    pages = len(data) // PAGE
    for _ in range(rng.choice([1, 1, 1, 2, 8])):
        # a b-tree's head
        header = rng.randrange(100)
        page = rng.randrange(pages) * PAGE + rng.randrange(64)
        tables = rng.randrange(min(len(data), 4 * PAGE))  # the schema, small tables, indexes
        offset = rng.choice([header, page, tables, rng.randrange(len(data))])
        length = min(rng.choice([1, 1, 1, 4, 16, 300]), len(data) - offset)
        source = rng.randrange(len(data) - length + 1)
        flipped = bytes([data[offset] ^ 1 << rng.randrange(8)])
        others = [rng.randbytes(length), bytes(length), b"\xff" * length, data[source : source + length]]
        new = rng.choice([*[flipped] * 3, *others])
        data[offset : offset + len(new)] = new
    return bytes(data)


def pages_changed(rng, data):
    """The file cut, lengthened, or with its pages exchanged."""
    pages = [data[i : i + PAGE] for i in range(0, len(data), PAGE)]
    i = rng.randrange(len(pages))
    j = rng.randrange(len(pages))
    longer = data + rng.randbytes(rng.choice([1, 100, PAGE, 3 * PAGE]))
    changes = rng.choice([{i: pages[j], j: pages[i]}, {i: pages[j]}, {i: bytes(PAGE)}])
    changed = b"".join(changes.get(k, page) for k, page in enumerate(pages))
    return rng.choice([data[: rng.randrange(len(data))], longer, *[changed] * 3])


def sql_changed(rng, path):
    """What somebody with SQL can do to the file, without making its checksums right."""
    database = sqlite3.connect(path, isolation_level=None)
    try:
        database.execute("PRAGMA ignore_check_constraints = 1")
        database.execute("PRAGMA writable_schema = 1")
        tables = [name for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")]
        table = rng.choice(tables)
        columns = [row[1] for row in database.execute(f'PRAGMA table_info("{table}")')]
        column = rng.choice(columns)
        other = rng.choice(columns)
        value = rng.choice(SQL)
        one = f"rowid = {rng.randint(1, 6)}"
        statements = [
            *[f'UPDATE "{table}" SET "{column}" = {value} WHERE {one}'] * 8,
            f'UPDATE "{table}" SET "{column}" = {value}',
            *[f'UPDATE "{table}" SET "{column}" = (SELECT "{column}" FROM "{table}" WHERE {one})'] * 3,
            f'UPDATE "{table}" SET "{column}" = "{other}" WHERE {one}',
            f'UPDATE "{table}" SET "{column}" = "{column}" || \' \' WHERE {one}',
            f'UPDATE "{table}" SET "{column}" = replace("{column}", \'1\', \'2\') WHERE {one}',
            *[f'DELETE FROM "{table}" WHERE {one}'] * 2,
            f'DELETE FROM "{table}"',
            f'DROP TABLE "{table}"',
            f'ALTER TABLE "{table}" RENAME TO elsewhere',
            f'ALTER TABLE "{table}" RENAME COLUMN "{column}" TO other',
            f'ALTER TABLE "{table}" ADD COLUMN more',
            f'CREATE TRIGGER quiet BEFORE INSERT ON "{table}" BEGIN SELECT raise(ignore); END',
            f'CREATE VIEW also AS SELECT * FROM "{table}"',
            f'ALTER TABLE "{table}" RENAME TO real; CREATE VIEW "{table}" AS WITH RECURSIVE r(i) AS '
            f"(SELECT 1 UNION ALL SELECT i + 1 FROM r) SELECT real.* FROM real, r",
            "CREATE TABLE also (x)",
            f'CREATE INDEX also ON "{table}" ("{column}")',
            f"PRAGMA user_version = {rng.choice([0, 1, 3, 99, -1])}",
            f"PRAGMA application_id = {rng.choice([0, 1, -1])}",
            f"UPDATE sqlite_schema SET sql = {value} WHERE name = '{table}'",
            f"UPDATE sqlite_schema SET rootpage = {rng.randint(0, 9)} WHERE name = '{table}'",
            "PRAGMA encoding = 'UTF-16'; VACUUM",
            "PRAGMA page_size = 512; VACUUM",
        ]
        with contextlib.suppress(sqlite3.Error):  # refused by SQLite itself
            database.executescript(rng.choice(statements))
    finally:
        database.close()


def beside(rng, path):
    """A log that was left beside the file: nonsense, another file's, or cut."""
    name = path.with_name(path.name + rng.choice(["-wal", "-shm", "-journal"]))
    start = rng.randbytes(rng.choice([10, 32, 5000]))
    name.write_bytes(rng.choice([b"", start, b"\x37\x7f\x06\x82" + start[:60]]))


def case(rng, folder):
    """A recording mutated somewhere is refused in one line, or replays what was recorded."""
    data = sample().recording.read_bytes()
    with nothing_left(folder) as work:
        path = work / "room.sqlite"
        kind = rng.randrange(10)
        if kind < 5:
            path.write_bytes(bytes_changed(rng, data))
        elif kind < 6:
            path.write_bytes(pages_changed(rng, data))
        else:
            shutil.copy(sample().recording, path)
            sql_changed(rng, path) if kind < 9 else beside(rng, path)
        before = path.read_bytes()
        verified = ran(["recording", "check", path.name])
        try:
            captures, objects = contents(path)
        except OmniscvError as error:
            clear(error)
        else:
            require(same(captures, objects), f"other data than was recorded: {verified.out}{verified.err}")
        ran(["recording", "info", path.name])
        require(path.read_bytes() == before, "reading changed the file")
