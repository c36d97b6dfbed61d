"""Kill -9 of the recorder, at random moments: what was recorded stays, resuming captures only the rest."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest
from support import recorder
from support.recordings import CountingSource, contents

import mock_server
import omniscv
from omniscv.sources.recording.inspection import verify
from omniscv.sources.recording.store import Store

KILLS, SOAK_KILLS = 6, 50


@pytest.fixture(scope="module")
def server():
    with mock_server.serve("four-wall") as running:
        yield running


class Recorder:
    """A process that has imported all it needs, and records after :meth:`go`."""

    def __init__(self, uri, path):
        self._process = subprocess.Popen(
            [sys.executable, recorder.__file__, uri, path],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def go(self):
        assert self._process.stdout.readline() == "ready\n"
        self._process.stdin.write("go\n")
        self._process.stdin.flush()
        return time.perf_counter()

    def done(self):
        assert self._process.stdout.readline() == "done\n"
        moment = time.perf_counter()
        self._end()
        return moment

    def kill(self):
        if not self._process.stdout.closed:
            self._process.send_signal(signal.SIGKILL)
            self._end()

    def _end(self):
        self._process.communicate(timeout=60)


@pytest.fixture(scope="module")
def undisturbed(server, tmp_path_factory):
    """What a recorder that is not killed records, and how long it takes, seconds."""
    for name in ("warm-up", "room"):
        path = tmp_path_factory.mktemp("undisturbed") / f"{name}.sqlite"
        whole = Recorder(server.uri, path)
        duration_s = -whole.go() + whole.done()
    return contents(path), duration_s


def resume(server, path):
    """Record the rest, in this process; the requests that reach the server's source."""
    live = CountingSource(omniscv.open_source(server.uri))
    recorder.record(live, path)
    return live.requests


def wait_for_a_capture(path):
    until = time.monotonic() + 60
    while not (path.exists() and contents(path)[0]):
        assert time.monotonic() < until
        time.sleep(0.001)


@pytest.mark.parametrize(
    "kills", [KILLS, pytest.param(SOAK_KILLS, marks=[pytest.mark.soak, pytest.mark.timeout(600)])]
)
def test_killed_at_random_moments(kills, server, undisturbed, tmp_path, request):
    """The file opens, verifies, holds captures of the undisturbed run; resuming captures the others."""
    (wanted, objects), duration_s = undisturbed
    moments = random.Random(kills)
    paths = [tmp_path / f"room-{kill}.sqlite" for kill in range(kills)]
    held = []
    following = Recorder(server.uri, paths[0])
    for kill, path in enumerate(paths):
        victim = following
        victim.go()
        longest_s = duration_s
        if kill % 2:  # amidst the captures; else at any time, opening and closing included
            wait_for_a_capture(path)
            longest_s /= 4
        time.sleep(moments.uniform(0, longest_s))
        victim.kill()
        if kill + 1 < kills:  # it imports while this one's file is examined
            following = Recorder(server.uri, paths[kill + 1])
            request.addfinalizer(following.kill)

        before = {}
        if path.exists():  # else it was killed before it began to record
            report = verify(path)
            assert report.ok, list(report.lines())
            before = contents(path)[0]
            assert before.items() <= wanted.items()

        requested = resume(server, path)
        assert len(set(requested)) == len(requested) == len(wanted) - len(before)
        assert contents(path) == (wanted, objects)
        assert verify(path).ok
        assert [file.name for file in tmp_path.glob(f"{path.name}*")] == [path.name]  # one file again
        held.append(len(before))
    print(
        f"killed {kills} times within {duration_s:.2f} s: held {sorted(held)} of {len(wanted)} captures; "
        f"resuming captured the other {sum(len(wanted) - n for n in held)}, none twice"
    )
    assert all(held[1::2])


def test_a_killed_creation_leaves_no_file_that_does_not_open(tmp_path, monkeypatch):
    """The file appears with its schema in it, or not at all; another's file is never replaced."""
    path = tmp_path / "room.sqlite"
    link = os.link

    def another_was_first(fresh, target):
        monkeypatch.undo()
        Store(target, write=True).close()
        first.append(path.stat().st_ino)
        link(fresh, target)

    first = []
    monkeypatch.setattr(os, "link", another_was_first)
    Store(path, write=True).close()
    assert [path.stat().st_ino] == first
    assert list(tmp_path.iterdir()) == [path]
