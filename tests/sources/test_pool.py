"""A pool of replicas: every capture is made, in order, by those that have not failed."""

import threading
import time
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.faces import face_requests
from support.recordings import contents, provenances

import mock_server
import omniscv
from omniscv.errors import ArgumentError, ServerConnectionError, SourceError
from omniscv.sources import Capabilities, Capture, ObjectTable, Request, Source
from omniscv.sources.pool import SourcePool
from omniscv.sources.recording.inspection import verify
from omniscv.sources.registry import open_sources

BATCH_OF_24 = 836  # px of a face; replicas get 2^24 pixels at once
REQUESTS = list[Request]()
for step in range(20):
    REQUESTS += face_requests(size=BATCH_OF_24, modes=("lit", "depth"), center=(0.1 * step, 0.0, 1.5))


class Game(Source):
    """Captures without pixels; fails after a number of them."""

    capabilities = Capabilities()

    def __init__(self, lasts=None, table=None):
        self.lasts = lasts
        self.made = []
        self.closed = 0
        self.table = ObjectTable(table or {"Sofa": (1, 2, 3)})

    def capture(self, requests):
        for request in requests:
            if len(self.made) == self.lasts:
                raise ServerConnectionError(f"gone after {self.lasts}")
            self.made.append(request)
            yield Capture(request, request.view, None)

    def objects(self):
        return self.table

    def close(self):
        self.closed += 1


def requests_of(captures):
    return [capture.request for capture in captures]


@given(
    before=st.lists(st.none() | st.integers(0, 200), max_size=2),
    after=st.lists(st.none() | st.integers(0, 200), max_size=2),
    count=st.integers(0, len(REQUESTS)),
)
def test_all_in_order_once_as_long_as_one_replica_works(before, after, count):
    games = [Game(lasts) for lasts in (*before, None, *after)]
    with SourcePool(games) as pool:
        assert requests_of(pool.capture(REQUESTS[:count])) == REQUESTS[:count]
    made = Counter(request for game in games for request in game.made)
    assert set(made.values()) <= {1}
    assert made.total() == count
    assert [game.closed for game in games] == [1] * len(games)


@given(lasting=st.lists(st.integers(0, 50), min_size=1, max_size=4))
def test_the_fault_of_the_last_replica_is_the_error(lasting):
    games = [Game(lasts) for lasts in lasting]
    came = []
    with SourcePool(games) as pool, pytest.raises(ServerConnectionError, match="gone after"):
        came.extend(capture.request for capture in pool.capture(REQUESTS))
    assert came == REQUESTS[: len(came)]
    assert [len(game.made) for game in games] == lasting


def test_requests_are_read_a_few_batches_ahead():
    read = []
    with SourcePool([Game(), Game()]) as pool:
        captures = pool.capture(read.append(request) or request for request in REQUESTS)
        assert read == []
        next(captures)
        assert len(read) <= 4 * 24  # two shares for each game
        captures.close()


def test_a_slow_replica_does_not_delay_the_others():
    release = threading.Event()

    class Slow(Game):
        def capture(self, requests):
            assert release.wait(60)
            yield from super().capture(requests)

    class Quick(Game):
        def capture(self, requests):
            yield from super().capture(requests)
            if len(self.made) >= 3 * 24:
                release.set()

    slow = Slow()
    quick = Quick()
    with SourcePool([slow, quick]) as pool:
        assert requests_of(pool.capture(REQUESTS)) == REQUESTS
    assert len(quick.made) > len(slow.made) > 0


def test_a_replica_that_failed_is_not_used_again():
    games = [Game(lasts=3), Game()]
    with SourcePool(games) as pool:
        for _ in range(2):
            assert requests_of(pool.capture(REQUESTS)) == REQUESTS
    assert len(games[0].made) == 3
    with SourcePool([Game(lasts=0)]) as pool:
        for _ in range(2):
            with pytest.raises(ServerConnectionError, match="gone after 0"):
                list(pool.capture(REQUESTS))


class Short(Game):
    def capture(self, requests):
        yield from super().capture(requests[:-1])


class Wrong(Game):
    def capture(self, requests):
        raise ZeroDivisionError("wrong")


def test_a_skipped_request_and_an_error_of_another_kind_are_raised():
    for games, error, says in (
        ([Short()], SourceError, "expected 24 captures, got 23"),
        ([Game(), Wrong()], ZeroDivisionError, "wrong"),
    ):
        with SourcePool(games) as pool, pytest.raises(error, match=says):
            list(pool.capture(REQUESTS))


def test_different_sources_and_none_are_refused():
    recoloured = Game(table={"Sofa": (9, 2, 3)})
    other = Game()
    other.capabilities = Capabilities(dialect="0.3.10")
    for games, says in (
        ([], "at least one"),
        ([Game(), recoloured], r"source 2 differs .* 'Sofa': \(9, 2, 3\) against 'Sofa': \(1, 2, 3\)"),
        ([Game(), other], r"dialect: '0.3.10' against ''"),
    ):
        with pytest.raises(ArgumentError, match=says):
            SourcePool(games)


def test_one_that_cannot_be_opened_is_an_error_at_once():
    with mock_server.serve("four-wall") as server, pytest.raises(ServerConnectionError):
        open_sources([server.uri, "unreal://127.0.0.1:1"])


def test_the_requests_of_a_server_that_stops_are_captured_by_the_others(tmp_path, caplog):
    modes = ("lit", "object_mask", "depth")
    places = [(0.1 * step, 0.0, 1.5) for step in range(6)]
    requests = [request for place in places for request in face_requests(32, modes, center=place)]
    alone = tmp_path / "alone.sqlite"
    together = tmp_path / "together.sqlite"
    with mock_server.serve("four-wall") as first, mock_server.serve("four-wall", latency_ms=5) as second:
        with omniscv.open_source(first.uri) as live, omniscv.record(live, alone) as source:
            source.objects()
            list(source.capture(requests))
        games = open_sources([first.uri, second.uri], timeout_s=5, retries=1, patience_s=0.5)
        death = threading.Thread(target=stop_amidst_pictures, args=(second,))
        with omniscv.record(games, together) as source:
            source.objects()
            death.start()
            assert requests_of(source.capture(requests)) == requests
        death.join()
    assert "a replica failed, 1 left" in caplog.text
    assert verify(together).ok
    assert contents(together) == contents(alone)
    assert len(servers(together)) == 2


def stop_amidst_pictures(server):
    while sum(n for text, n in server.statistics.counts.items() if text.endswith("png")) < 10:
        time.sleep(0.001)
    server.stop()


def servers(path):
    return Counter(provenance["server"] for _, provenance in provenances(path))
