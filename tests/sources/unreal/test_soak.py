"""Thousands of captures from a server where everything goes wrong now and then.

``pytest tests/sources/unreal/test_soak.py --soak -s`` runs 10,000 requests and prints its figures.
"""

import itertools
import threading
import time

import numpy as np
import pytest
from support.unreal import MODES

import mock_server
import omniscv
from omniscv.geometry import Pose
from omniscv.sources import Request, View

TIMEOUT_S = 0.3
RETRIES = 10
FAULTS = (
    "delay=0.6@0.001",
    "drip=0.05@0.005",
    "missing@0.001",
    "wrong-id@0.002",
    "no-id@0.002",
    "clicked@0.01",
    "cut=0.7@0.002",
    "bad-magic@0.002",
    "zero-size@0.002",
    "huge@0.002",
    "reset@0.003",
    "no-greeting@0.1",
    "second-client=0.1@0.1",
    "stale=2@0.05",
)
VIEWPOINTS = 48
"""Their pictures are known from a server without faults."""


def views():
    """Views whose pictures all differ."""
    rng = np.random.default_rng(23)
    numbers = rng.uniform((-1.5, -1.2, -180, -70), (1.2, 1.2, 180, 70), (VIEWPOINTS, 4))
    sizes = rng.choice([16, 24, 32], VIEWPOINTS)
    return [
        View(Pose.from_angles((x, y, 1.3), yaw, pitch), 90.0, int(size), int(size))
        for (x, y, yaw, pitch), size in zip(numbers, sizes, strict=True)
    ]


def requests(count, rng):
    """Random views in random modes, now one mode, now all of them at a viewpoint."""
    known = views()
    stream = []
    while len(stream) < count:
        view = known[rng.integers(len(known))]
        modes = MODES if rng.random() < 0.5 else [MODES[rng.integers(len(MODES))]]
        stream += [Request(view, mode) for mode in modes]
    return stream[:count]


@pytest.fixture(scope="module")
def truth():
    with omniscv.open_source("mock://four-wall") as source:
        wanted = [Request(view, mode) for view in views() for mode in MODES]
        return {c.request: c.payload for c in source.capture(wanted)}


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.soak)])
def test_nothing_is_lost_nothing_is_wrong_nothing_hangs(count, truth):
    wanted = requests(count, np.random.default_rng(count))
    # Between two captures at most: every retry waits for a greeting or a reply, and pauses.
    limit_s = (RETRIES + 1) * (2 * TIMEOUT_S + 2.0)
    with mock_server.serve("four-wall", faults=FAULTS, seed=count) as server:
        came, longest = run_watched(server, wanted, limit_s)
        struck = dict(server.faults.struck)
        connections = server.statistics.total("vget /cameras")
    wrong = sum(truth[c.request] != c.payload for c in came)
    print(
        f"\n{count} requests: {len(came)} captures, {count - len(came)} lost, {wrong} wrong; "
        f"{sum(struck.values())} faults {struck}; about {connections} connections; "
        f"longest wait for a capture {longest:.1f} s, limit {limit_s:.0f} s"
    )
    assert [c.request for c in came] == wanted
    assert wrong == 0
    assert sum(struck.values()) > count / 30


def run_watched(server, wanted, limit_s):
    """All captures, and the longest time between two; fails when one is not there in time."""
    came, ticks, errors = [], [time.monotonic()], []

    def run():
        try:
            with omniscv.open_source(server.uri, timeout_s=TIMEOUT_S, retries=RETRIES) as source:
                for capture in source.capture(wanted):
                    came.append(capture)
                    ticks.append(time.monotonic())
        except omniscv.OmniscvError as error:
            errors.append(error)

    worker = threading.Thread(target=run, daemon=True)
    worker.start()
    while worker.is_alive():
        worker.join(0.2)
        assert time.monotonic() - ticks[-1] < limit_s, f"no capture after {len(came)} for {limit_s} s"
    assert not errors, errors[0]
    return came, max(b - a for a, b in itertools.pairwise(ticks))
