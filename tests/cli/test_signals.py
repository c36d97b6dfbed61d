"""Signals that end a command, also where a shell started it with SIGINT ignored, as background jobs."""

import signal
import subprocess
import sys
import time

import pytest
from support.processes import OMNISCV, started

from omniscv import cli
from omniscv.errors import NotARecordingError, RecordingError
from omniscv.sources.recording.inspection import info, verify


def captures_in(path):
    try:
        return verify(path).captures
    except (NotARecordingError, RecordingError):  # not there yet, or just being made
        return 0


@pytest.mark.parametrize(
    ("number", "ignored"),
    [
        (signal.SIGINT, [signal.SIGINT, signal.SIGHUP]),
        pytest.param(signal.SIGHUP, [], marks=pytest.mark.soak),
    ],
)
def test_a_signal_ends_a_recording_that_can_be_resumed(number, ignored, tmp_path):
    """It may come several times, as from ``timeout`` and terminals. SIGHUP under nohup changes nothing."""
    out = tmp_path / "room.sqlite"
    positions = [f"--position={0.001 * step},0,1.5" for step in range(1000)]
    options = ["--set", "face_size=32", "--modes", "lit", "--out", out]
    with started(*OMNISCV, "record", *options, *positions, ignored=ignored) as process:
        if signal.SIGHUP in ignored:
            process.send_signal(signal.SIGHUP)
        while captures_in(out) == 0:
            assert process.poll() is None
            time.sleep(0.02)
        for _ in range(3):
            process.send_signal(number)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert said == "omniscv: stopped; what is complete is kept, rerun to resume\n"
    assert verify(out).ok
    assert 0 < info(out).captures["lit"] < 6000


def test_a_signal_that_was_lost_is_noticed_later():
    """What a handler raises within a callback of C, or in ``__del__``, is printed and gone."""
    lost = """
import os, signal, sys
from omniscv.cli import console
class Ends:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        sum(range(1000))
def command():
    Ends()
    console.check()
    return 0
sys.exit(console.unwound(command))
"""
    done = subprocess.run([sys.executable, "-c", lost], timeout=60, capture_output=True)
    assert (done.returncode, done.stderr) == (143, b"")


def test_what_an_interrupted_import_raises_is_no_failure_of_its_own():
    interrupted = """
import os, signal, sys
from omniscv.cli import console
def command():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))
    except KeyboardInterrupt as cause:
        raise ImportError("failed to import") from cause
sys.exit(console.unwound(command))
"""
    done = subprocess.run([sys.executable, "-c", interrupted], timeout=60, capture_output=True)
    assert (done.returncode, done.stderr) == (130, b"")


def test_a_signal_before_the_command_begins_stops_it_too(monkeypatch):
    """Nothing of a command runs outside of what unwinds it."""
    monkeypatch.setattr(cli, "_print_log", lambda: pytest.fail("it is not guarded"))
    monkeypatch.setattr(cli.console, "unwound", lambda command: 130)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
