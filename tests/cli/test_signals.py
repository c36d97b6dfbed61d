"""Signals that end a command, also where a shell started it with SIGINT ignored, as background jobs."""

import signal
import time

import pytest
from support.processes import OMNISCV, started

from omniscv.errors import NotARecordingError, RecordingError
from omniscv.sources.recording.inspection import info, verify


def captures_in(path):
    try:
        return verify(path).captures
    except (NotARecordingError, RecordingError):  # not there yet, or just being made
        return 0


@pytest.mark.parametrize(
    ("number", "ignored"),
    [(signal.SIGINT, [signal.SIGINT, signal.SIGHUP]), (signal.SIGHUP, [])],
)
def test_a_signal_ends_a_recording_that_can_be_resumed(number, ignored, tmp_path):
    """It may come several times, as from ``timeout`` and terminals. SIGHUP under nohup changes nothing."""
    out = tmp_path / "room.sqlite"
    positions = [f"--position={0.001 * step},0,1.5" for step in range(1000)]
    options = ["--face-size", "32", "--modes", "lit", "--out", out]
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
    assert said == "omniscv: stopped; recorded captures are kept, rerun to resume\n"
    assert verify(out).ok
    assert 0 < info(out).captures["lit"] < 6000
