"""What tests compare of recordings, and a source that counts what is requested of it."""

from contextlib import closing

from omniscv.sources import SourceWrapper
from omniscv.sources.recording.store import Store


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
