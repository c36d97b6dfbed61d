"""Several games at once: every capture is made, in order, by whoever is left."""

import threading
import time
from collections import Counter

import pytest
import yaml
from faces import face_requests
from hypothesis import given
from hypothesis import strategies as st

import mock_server
import omniscv
from omniscv.captures.inspection import verify
from omniscv.captures.shared import SharedSource, open_shared
from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.store import Store
from omniscv.captures.view import Capture
from omniscv.cli import run
from omniscv.errors import ArgumentError, ConnectionFailed

REQUESTS = [
    request
    for step in range(20)
    for request in face_requests(size=8, modes=("lit", "depth"), center=(0.1 * step, 0.0, 1.5))
]


class Game(Source):
    """Captures without pixels; fails for good after so many."""

    capabilities = Capabilities(pipelines=True)

    def __init__(self, lasts=None, table=None):
        self.lasts, self.made, self.closed = lasts, [], 0
        self.table = ObjectTable(table or {"Sofa": (1, 2, 3)})

    def capture(self, requests):
        for request in requests:
            if len(self.made) == self.lasts:
                raise ConnectionFailed(f"gone after {self.lasts}")
            self.made.append(request)
            yield Capture(request, request.view, None, b"", "png")

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
def test_all_in_order_once_whoever_is_lost(before, after, count):
    """As long as one game lasts."""
    games = [Game(lasts) for lasts in (*before, None, *after)]
    with SharedSource(games) as shared:
        assert requests_of(shared.capture(REQUESTS[:count])) == REQUESTS[:count]
    made = Counter(request for game in games for request in game.made)
    assert set(made.values()) <= {1}
    assert made.total() == count
    assert [game.closed for game in games] == [1] * len(games)


@given(lasting=st.lists(st.integers(0, 50), min_size=1, max_size=4))
def test_the_last_one_lost_is_the_error(lasting):
    """What was captured in a row before comes out first."""
    games, came = [Game(lasts) for lasts in lasting], []
    with SharedSource(games) as shared, pytest.raises(ConnectionFailed, match="gone after"):
        came.extend(capture.request for capture in shared.capture(REQUESTS))
    assert came == REQUESTS[: len(came)]
    assert [len(game.made) for game in games] == lasting


def test_requests_are_read_no_further_than_there_is_work():
    read = []
    with SharedSource([Game(), Game()]) as shared:
        captures = shared.capture(read.append(request) or request for request in REQUESTS)
        assert read == []
        next(captures)
        assert len(read) <= 8 * 24  # four shares for each game
        captures.close()


def test_a_slow_game_does_not_hold_the_others():
    """The first game waits until the second has done all but what was handed to the first."""
    release = threading.Event()

    class Slow(Game):
        def capture(self, requests):
            assert release.wait(60)
            yield from super().capture(requests)

    class Quick(Game):
        def capture(self, requests):
            yield from super().capture(requests)
            if len(self.made) >= 5 * 24:
                release.set()

    slow, quick = Slow(), Quick()
    with SharedSource([slow, quick]) as shared:
        assert requests_of(shared.capture(REQUESTS)) == REQUESTS
    assert len(quick.made) > len(slow.made) > 0


def test_a_fault_that_is_no_lost_game_is_told():
    class Wrong(Game):
        def capture(self, requests):
            raise ZeroDivisionError

    with SharedSource([Game(), Wrong()]) as shared, pytest.raises(ZeroDivisionError):
        list(shared.capture(REQUESTS))


def test_different_games_are_refused():
    same = {"Sofa": (1, 2, 3)}
    with pytest.raises(
        ArgumentError, match=r"source 2 differs .* Sofa: \(9, 2, 3\) against Sofa: \(1, 2, 3\)"
    ):
        SharedSource([Game(table=same), Game(table={"Sofa": (9, 2, 3)})])
    other = Game()
    other.capabilities = Capabilities(dialect="0.3.10")
    with pytest.raises(ArgumentError, match=r"pipelines: False against True"):
        SharedSource([Game(), other])


def test_one_that_does_not_answer_is_told_at_once():
    with mock_server.serve("four-wall") as server, pytest.raises(ConnectionFailed):
        open_shared([server.uri, "unreal://127.0.0.1:1"])


def test_a_game_that_dies_has_its_share_done_by_the_others(tmp_path, caplog):
    """Over TCP, into one record: the same as from one game alone."""
    requests = [
        request
        for step in range(12)
        for request in face_requests(modes=("lit", "object_mask", "depth"), center=(0.1 * step, 0.0, 1.5))
    ]
    alone, together = tmp_path / "alone.sqlite", tmp_path / "together.sqlite"
    with mock_server.serve("four-wall") as first, mock_server.serve("four-wall", latency_ms=2) as second:
        with omniscv.open_source(first.uri) as live, omniscv.record(live, alone) as source:
            source.objects()
            list(source.capture(requests))
        games = open_shared([first.uri, second.uri], timeout_s=5, retries=1)
        death = threading.Thread(target=stop_amidst_pictures, args=(second,))
        with omniscv.record(games, together) as source:
            source.objects()
            death.start()
            assert requests_of(source.capture(requests)) == requests
        death.join()
    assert "lost a source, 1 left" in caplog.text
    assert verify(together).ok
    assert contents(together) == contents(alone)
    assert len(servers(together)) == 2


@pytest.mark.parametrize("way", ["options", "job"])
def test_several_sources_of_one_command(way, tmp_path):
    out = tmp_path / "room.sqlite"
    with mock_server.serve("four-wall") as first, mock_server.serve("four-wall") as second:
        if way == "options":
            places = [f"--position={0.1 * step},0,1.5" for step in range(8)]
            sources = [f"--source={server.uri}" for server in (first, second)]
            assert run(["record", *sources, *places, "--face-size", "16", f"--out={out}"]) == 0
        else:
            job = {
                "source": [first.uri, second.uri],
                "record": out.name,
                "cameras": {"pano": {"model": "equirectangular", "width": 64, "height": 32}},
                "poses": [{"position": [0.1 * step, 0, 1.5]} for step in range(8)],
                "modes": ["lit", "object_mask", "depth"],
                "strategy": "cube",
            }
            (tmp_path / "job.yaml").write_text(yaml.safe_dump(job))
            assert run(["record", str(tmp_path / "job.yaml")]) == 0
    assert servers(out).total() == 8 * 6 * 3
    assert len(servers(out)) == 2


def stop_amidst_pictures(server):
    """After some were asked for, long before the last."""
    while sum(n for text, n in server.statistics.counts.items() if text.endswith("png")) < 30:
        time.sleep(0.001)
    server.stop()


def contents(path):
    store = Store(path)
    try:
        return {row.key: (row.captured, row.encoding, row.payload) for row in store.rows()}, store.objects()
    finally:
        store.close()


def servers(path):
    store = Store(path)
    try:
        return Counter(provenance["server"] for _, _, provenance in store.entries())
    finally:
        store.close()
